"""Run a study of tip tracks: fit to some runs, predict others, beside baseline curves."""

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from needlefit.datasets.tip_track_table import read_tracks
from needlefit.datasets.tip_tracks import TipTrack, TrackDataset, select_runs
from needlefit.errors import ConfigError, FitError
from needlefit.inference.draws import thin_posterior
from needlefit.inference.fit import Callbacks
from needlefit.inference.identifiability.assessment import is_determined_by_data
from needlefit.inference.identifiability.identify import select_within_tolerance
from needlefit.inference.optimize import minimize
from needlefit.inference.parameters import Parameters, is_logarithmic, with_noise_scale
from needlefit.inference.sampling.posterior import PERCENTILES, Posterior
from needlefit.inference.sampling.sample import sample
from needlefit.inference.ties import NOISE_SCALE
from needlefit.inference.tracks.prediction import TRACK_CURVES, TrackDraws, fit_curve
from needlefit.inference.tracks.problem import TrackProblem, make_track_observation
from needlefit.inference.tracks.simulation import simulate_tips
from needlefit.project.load import load
from needlefit.project.locate import find_file
from needlefit.project.random_streams import random_stream
from needlefit.project.result_warnings import ResultWarning, warnings_entry
from needlefit.project.threads import one_thread
from needlefit.project.toml_lines import add_file_context, add_key_context, locate_key, renamed_keys
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.study import TrackFitRecord, TrackStudyRecord
from needlefit.validation.checkpoint import Checkpoint, open_checkpoint
from needlefit.validation.folds import specimen_warning
from needlefit.validation.job import Settings
from needlefit.validation.provenance import PACKAGES, describe_model_options, package_versions
from needlefit.validation.score import Row
from needlefit.validation.tracks.results import (
    METHODS,
    PARAMETER_COLUMNS,
    READING_COLUMNS,
    RUN_COLUMNS,
    TrackResults,
)
from needlefit.validation.tracks.score import predict_runs, tabulate_tuned


@dataclass(frozen=True)
class TrackTask:
    """One fit of a study: its problem, the runs it is scored on, and the recipe."""

    name: str
    problem: TrackProblem
    held: tuple[TipTrack, ...]
    recipe: RecipeRecord


MIN_SCORED_READINGS = 2
"""Fewest readings of a predicted run that are scored."""


def require_scored(one: TrackTask, placed_by: float) -> None:
    """Raise ConfigError if a predicted run has too few readings beyond `placed_by` mm to be scored."""
    for track in one.held:
        if int((track.depth > placed_by).sum()) < MIN_SCORED_READINGS:
            raise ConfigError(
                f"of run {track.id} nothing is left to be predicted: its readings end at "
                f"{track.depth[-1]:g} mm, and those down to {placed_by:g} mm place it",
                key="registration_depth_mm",
                expected=f"{MIN_SCORED_READINGS} readings below it, at least",
                fix="lower registration_depth_mm, or leave the run out",
            )


def make_task(one: TrackFitRecord, dataset: TrackDataset, recipe: RecipeRecord) -> TrackTask:
    """Return one fit with everything that it names.

    Raises
    ------
    ConfigError
        If a medium or run is missing, stands on both sides, or the needle is too short.
    """
    with add_key_context("fits.medium"):
        file = find_file("medium", one.medium)
    with add_key_context("fits.tune"):
        tuned = select_runs(dataset, one.tune)
    with add_key_context("fits.validate"):
        held = select_runs(dataset, one.validate_)
    medium = load(file, MediumRecord)
    both = sorted({track.id for track in tuned} & {track.id for track in held})
    if both:
        raise ConfigError(
            f"{', '.join(both)} would both tune and validate",
            key="fits",
            expected="runs on one side only",
            fix="narrow tune or validate",
        )
    with add_file_context(file):
        parameters = Parameters.from_record(medium)
    if recipe.likelihood.noise_scale == "estimated":
        parameters = with_noise_scale(parameters)
    _check_needle(dataset, (*tuned, *held), parameters)
    problem = TrackProblem(dataset.needle, tuned, medium, parameters, dataset.noise)
    return TrackTask(one.name, problem, held, recipe)


