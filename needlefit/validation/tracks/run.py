"""The verb: fit to these runs, foretell those, beside curves that know neither tissue nor guide."""

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from needlefit.datasets.tracks.read import read_tracks
from needlefit.datasets.tracks.select import select_runs
from needlefit.datasets.tracks.track import Track, TrackDataset
from needlefit.errors import ConfigError, FitError
from needlefit.inference.draws import from_posterior
from needlefit.inference.identify import practically_equal
from needlefit.inference.optimize import minimize
from needlefit.inference.parameters import Parameters, with_noise_scale
from needlefit.inference.posterior import Posterior
from needlefit.inference.sample import sample
from needlefit.inference.starts import Watch
from needlefit.inference.ties import NOISE_SCALE
from needlefit.inference.tracks.course import tips
from needlefit.inference.tracks.curves import CURVES, fit_curve
from needlefit.inference.tracks.evidence import track_evidence
from needlefit.inference.tracks.foresight import Drawn
from needlefit.inference.tracks.problem import TrackProblem
from needlefit.project.load import load
from needlefit.project.places import find
from needlefit.project.records.medium import MediumRecord
from needlefit.project.records.recipe import RecipeRecord
from needlefit.project.records.track_study import TrackFitRecord, TrackStudyRecord
from needlefit.project.streams import stream
from needlefit.validation.checkpoint import Checkpoint, open_checkpoint
from needlefit.validation.job import Settings
from needlefit.validation.provenance import PACKAGES, rules, versions
from needlefit.validation.score import Row
from needlefit.validation.tracks.learned import learned
from needlefit.validation.tracks.results import PARAMETERS, READINGS, RIVALS, RUNS, TrackResults
from needlefit.validation.tracks.score import foretold, tuned_rows

DRAWS = 400
"""Parameter sets of which every run is foretold."""


@dataclass(frozen=True)
class Task:
    """One fit of a study: its problem, the runs it is judged by, and the recipe."""

    name: str
    problem: TrackProblem
    held: tuple[Track, ...]
    recipe: RecipeRecord


@dataclass
class _Tables:
    readings: list[Row] = field(default_factory=list)
    runs: list[Row] = field(default_factory=list)
    parameters: list[Row] = field(default_factory=list)
    posteriors: dict[str, Posterior] = field(default_factory=dict)


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
    tasks = [_task(one, dataset, recipe) for one in record.fits]
    work = _work(name, record, dataset, recipe, tasks)
    checkpoint, tables = open_checkpoint(settings.checkpoint, settings.resume, work), _Tables()
    for task in tasks:
        posterior = _posterior(name, task, settings, checkpoint)
        if posterior is None or posterior.interrupted:
            break
        tables.posteriors[task.name] = posterior
        tables.parameters += learned(task.name, task.problem, posterior)
        _foretell(name, task, posterior, record.placed_by_mm, settings.jobs, tables)
    return TrackResults(
        name=name,
        title=record.title or name,
        question=record.question,
        note=record.note,
        record=record,
        origin=dataset.origin,
        dataset_title=dataset.title,
        notes=dataset.notes,
        remarks=dataset.remarks,
        readings=pd.DataFrame(tables.readings, columns=list(READINGS)),
        runs=pd.DataFrame(tables.runs, columns=list(RUNS)),
        parameters=pd.DataFrame(tables.parameters, columns=list(PARAMETERS)),
        run=work,
        timing={"seconds": time.time() - begin, "jobs": settings.jobs, "dataset": str(dataset.path)},
        interrupted=len(tables.posteriors) < len(tasks),
        posteriors=tables.posteriors,
    )


def _task(one: TrackFitRecord, dataset: TrackDataset, recipe: RecipeRecord) -> Task:
    medium = load(find("medium", one.medium), MediumRecord)
    tuned, held = select_runs(dataset, one.tune), select_runs(dataset, one.validate_)
    both = sorted({track.id for track in tuned} & {track.id for track in held})
    if both:
        raise ConfigError(
            f"{', '.join(both)} would both tune and validate",
            where=f"fits, {one.name}",
            expected="runs on one side only",
            mend="narrow tune or validate",
        )
    parameters = Parameters.from_record(medium)
    if recipe.likelihood.noise_scale == "estimated":
        parameters = with_noise_scale(parameters)
    _check_needle(dataset, (*tuned, *held), parameters)
    problem = TrackProblem(dataset.needle, tuned, medium, parameters, dataset.noise)
    return Task(one.name, problem, held, recipe)


def _check_needle(dataset: TrackDataset, tracks: tuple[Track, ...], parameters: Parameters) -> None:
    """Refuse a needle whose base would reach the guide."""
    name = "guide_distance_mm"
    far = parameters.bounds[name][1] if name in parameters.bounds else parameters.fixed.get(name, 0.0)
    deepest = max(float(track.depth[-1]) for track in tracks)
    if far + deepest + 1 >= dataset.needle.length:
        raise ConfigError(
            f"a needle of {dataset.needle.length:g} mm is too short for {deepest:.0f} mm of depth and a "
            f"guide {far:g} mm before the skin",
            where=f"dataset {dataset.name}, needle.length_mm",
            mend="write its length, or lessen the bound of guide_distance_mm",
        )


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


def _work(
    name: str, record: TrackStudyRecord, dataset: TrackDataset, recipe: RecipeRecord, tasks: list[Task]
) -> dict[str, Any]:
    """Return all that decides the result, as JSON values."""
    return {
        "name": name,
        "versions": versions(PACKAGES),
        "dataset": {
            "name": dataset.name,
            "origin": dataset.origin,
            "sha256": dataset.digest,
            "notes": list(dataset.notes),
            "remarks": list(dataset.remarks),
        },
        "study": record.model_dump(mode="json", by_alias=True),
        "recipe": recipe.model_dump(mode="json", by_alias=True),
        "draws": DRAWS,
        "fits": {
            task.name: {
                "medium": task.problem.medium.model_dump(mode="json", by_alias=True),
                "rules": {**rules(task.problem.medium), "first_cell": "a whole cell"},
                "tune": [track.id for track in task.problem.tracks],
                "validate": [track.id for track in task.held],
            }
            for task in tasks
        },
    }
