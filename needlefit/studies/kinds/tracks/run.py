"""Run a study of tip tracks: fit to some runs, predict others, beside baseline curves."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.datasets.read import read
from needlefit.datasets.select import select_insertions
from needlefit.datasets.tip_tracks import TipTrack
from needlefit.errors import ConfigError, FitError
from needlefit.inference.baselines import BASELINES
from needlefit.inference.fit import Callbacks, Fit
from needlefit.inference.forward_model import simulate_deflections
from needlefit.inference.identifiability.identify import identify, select_within_tolerance
from needlefit.inference.likelihood.observation import make_observation
from needlefit.inference.optimize import minimize
from needlefit.inference.parameters import NOISE_SCALE, Parameters, is_logarithmic
from needlefit.inference.predict import Draws, thin_posterior
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.importance import escalate_effort, resample_draws, sample_about_fit
from needlefit.inference.sampling.posterior import PERCENTILES, Posterior
from needlefit.inference.sampling.sample import Snapshots, sample
from needlefit.inference.tracking import TrackDraws, draw_baseline
from needlefit.project.checkpoint import Checkpoint, open_checkpoint
from needlefit.project.locate import find_file
from needlefit.project.random_streams import random_stream
from needlefit.project.result_warnings import ResultWarning, warnings_entry
from needlefit.project.toml_lines import locate_key, renamed_keys
from needlefit.reporting.labels import medium_name
from needlefit.reporting.table_files import to_records
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.tracks import TrackFitRecord, TrackStudyRecord
from needlefit.studies.fit_warnings import analysis_bound_warnings, cut_off_warnings
from needlefit.studies.folds import Fold, specimen_warning
from needlefit.studies.interval_width import warn_if_too_wide
from needlefit.studies.job import Settings, farthest_guide, prepare
from needlefit.studies.kinds.tracks import KIND
from needlefit.studies.kinds.tracks.results import (
    FRAMES,
    PARAMETER_COLUMNS,
    add_summaries,
    list_track_methods,
    name_track_method,
)
from needlefit.studies.kinds.tracks.score import predict_runs, remove_intervals, tabulate_tuned
from needlefit.studies.planned_draws import vary_bevels
from needlefit.studies.posterior_fit import PREDICTION_DRAWS
from needlefit.studies.provenance import (
    PACKAGES,
    describe_dataset,
    describe_model_options,
    package_versions,
    plugin_versions_of,
)
from needlefit.studies.run import Run
from needlefit.studies.score import Row


@dataclass(frozen=True)
class TrackTask:
    """One fit of a study: its problem, the runs it is scored on, and the recipe.

    `group` is the name of the fit in the study's file, which its folds share.
    """

    name: str
    problem: Problem
    held: tuple[TipTrack, ...]
    recipe: RecipeRecord
    group: str = ""


MIN_SCORED_READINGS = 2
"""Fewest readings of a predicted run that are scored."""


def require_scored(one: TrackTask, placed_by: float) -> None:
    """Raise ConfigError if a predicted run has too few readings beyond `placed_by` mm to be scored."""
    for track in one.held:
        if int((track.depths > placed_by).sum()) < MIN_SCORED_READINGS:
            raise ConfigError(
                f"of run {track.id} nothing is left to be predicted: its readings end at "
                f"{track.depth:g} mm, and those down to {placed_by:g} mm place it",
                key="registration_depth_mm",
                expected=f"{MIN_SCORED_READINGS} readings below it, at least",
                fix="lower registration_depth_mm, or leave the run out",
            )


def make_tasks(
    name: str, record: TrackStudyRecord, one: TrackFitRecord, settings: Settings, dataset: Dataset
) -> list[TrackTask]:
    """Return one fit with everything that it names, or the fits of its folds.

    Raises
    ------
    ConfigError
        If a medium or run is missing, stands on both sides, the needle is too short, or folds are too many.
    """
    held = select_insertions(dataset, one.validate_.selection(), key="validate")
    tuned = select_insertions(dataset, one.tune.selection())
    both = sorted({track.id for track in tuned} & {track.id for track in held})
    if both and one.folds is None:
        raise ConfigError(
            f"{', '.join(both)} would both tune and validate",
            key="tune",
            expected="runs on one side only",
            fix="narrow tune or validate, or give folds",
        )
    if one.folds is not None and one.folds > len(held):
        raise ConfigError(
            f"{len(held)} runs cannot be dealt into {one.folds} folds",
            key="folds",
            expected=f"{len(held)} at most",
        )
    job = prepare(name, record.tuning(one), settings, dataset)
    _check_needle(dataset, (*tuned, *held), job.parameters)
    tracks = tuple(track for track in held if isinstance(track, TipTrack))
    if one.folds is None:
        return [TrackTask(one.name, job.problem(job.folds[0]), tracks, job.recipe, one.name)]
    tasks = []
    for k in range(one.folds):
        left = tracks[k :: one.folds]
        names = {track.id for track in left}
        fold = Fold(f"{one.name}-{k + 1}", tuple(run for run in tuned if run.id not in names), left)
        tasks.append(TrackTask(fold.name, job.problem(fold), left, job.recipe, one.name))
    return tasks


def _check_needle(dataset: Dataset, tracks: Sequence[Insertion], parameters: Parameters) -> None:
    """Refuse a needle whose base would reach the guide on the way of any run, predicted ones too."""
    far = max(farthest_guide(parameters, track) for track in tracks)
    deepest = max(track.depth for track in tracks)
    if far + deepest + 1 >= dataset.needle.length:
        raise ConfigError(
            f"a needle of {dataset.needle.length:g} mm is too short for {deepest:.0f} mm of depth and a "
            f"guide {far:g} mm before the skin",
            where=locate_key(dataset.path, "needle.length_mm"),
            fix="write its length, or lessen the bound of guide_distance_mm",
        )


def describe_configuration(
    name: str, record: TrackStudyRecord, dataset: Dataset, tasks: Sequence[TrackTask]
) -> dict[str, Any]:
    """Return everything that decides the result, as JSON values."""
    return {
        "name": name,
        "versions": package_versions(PACKAGES)
        | {k: v for one in tasks for k, v in plugin_versions_of(one.problem.medium, dataset).items()},
        "dataset": describe_dataset(dataset) | {"remarks": list(dataset.remarks)},
        "study": record.model_dump(mode="json", by_alias=True),
        "recipe": tasks[0].recipe.model_dump(mode="json", by_alias=True),
        "fits": {
            one.name: {
                "medium": one.problem.medium.model_dump(mode="json", by_alias=True),
                "rules": {**describe_model_options(one.problem.medium), "first_cell": "a whole cell"},
                "tune": [track.id for track in one.problem.insertions],
                "validate": [track.id for track in one.held],
            }
            for one in tasks
        },
    }


def summarize_parameters(name: str, problem: Problem, fit: Fit, draws: Draws) -> Iterator[Row]:
    """Yield a row per free parameter: percentiles (Pa, mm), posterior SD / prior SD, and what it needs.

    Of draws that are not certified, no parameter is called determined.
    """
    verdict = identify(problem, fit, draws.certified)
    sets = [problem.values(theta) for theta in draws.thetas]
    widths = dict(zip(problem.names, problem.upper - problem.lower, strict=True))
    for parameter in problem.names:
        values = np.array([one[parameter] for one in sets])
        drawn = np.log(values) if is_logarithmic(parameter) else values
        sd, stated = float(np.std(drawn)), problem.parameters.prior.sd(parameter)
        before = stated if math.isfinite(stated) else float(widths[parameter]) / math.sqrt(12)
        heads = (f"p{at:g}".replace(".", "_") for at in PERCENTILES)
        row: Row = {
            "fit": name,
            "parameter": parameter,
            "fitted": fit.values[parameter],
            **dict(zip(heads, np.percentile(values, PERCENTILES).tolist(), strict=True)),
        }
        found = {
            "sd_ratio": sd / before,
            "determined": not draws.faults and verdict.determined[parameter],
            "condition": "" if draws.faults else verdict.conditions[parameter],
            "note": "not determined: no certified draws" if draws.faults else verdict.notes[parameter],
        }
        yield row | found


@dataclass
class _TrackRows:
    readings: list[Row] = field(default_factory=list)
    runs: list[Row] = field(default_factory=list)
    parameters: list[Row] = field(default_factory=list)
    draws: dict[str, Draws] = field(default_factory=dict)
    posteriors: dict[str, Posterior] = field(default_factory=dict)

    @property
    def frames(self) -> dict[str, pd.DataFrame]:
        """The frames of the run; without rows they still have their columns."""
        rows = {"readings": self.readings, "runs": self.runs, "parameters": self.parameters}
        return add_summaries(
            {name: pd.DataFrame(found, columns=list(FRAMES[name])) for name, found in rows.items()}
        )


def run(name: str, record: TrackStudyRecord, settings: Settings) -> Run:
    """Run a study of tip tracks.

    Runs are predicted by draws of the posterior: by importance sampling, or by MCMC if that is asked for, or
    where the weights cannot be trusted.

    Raises
    ------
    ConfigError, DataError
        If anything the record names is missing or wrong.
    FitError
        If a search finds no point that can be solved.
    """
    dataset = read(find_file("dataset", record.dataset))
    tasks = [task for n in range(len(record.fits)) for task in _tasks(name, record, n, settings, dataset)]
    for one in tasks:
        require_scored(one, record.registration_depth_mm)
    doing = {**describe_configuration(name, record, dataset, tasks), "prediction_draws": PREDICTION_DRAWS}
    checkpoint = open_checkpoint(settings.checkpoint, settings.resume, doing, settings.note)
    tables = _TrackRows()
    for one in tasks:
        drawn = _draw_posterior(name, one, settings, checkpoint, tables)
        if drawn is None:
            break
        fit, draws = drawn
        tables.draws[one.name] = draws
        tables.parameters += summarize_parameters(one.name, one.problem, fit, draws)
        _predict_runs(name, one, draws, record.registration_depth_mm, settings.jobs, tables)
    faults = tuple(f"{fit}: {why}" for fit, one in tables.draws.items() for why in one.faults)
    warnings = _find_warnings(name, record, dataset, tasks, settings.place("fits"))
    warnings += _warn_of_bounds(tasks, tables)
    frames = tables.frames
    warnings += [*_warn_of_baselines(frames["paired"]), *_warn_of_width(frames["readings"])]
    return Run(
        kind=KIND.name,
        name=name,
        record=record,
        origin=dataset.origin,
        dataset_title=dataset.title,
        frames=frames,
        run={
            **doing,
            "not_converged": list(faults),
            "draws": {fit: one.describe() for fit, one in tables.draws.items()},
            **warnings_entry(warnings),
        },
        timing={"dataset": str(dataset.path)},
        interrupted=len(tables.draws) < len(tasks),
        faults=faults,
        posteriors=tables.posteriors,
    )


def _tasks(
    name: str, record: TrackStudyRecord, n: int, settings: Settings, dataset: Dataset
) -> list[TrackTask]:
    keys = ("medium", "tune", "validate", "priors", "folds")
    with renamed_keys({key: f"fits.{n + 1}.{key}" for key in keys}):
        return make_tasks(name, record, record.fits[n], settings, dataset)


def _find_warnings(
    name: str, record: TrackStudyRecord, dataset: Dataset, tasks: Sequence[TrackTask], where: str
) -> list[ResultWarning]:
    shared: dict[str, None] = {}
    for one in tasks:
        held = {track.specimen for track in one.held}
        shared |= dict.fromkeys(track.specimen for track in one.problem.insertions if track.specimen in held)
    shared_warnings = (
        [specimen_warning(name, list(shared), where)] if shared and not record.same_specimen else []
    )
    return [*dataset.warnings, *shared_warnings]


def _warn_of_bounds(tasks: Sequence[TrackTask], tables: _TrackRows) -> Iterator[ResultWarning]:
    """Yield the parameters of which the optimum, or else the interval of the draws, ends at a bound."""
    parameters = {one.group: one.problem.parameters for one in tasks}
    groups = {one.name: one.group for one in tasks}
    fits = pd.DataFrame(tables.parameters, columns=list(PARAMETER_COLUMNS))
    fits = fits.assign(fit=fits["fit"].map(groups)).rename(columns={"fitted": "value"})
    yield from analysis_bound_warnings(fits, parameters)
    yield from cut_off_warnings(fits, parameters)


def _warn_of_baselines(paired: pd.DataFrame) -> Iterator[ResultWarning]:
    """Yield, by medium, the closest curve without a model, if it is significantly closer than the fit."""
    rows = [row for row in to_records(paired) if row["metric"] == "rms_mm"]
    for medium in dict.fromkeys(row["medium"] for row in rows):
        better = [row for row in rows if row["medium"] == medium and (row["high"] or 0) < 0]
        if better:
            best = min(better, key=lambda row: float(row["value"]))
            error, fit = best["value"], best["value"] - best["difference"]
            yield ResultWarning(
                "worse_than_baseline",
                f"the {name_track_method(str(best['method']))} is closer to the predicted tips on "
                f"{medium_name(medium)} than the fitted model (mean error {error:.2f} mm against "
                f"{fit:.2f} mm)",
                fix="do not rely on this model there; fit to runs with guide moves like those predicted",
            )


def _warn_of_width(readings: pd.DataFrame) -> Iterator[ResultWarning]:
    """Yield the media whose last readings are predicted with wide intervals."""
    last = readings.query("method == 'fitted'").groupby(["fit", "run"], sort=False).tail(1)
    for medium, some in last.dropna(subset=["low_95_mm"]).groupby("medium", sort=False):
        width = float((some["high_95_mm"] - some["low_95_mm"]).median())
        yield from warn_if_too_wide(
            width, float(some["measured_mm"].abs().median()), medium_name(str(medium))
        )


def _draw_posterior(
    name: str, task: TrackTask, settings: Settings, checkpoint: Checkpoint, tables: _TrackRows
) -> tuple[Fit, Draws] | None:
    """Return one fit, and draws of its posterior from the ends of its searches; None after an early stop.

    A sampled posterior is kept in `tables`.
    """

    def step(done: int, total: int) -> None:
        settings.progress(f"{name}: posterior of {task.name}", done, total)

    seed = task.recipe.seed
    callbacks = Callbacks(stop=settings.stop, step=step, jobs=settings.jobs, pool=settings.part_pool)
    fit = minimize(task.problem, task.recipe, random_stream(seed, name, task.name, "starts"), callbacks)
    if fit.interrupted or settings.stop():
        return None
    pareto_k = math.nan
    if not settings.sample:
        rng = random_stream(seed, name, task.name, "weighed")
        jobs, pool = settings.jobs, settings.part_pool
        found = escalate_effort(lambda effort: sample_about_fit(task.problem, fit, rng, jobs, effort, pool))
        if found.certified:
            return fit, resample_draws(found, PREDICTION_DRAWS, rng)
        pareto_k = found.k
    ends = [fit.theta, *(start.theta for start in select_within_tolerance(fit) if start.theta != fit.theta)]
    rng, kept = random_stream(seed, name, task.name, "posterior"), Snapshots(checkpoint, task.name)
    try:
        posterior = sample(task.problem, np.array(ends), task.recipe.sample, rng, callbacks, kept)
    except FitError:
        if settings.stop():
            return None
        raise
    if posterior.interrupted:
        return None
    tables.posteriors[task.name] = posterior
    return fit, thin_posterior(posterior, task.problem.parameters, PREDICTION_DRAWS, pareto_k)


def _predict_runs(
    name: str, task: TrackTask, draws: Draws, placed_by: float, jobs: int, tables: _TrackRows
) -> None:
    """Add to the tables what every method makes of the runs of one fit."""
    problem = task.problem
    # predicted are readings, in a frame whose slope every method tells from its own residuals
    plain = problem.likelihood.model_copy(update={"measurement": "points", "bevel_spread": 0.0})
    tuned, held = (
        tuple(make_observation(problem.dataset, track, likelihood=plain) for track in runs)
        for runs in (problem.insertions, task.held)
    )
    for method in list_track_methods():
        rng = random_stream(task.recipe.seed, name, task.name, method)
        if method in BASELINES:
            drawn = draw_baseline(BASELINES[method], tuned, task.held, PREDICTION_DRAWS, rng)
        else:
            drawn = _draw_model_tips(task, draws, jobs, rng)
        head: Row = {"fit": task.name, "method": method}
        uncertified = bool(draws.faults) and method not in BASELINES
        tables.runs += [{**head, "role": "tune", **row} for row in tabulate_tuned(tuned, drawn)]
        for row, readings in predict_runs(tuned, held, drawn, placed_by, rng):
            if uncertified:
                row, *readings = map(remove_intervals, (row, *readings))
            tables.runs.append({**head, "role": "validate", **row})
            tables.readings += [{**head, **one} for one in readings]


def _draw_model_tips(task: TrackTask, draws: Draws, jobs: int, rng: np.random.Generator) -> TrackDraws:
    """Return the model's draws; those of which a solve fails are left out.

    Runs fitted to have the needle's bevel, those predicted each one of their own.
    """
    problem = task.problem
    sets = [problem.values(theta) for theta in draws.thetas]
    tuned = _simulate_runs(sets, problem, problem.insertions, jobs)
    new_bevel_sd, held = problem.new_bevel_sd, list[Floats]()
    for run in task.held:
        held += _simulate_runs(vary_bevels(sets, new_bevel_sd, rng), problem, (run,), jobs)
    good = np.all([np.isfinite(one).all(axis=1) for one in (*tuned, *held)], axis=0)
    scale = np.array([values.get(NOISE_SCALE, 1.0) for values in sets])[good]
    return TrackDraws(tuple(one[good] for one in tuned), tuple(one[good] for one in held), scale)


def _simulate_runs(
    sets: Sequence[Mapping[str, float]], problem: Problem, runs: Sequence[Insertion], jobs: int
) -> tuple[Floats, ...]:
    """Return the tips (B, n) of runs at their readings, mm; NaN where a solve fails."""
    depths = [run.planar[:, 0] for run in runs]
    return simulate_deflections(sets, problem.medium, problem.dataset.needle, runs, depths, jobs)