def _check_needle(dataset: TrackDataset, tracks: tuple[TipTrack, ...], parameters: Parameters) -> None:
    """Refuse a needle whose base would reach the guide."""
    name = "guide_distance_mm"
    far = parameters.bounds[name][1] if name in parameters.bounds else parameters.fixed.get(name, 0.0)
    deepest = max(float(track.depth[-1]) for track in tracks)
    if far + deepest + 1 >= dataset.needle.length:
        raise ConfigError(
            f"a needle of {dataset.needle.length:g} mm is too short for {deepest:.0f} mm of depth and a "
            f"guide {far:g} mm before the skin",
            where=locate_key(dataset.path, "needle.length_mm"),
            fix="write its length, or lessen the bound of guide_distance_mm",
        )


def describe_configuration(
    name: str, record: TrackStudyRecord, dataset: TrackDataset, tasks: Sequence[TrackTask]
) -> dict[str, Any]:
    """Return everything that decides the result, as JSON values."""
    return {
        "name": name,
        "versions": package_versions(PACKAGES),
        "dataset": {
            "name": dataset.name,
            "origin": dataset.origin,
            "sha256": dataset.digest,
            "notes": list(dataset.notes),
            "remarks": list(dataset.remarks),
        },
        "study": record.model_dump(mode="json", by_alias=True),
        "recipe": tasks[0].recipe.model_dump(mode="json", by_alias=True),
        "fits": {
            one.name: {
                "medium": one.problem.medium.model_dump(mode="json", by_alias=True),
                "rules": {**describe_model_options(one.problem.medium), "first_cell": "a whole cell"},
                "tune": [track.id for track in one.problem.tracks],
                "validate": [track.id for track in one.held],
            }
            for one in tasks
        },
    }


def summarize_parameters(fit: str, problem: TrackProblem, posterior: Posterior) -> Iterator[Row]:
    """Yield a row per free parameter: percentiles (Pa, mm), and posterior SD / prior SD."""
    percentiles, flat = posterior.percentiles(), posterior.draws.reshape(-1, len(posterior.names))
    widths = dict(zip(problem.names, problem.upper - problem.lower, strict=True))
    for k, name in enumerate(posterior.names):
        drawn = np.log(flat[:, k]) if is_logarithmic(name) else flat[:, k]
        sd, stated = float(np.std(drawn)), problem.parameters.prior.sd(name)
        before = stated if math.isfinite(stated) else float(widths[name]) / math.sqrt(12)
        heads = (f"p{at:g}".replace(".", "_") for at in PERCENTILES)
        row: Row = {"fit": fit, "parameter": name, **dict(zip(heads, percentiles[name], strict=True))}
        yield row | {"sd_ratio": sd / before, "determined": is_determined_by_data(name, sd, before)}


PREDICTION_DRAWS = 400
"""Parameter sets of which every run is predicted."""


@dataclass
class _TrackRows:
    readings: list[Row] = field(default_factory=list)
    runs: list[Row] = field(default_factory=list)
    parameters: list[Row] = field(default_factory=list)
    posteriors: dict[str, Posterior] = field(default_factory=dict)

    @property
    def frames(self) -> dict[str, pd.DataFrame]:
        """The frames of `TrackResults`; without rows they still have their columns."""
        return {
            "readings": pd.DataFrame(self.readings, columns=list(READING_COLUMNS)),
            "runs": pd.DataFrame(self.runs, columns=list(RUN_COLUMNS)),
            "parameters": pd.DataFrame(self.parameters, columns=list(PARAMETER_COLUMNS)),
        }


@one_thread
def run(name: str, record: TrackStudyRecord, settings: Settings) -> TrackResults:
    """Run a study of tip tracks; the posterior is always sampled, since the predictions need it.

    Raises
    ------
    ConfigError, DataError
        If anything the record names is missing or wrong.
    FitError
        If a search finds no point that can be solved.
    """
    begin, dataset = time.time(), read_tracks(find_file("dataset", record.dataset))
    recipe = load(find_file("recipe", record.recipe), RecipeRecord)
    if settings.seed is not None:
        recipe = recipe.model_copy(update={"seed": settings.seed})
    tasks = [_task(record, n, dataset, recipe) for n in range(len(record.fits))]
    for one in tasks:
        require_scored(one, record.registration_depth_mm)
    doing = {**describe_configuration(name, record, dataset, tasks), "draws": PREDICTION_DRAWS}
    checkpoint = open_checkpoint(settings.checkpoint, settings.resume, doing, settings.note)
    tables = _TrackRows()
    for one in tasks:
        posterior = _sample_posterior(name, one, settings, checkpoint)
        if posterior is None or posterior.interrupted:
            break
        tables.posteriors[one.name] = posterior
        tables.parameters += summarize_parameters(one.name, one.problem, posterior)
        _predict_runs(name, one, posterior, record.registration_depth_mm, settings.jobs, tables)
    return TrackResults(
        name=name,
        record=record,
        origin=dataset.origin,
        dataset_title=dataset.title,
        notes=dataset.notes,
        remarks=dataset.remarks,
        **tables.frames,
        run={**doing, **warnings_entry(_find_warnings(name, record, dataset, tasks, settings.place("fits")))},
        timing={"seconds": time.time() - begin, "jobs": settings.jobs, "dataset": str(dataset.path)},
        interrupted=len(tables.posteriors) < len(tasks),
        posteriors=tables.posteriors,
    )


