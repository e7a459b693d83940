"""The verb: fit to these runs, foretell those, beside curves that know neither tissue nor guide."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from needlefit.datasets.tracks.read import read_tracks
from needlefit.datasets.tracks.track import TrackDataset
from needlefit.errors import FitError
from needlefit.inference.draws import from_posterior
from needlefit.inference.identifiability.identify import practically_equal
from needlefit.inference.optimize import minimize
from needlefit.inference.sampling.posterior import Posterior
from needlefit.inference.sampling.sample import sample
from needlefit.inference.starts import Watch
from needlefit.inference.ties import NOISE_SCALE
from needlefit.inference.tracks.course import tips
from needlefit.inference.tracks.curves import CURVES, fit_curve
from needlefit.inference.tracks.evidence import track_evidence
from needlefit.inference.tracks.foresight import Drawn
from needlefit.project.load import load
from needlefit.project.places import find
from needlefit.project.records.recipe import RecipeRecord
from needlefit.project.records.track_study import TrackStudyRecord
from needlefit.project.result_warnings import ResultWarning, stored
from needlefit.project.streams import stream
from needlefit.project.threads import one_thread
from needlefit.project.toml_lines import renamed_keys
from needlefit.validation.checkpoint import Checkpoint, open_checkpoint
from needlefit.validation.folds import specimen_warning
from needlefit.validation.job import Settings
from needlefit.validation.score import Row
from needlefit.validation.tracks.learned import learned
from needlefit.validation.tracks.results import PARAMETERS, READINGS, RIVALS, RUNS, TrackResults
from needlefit.validation.tracks.score import foretold, tuned_rows
from needlefit.validation.tracks.task import Task, require_scored, task, work

DRAWS = 400
"""Parameter sets of which every run is foretold."""


@dataclass
class _Tables:
    readings: list[Row] = field(default_factory=list)
    runs: list[Row] = field(default_factory=list)
    parameters: list[Row] = field(default_factory=list)
    posteriors: dict[str, Posterior] = field(default_factory=dict)

    @property
    def frames(self) -> dict[str, pd.DataFrame]:
        """The frames of `TrackResults`; without rows they still have their columns."""
        return {
            "readings": pd.DataFrame(self.readings, columns=list(READINGS)),
            "runs": pd.DataFrame(self.runs, columns=list(RUNS)),
            "parameters": pd.DataFrame(self.parameters, columns=list(PARAMETERS)),
        }


@one_thread
def run(name: str, record: TrackStudyRecord, settings: Settings) -> TrackResults:
    """Carry out a study of tip tracks; the posterior is always sampled, for what is foretold is made of it.

    Raises
    ------
    ConfigError, DataError
        If anything the record names is missing or wrong.
    FitError
        If a search finds no point that can be solved.
    """
    begin, dataset = time.time(), read_tracks(find("dataset", record.dataset))
    recipe = load(find("recipe", record.recipe), RecipeRecord)
    if settings.seed is not None:
        recipe = recipe.model_copy(update={"seed": settings.seed})
    tasks = [_task(record, n, dataset, recipe) for n in range(len(record.fits))]
    for one in tasks:
        require_scored(one, record.placed_by_mm)
    doing = {**work(name, record, dataset, tasks), "draws": DRAWS}
    checkpoint = open_checkpoint(settings.checkpoint, settings.resume, doing, settings.note)
    tables = _Tables()
    for one in tasks:
        posterior = _posterior(name, one, settings, checkpoint)
        if posterior is None or posterior.interrupted:
            break
        tables.posteriors[one.name] = posterior
        tables.parameters += learned(one.name, one.problem, posterior)
        _foretell(name, one, posterior, record.placed_by_mm, settings.jobs, tables)
    return TrackResults(
        name=name,
        record=record,
        origin=dataset.origin,
        dataset_title=dataset.title,
        notes=dataset.notes,
        remarks=dataset.remarks,
        **tables.frames,
        run={**doing, **stored(_warnings(name, record, dataset, tasks, settings.place("fits")))},
        timing={"seconds": time.time() - begin, "jobs": settings.jobs, "dataset": str(dataset.path)},
        interrupted=len(tables.posteriors) < len(tasks),
        posteriors=tables.posteriors,
    )


def _task(record: TrackStudyRecord, n: int, dataset: TrackDataset, recipe: RecipeRecord) -> Task:
    with renamed_keys({"fits": f"fits.{n + 1}"}):
        return task(record.fits[n], dataset, recipe)


def _warnings(
    name: str, record: TrackStudyRecord, dataset: TrackDataset, tasks: Sequence[Task], where: str
) -> list[ResultWarning]:
    shared: dict[str, None] = {}
    for one in tasks:
        held = {track.specimen for track in one.held}
        shared |= dict.fromkeys(track.specimen for track in one.problem.tracks if track.specimen in held)
    told = [specimen_warning(name, list(shared), where)] if shared and not record.same_specimen else []
    return [*dataset.warnings, *told]


def _posterior(name: str, task: Task, settings: Settings, checkpoint: Checkpoint) -> Posterior | None:
    """Return the posterior of one fit, from the ends of its searches; None if it was stopped before."""

    def step(done: int, total: int) -> None:
        settings.progress(f"{name}: posterior of {task.name}", done, total)

    seed = task.recipe.seed
    watch = Watch(stop=settings.stop, step=step, jobs=settings.jobs)
    fit = minimize(task.problem, task.recipe, stream(seed, name, task.name, "starts"), watch)
    if fit.interrupted:
        return None
    ends = [fit.theta, *(start.theta for start in practically_equal(fit) if start.theta != fit.theta)]
    rng, kept = stream(seed, name, task.name, "posterior"), checkpoint.snapshots(task.name)
    try:
        return sample(task.problem, np.array(ends), task.recipe.sample, rng, watch, kept)
    except FitError:
        if settings.stop():
            return None
        raise


def _foretell(
    name: str, task: Task, posterior: Posterior, placed_by: float, jobs: int, tables: _Tables
) -> None:
    """Add to the tables what every rival makes of the runs of one fit."""
    problem = task.problem
    held = tuple(track_evidence(track, problem.noise) for track in task.held)
    for rival in RIVALS:
        rng = stream(task.recipe.seed, name, task.name, rival)
        if rival in CURVES:
            drawn = fit_curve(rival, problem.evidence, task.held, DRAWS, rng)
        else:
            drawn = _modelled(task, posterior, jobs)
        head: Row = {"fit": task.name, "rival": rival}
        tables.runs += [{**head, "role": "tune", **row} for row in tuned_rows(problem.evidence, drawn)]
        for row, readings in foretold(problem.evidence, held, drawn, placed_by, rng):
            tables.runs.append({**head, "role": "validate", **row})
            tables.readings += [{**head, **one} for one in readings]


def _modelled(task: Task, posterior: Posterior, jobs: int) -> Drawn:
    """Return the model's draws; those of which a solve fails are left out."""
    problem, tuned = task.problem, len(task.problem.tracks)
    sets = [problem.values(theta) for theta in from_posterior(posterior, problem.parameters, DRAWS).thetas]
    found = tips(sets, problem.medium, problem.needle, (*problem.tracks, *task.held), jobs)
    good = np.all([np.isfinite(one).all(axis=1) for one in found], axis=0)
    scale = np.array([values.get(NOISE_SCALE, 1.0) for values in sets])[good]
    kept = tuple(one[good] for one in found)
    return Drawn(kept[:tuned], kept[tuned:], scale)