def _task(record: TrackStudyRecord, n: int, dataset: TrackDataset, recipe: RecipeRecord) -> TrackTask:
    with renamed_keys({"fits": f"fits.{n + 1}"}):
        return make_task(record.fits[n], dataset, recipe)


def _find_warnings(
    name: str, record: TrackStudyRecord, dataset: TrackDataset, tasks: Sequence[TrackTask], where: str
) -> list[ResultWarning]:
    shared: dict[str, None] = {}
    for one in tasks:
        held = {track.specimen for track in one.held}
        shared |= dict.fromkeys(track.specimen for track in one.problem.tracks if track.specimen in held)
    shared_warnings = (
        [specimen_warning(name, list(shared), where)] if shared and not record.same_specimen else []
    )
    return [*dataset.warnings, *shared_warnings]


def _sample_posterior(
    name: str, task: TrackTask, settings: Settings, checkpoint: Checkpoint
) -> Posterior | None:
    """Return the posterior of one fit, from the ends of its searches; None if it was stopped before."""

    def step(done: int, total: int) -> None:
        settings.progress(f"{name}: posterior of {task.name}", done, total)

    seed = task.recipe.seed
    callbacks = Callbacks(stop=settings.stop, step=step, jobs=settings.jobs)
    fit = minimize(task.problem, task.recipe, random_stream(seed, name, task.name, "starts"), callbacks)
    if fit.interrupted:
        return None
    ends = [fit.theta, *(start.theta for start in select_within_tolerance(fit) if start.theta != fit.theta)]
    rng, kept = random_stream(seed, name, task.name, "posterior"), checkpoint.snapshots(task.name)
    try:
        return sample(task.problem, np.array(ends), task.recipe.sample, rng, callbacks, kept)
    except FitError:
        if settings.stop():
            return None
        raise


def _predict_runs(
    name: str, task: TrackTask, posterior: Posterior, placed_by: float, jobs: int, tables: _TrackRows
) -> None:
    """Add to the tables what every method makes of the runs of one fit."""
    problem = task.problem
    held = tuple(make_track_observation(track, problem.noise) for track in task.held)
    for method in METHODS:
        rng = random_stream(task.recipe.seed, name, task.name, method)
        if method in TRACK_CURVES:
            drawn = fit_curve(method, problem.observations, task.held, PREDICTION_DRAWS, rng)
        else:
            drawn = _draw_model_tips(task, posterior, jobs)
        head: Row = {"fit": task.name, "method": method}
        tables.runs += [
            {**head, "role": "tune", **row} for row in tabulate_tuned(problem.observations, drawn)
        ]
        for row, readings in predict_runs(problem.observations, held, drawn, placed_by, rng):
            tables.runs.append({**head, "role": "validate", **row})
            tables.readings += [{**head, **one} for one in readings]


def _draw_model_tips(task: TrackTask, posterior: Posterior, jobs: int) -> TrackDraws:
    """Return the model's draws; those of which a solve fails are left out."""
    problem, tuned = task.problem, len(task.problem.tracks)
    sets = [
        problem.values(theta)
        for theta in thin_posterior(posterior, problem.parameters, PREDICTION_DRAWS).thetas
    ]
    found = simulate_tips(sets, problem.medium, problem.needle, (*problem.tracks, *task.held), jobs)
    good = np.all([np.isfinite(one).all(axis=1) for one in found], axis=0)
    scale = np.array([values.get(NOISE_SCALE, 1.0) for values in sets])[good]
    kept = tuple(one[good] for one in found)
    return TrackDraws(kept[:tuned], kept[tuned:], scale)
