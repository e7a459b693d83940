"""Studies of tip tracks: fit to some runs, and predict others reading by reading, beside baseline curves."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import stdtrit  # scipy.stats takes 0.4 s to load

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Dataset, Insertion, TipTrack
from needlefit.datasets.read import read
from needlefit.datasets.select import select_insertions
from needlefit.errors import ConfigError
from needlefit.inference import predict
from needlefit.inference.baselines import BASELINES, list_baselines
from needlefit.inference.fit import Callbacks, Fit
from needlefit.inference.forward_model import simulate_deflections
from needlefit.inference.identifiability.precision import add_estimated_noise
from needlefit.inference.likelihood.observation import Observation, make_observation
from needlefit.inference.optimize import minimize
from needlefit.inference.parameters import NOISE_SCALE
from needlefit.inference.predict import estimate_proportion
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.importance import resample_draws, sample_about_fit
from needlefit.inference.sampling.posterior import Posterior
from needlefit.inference.sampling.sample import sample
from needlefit.inference.specimens import draw_population, make_spread_model
from needlefit.inference.track_predictions import (
    TrackDraws,
    draw_baseline,
    estimate_slopes,
    list_columns,
    predict_readings,
    predict_runs,
)
from needlefit.project.checkpoint import Checkpoint, open_checkpoint
from needlefit.project.locate import find_file
from needlefit.project.random_streams import random_stream
from needlefit.project.result_warnings import ResultWarning, warnings_entry
from needlefit.project.toml import renamed_keys
from needlefit.reporting.figures import Drawing
from needlefit.reporting.labels import medium_name, method_name
from needlefit.reporting.number_format import choose_printed_unit
from needlefit.reporting.table import Table
from needlefit.reporting.table_files import to_records
from needlefit.reporting.text import KindText
from needlefit.schemas.recipe import RecipeRecord, TrackErrorsRecord
from needlefit.schemas.tracks import TrackFitRecord, TrackStudyRecord
from needlefit.studies.answer import STATUSES, Answer, RunFault, Status, Verdict, find_fault_kind
from needlefit.studies.coverage import warn_if_too_wide
from needlefit.studies.fit_warnings import analysis_bound_warnings
from needlefit.studies.held_out_predictions import PREDICTION_DRAWS
from needlefit.studies.job import Fold, Settings, check_reach, prepare, warn_shared_specimens
from needlefit.studies.kind import StudyKind
from needlefit.studies.planned_draws import vary_bevels
from needlefit.studies.provenance import (
    PACKAGES,
    describe_dataset,
    describe_model_options,
    package_versions,
    plugin_versions_of,
)
from needlefit.studies.report import StudyReport
from needlefit.studies.run import Run
from needlefit.studies.score import Row

KIND = StudyKind("tracks", TrackStudyRecord, __name__)

FRAMES: Mapping[str, tuple[str, ...]] = {
    # a row per reading of a run predicted and method; `measured_mm` counts from the run's first reading
    "readings": (
        *("fit", "run", "medium", "method", "depth_mm", "guide_mm", "scored", "measured_mm"),
        *("median_mm", "low_50_mm", "high_50_mm", "low_95_mm", "high_95_mm"),
    ),
    # a row per run predicted and method: error of the median, also at the last reading; `track_pit` is the
    # probability predicted of a track nearer, at its worst reading, than the one seen
    "runs": (
        *("fit", "run", "medium", "specimen", "method", "readings"),
        *("rms_mm", "end_error_mm", "crps_mm", "end_width_95_mm"),
        *("end_in_50", "end_in_95", "track_pit", "track_in_50", "track_in_95"),
    ),
    # `fitted`: at the posterior's mode
    "parameters": ("fit", "parameter", "fitted", "p2_5", "p50", "p97_5"),
    # the method's error minus the fitted model's, and its 95 % interval (Student) over runs
    "paired": ("medium", "method", "metric", "runs", "value", "difference", "low", "high", "better"),
    # `low`, `high`: 95 % interval of the share; where `medium` is "all", of phantoms as trials
    "coverage": ("medium", "method", "quantity", "level", "covered", "runs", "specimens", "low", "high"),
}

MIN_SCORED_READINGS = 2  #: fewest readings of a predicted run that are scored
MEASURES = ("rms_mm", "crps_mm")  #: of runs, by which methods are compared


def list_track_methods() -> tuple[str, ...]:
    """Return the names of all methods that predict tracks: the fit, then baselines."""
    return ("fitted", *(one.name for one in list_baselines("tracks")))


def name_track_method(method: str) -> str:
    """Return the printed name of a method that predicts tracks; the model does with all draws."""
    known = BASELINES.get(method)
    label = "fitted model" if method == "fitted" else known.track_label if known else ""
    return label or method_name(method)


# ---- fits and the runs that they are scored on


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


def make_tasks(
    name: str, record: TrackStudyRecord, one: TrackFitRecord, settings: Settings, dataset: Dataset
) -> list[TrackTask]:
    """Return one fit with everything that it names, or the fits of its folds.

    Raises ConfigError if a medium or run is missing, stands on both sides, the needle is too short, folds are
    too many, or a predicted run has too few readings that are scored.
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
    check_reach(replace(job, folds=(Fold(one.name, tuned, held),)))
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


def run(name: str, record: TrackStudyRecord, settings: Settings) -> Run:
    """Run a study of tip tracks.

    Runs are predicted by draws of the posterior: by importance sampling, or by MCMC where its weights are not
    certified.
    """
    dataset, tasks = read(find_file("dataset", record.dataset)), list[TrackTask]()
    for n, fit_record in enumerate(record.fits, start=1):
        keys = ("medium", "tune", "validate", "priors", "folds")
        with renamed_keys({key: f"fits.{n}.{key}" for key in keys}):
            tasks += make_tasks(name, record, fit_record, settings, dataset)
    placed_by = record.registration_depth_mm
    for track in (track for one in tasks for track in one.held):
        if int((track.depths > placed_by).sum()) < MIN_SCORED_READINGS:
            raise ConfigError(
                f"of run {track.id} nothing is left to be predicted: its readings end at "
                f"{track.depth:g} mm, and those down to {placed_by:g} mm place it",
                key="registration_depth_mm",
                expected=f"{MIN_SCORED_READINGS} readings below it, at least",
                fix="lower registration_depth_mm, or leave the run out",
            )
    doing = {**_describe_configuration(name, record, dataset, tasks), "prediction_draws": PREDICTION_DRAWS}
    checkpoint = open_checkpoint(settings.checkpoint, settings.resume, doing, settings.note)
    rows: dict[str, list[Row]] = {"readings": [], "runs": [], "parameters": []}
    draws: dict[str, predict.Draws] = {}
    posteriors: dict[str, Posterior] = {}
    for one in tasks:
        drawn = _draw_posterior(name, one, settings, checkpoint)
        if drawn is None:
            break
        fit, draws[one.name], posterior = drawn
        posteriors |= {} if posterior is None else {one.name: posterior}
        sets = [one.problem.values(theta) for theta in draws[one.name].thetas]
        for parameter in one.problem.names:
            ends = np.percentile([values[parameter] for values in sets], (2.5, 50.0, 97.5)).tolist()
            row = {"fit": one.name, "parameter": parameter, "fitted": fit.values[parameter]}
            rows["parameters"].append(row | dict(zip(("p2_5", "p50", "p97_5"), ends, strict=True)))
        found = _predict_runs(name, one, draws[one.name], placed_by, settings.jobs)
        for frame, more in found.items():
            rows[frame] += more
    frames = {key: pd.DataFrame(each, columns=list(FRAMES[key])) for key, each in rows.items()}
    frames |= {
        "paired": compare_methods_by_run(frames["runs"]),
        "coverage": tabulate_coverage(frames["runs"]),
    }
    faults = tuple(
        RunFault(find_fault_kind(one), f"{fit}: {why}") for fit, one in draws.items() for why in one.faults
    )
    warned = _find_warnings(name, record, tasks, frames, settings.place("fits"))
    return Run(
        kind=KIND.name,
        name=name,
        record=record,
        origin=dataset.origin,
        dataset_title=dataset.title,
        frames=frames,
        run={
            **doing,
            "not_converged": list(map(str, faults)),
            "draws": {fit: one.describe() for fit, one in draws.items()},
            **warnings_entry([*dataset.warnings, *warned]),
        },
        timing={"dataset": str(dataset.path)},
        interrupted=len(draws) < len(tasks),
        faults=faults,
        posteriors=posteriors,
    )


def _describe_configuration(
    name: str, record: TrackStudyRecord, dataset: Dataset, tasks: Sequence[TrackTask]
) -> dict[str, Any]:
    """Return everything that decides the result, as JSON values."""
    plugins = {k: v for one in tasks for k, v in plugin_versions_of(one.problem.medium, dataset).items()}
    return {
        "name": name,
        "versions": package_versions(PACKAGES) | plugins,
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


def _draw_posterior(
    name: str, task: TrackTask, settings: Settings, checkpoint: Checkpoint
) -> tuple[Fit, predict.Draws, Posterior | None] | None:
    """Return one fit, and draws of its posterior from the ends of its searches; None after an early stop."""

    def step(done: int, total: int) -> None:
        settings.progress(f"{name}: posterior of {task.name}", done, total)

    stream = partial(random_stream, task.recipe.seed, name, task.name)
    callbacks = Callbacks(stop=settings.stop, step=step, jobs=settings.jobs)
    fit = minimize(task.problem, task.recipe, stream("starts"), callbacks)
    if fit.interrupted or settings.stop():
        return None
    rng = stream("weighed")
    found = sample_about_fit(task.problem, fit, rng, settings.jobs)
    if found.certified:
        return fit, resample_draws(found, PREDICTION_DRAWS, rng), None
    known = add_estimated_noise(task.problem, np.array(fit.theta))
    random = stream("posterior")
    posterior = sample(known, found, task.recipe.sample, random, callbacks, checkpoint, task.name)
    if posterior is None or posterior.interrupted:
        return None
    draws = predict.thin_posterior(posterior, task.problem.parameters, PREDICTION_DRAWS, found.k)
    return fit, draws, posterior


def _find_warnings(
    name: str,
    record: TrackStudyRecord,
    tasks: Sequence[TrackTask],
    frames: Mapping[str, pd.DataFrame],
    where: str,
) -> Iterator[ResultWarning]:
    """Yield the warnings about shared specimens, bounds and wide intervals."""
    if not record.same_specimen:
        yield from warn_shared_specimens(
            name, (Fold(one.name, one.problem.insertions, one.held) for one in tasks), where
        )
    # parameters of which the optimum, or else the interval of the draws, ends at a bound
    bounds = {one.group: one.problem.parameters for one in tasks}
    groups = {one.name: one.group for one in tasks}
    fits = frames["parameters"].assign(fit=frames["parameters"]["fit"].map(groups))
    fits = fits.rename(columns={"fitted": "value"})
    yield from analysis_bound_warnings(fits, bounds)
    yield from analysis_bound_warnings(fits, bounds, intervals=True)
    readings = frames["readings"]
    last = readings[readings["method"] == "fitted"].groupby(["fit", "run"], sort=False).tail(1)
    for medium, some in last.dropna(subset=["low_95_mm"]).groupby("medium", sort=False):
        width = float((some["high_95_mm"] - some["low_95_mm"]).median())
        deflection = float(some["measured_mm"].abs().median())
        yield from warn_if_too_wide(width, deflection, medium_name(str(medium)))


# ---- predictions and their scores


_INTERVAL_KEYS = ("low_", "high_", "crps_", "track_", "end_in_", "end_width_")


def _predict_runs(
    name: str, task: TrackTask, draws: predict.Draws, placed_by: float, jobs: int
) -> dict[str, list[Row]]:
    """Return rows of what every method makes of the runs of one fit, and of their readings."""
    problem, runs, readings = task.problem, list[Row](), list[Row]()
    # readings up to `placed_by` mm locate a run in the tracker's frame; the others are scored
    placed = [max(1, int(np.sum(track.depths <= placed_by))) for track in task.held]
    # curves are of readings in a frame whose slope they estimate from their own residuals
    exact = {"measurement": "points", "bevel_spread": 0.0, "tip_tracks": TrackErrorsRecord()}
    plain = problem.likelihood.model_copy(update=exact)
    tuned, held = (
        tuple(make_observation(problem.dataset, track, likelihood=plain) for track in tracks)
        for tracks in (problem.insertions, task.held)
    )
    for method in list_track_methods():
        rng = random_stream(task.recipe.seed, name, task.name, method)
        if method in BASELINES:
            drawn = draw_baseline(BASELINES[method], tuned, task.held, PREDICTION_DRAWS, rng)
            ahead = [
                predict_readings(
                    known, tip, drawn.scale, estimate_slopes(drawn, tuned, known.insertion), count, rng
                )
                for known, tip, count in zip(held, drawn.held_out, placed, strict=True)
            ]
        else:
            drawn, seen = _draw_model_tips(task, draws, tuned, jobs, rng)
            ahead = predict_runs(drawn, *seen, placed, rng)
        head: Row = {"fit": task.name, "method": method}
        for track, count, predicted in zip(task.held, placed, ahead, strict=True):
            mixture = predict.PredictiveMixture(predicted, np.zeros(predicted.shape[1]))
            row = {"run": track.id, "medium": track.medium, "specimen": track.specimen}
            row |= {"readings": predicted.shape[1], **_score_prediction(mixture, track.tip[count:], rng)}
            found = [{**head, **one} for one in (row, *_reading_rows(track, mixture, count))]
            if draws.faults and method not in BASELINES:  # only certified draws predict intervals
                found = [
                    {key: np.nan if key.startswith(_INTERVAL_KEYS) else x for key, x in one.items()}
                    for one in found
                ]
            runs.append(found[0])
            readings += found[1:]
    return {"runs": runs, "readings": readings}


_SeenRuns = tuple[tuple[Observation, ...], tuple[Observation, ...]]


def _observe_readings(task: TrackTask, slope_sd: float) -> _SeenRuns:
    """Return the runs fitted to and those predicted, by their readings, with the errors of the likelihood."""
    problem = task.problem
    noise = replace(problem.dataset.noise, heading_sd=0.0, slope_sd=slope_sd)
    likelihood = problem.likelihood.model_copy(update={"bevel_spread": 0.0, "measurement": "stored"})

    def observe(tracks: Sequence[Insertion]) -> tuple[Observation, ...]:
        return tuple(make_observation(problem.dataset, track, noise, likelihood) for track in tracks)

    return observe(problem.insertions), observe(task.held)


def _draw_model_tips(
    task: TrackTask,
    draws: predict.Draws,
    plain: Sequence[Observation],
    jobs: int,
    rng: np.random.Generator,
) -> tuple[TrackDraws, _SeenRuns]:
    """Return the model's draws, and the runs with their errors; draws of which a solve fails are left out.

    Runs fitted to, `plain` in frames of any slope, have the needle's bevel, those predicted each one of their
    own. How much slopes differ between runs is estimated where the dataset does not state it.
    """
    problem, slope_sd = task.problem, task.problem.dataset.noise.slope_sd
    sets = [problem.values(theta) for theta in draws.thetas]
    seen = _observe_readings(task, slope_sd)

    def simulate(sets: Sequence[Mapping[str, float]], some: Sequence[Observation]) -> Iterator[Floats]:
        pairs = [pair for one in some for pair in zip(one.nodes.insertions, one.nodes.s, strict=True)]
        every, depths = [run for run, _ in pairs], [at for _, at in pairs]
        curves = iter(simulate_deflections(sets, problem.medium, problem.dataset.needle, every, depths, jobs))
        for one in some:
            yield np.stack([next(curves) for _ in one.nodes.s], axis=1)  # (B, m, n)

    tuned, held = list(simulate(sets, seen[0])), list[Floats]()
    for one in seen[1]:
        further = _move_to_specimen(task, draws, one.insertion.specimen, rng) or sets
        held += simulate(vary_bevels(further, problem.new_bevel_sd, rng), [one])
    good = np.all([np.isfinite(one).all(axis=(1, 2)) for one in (*tuned, *held)], axis=0)
    scale = np.array([values.get(NOISE_SCALE, 1.0) for values in sets])[good]
    tips = [tuple(curves[good, 0] for curves in some) for some in (tuned, held)]
    drawn = TrackDraws(tips[0], tips[1], scale, alike=True)
    if not slope_sd:
        slope_sd = float(np.sqrt(np.median(estimate_slopes(drawn, plain).variance)))
        seen = _observe_readings(task, slope_sd)
    columns = [
        tuple(list_columns(one, curves[good]) for one, curves in zip(known, some, strict=True))
        for known, some in zip(seen, (tuned, held), strict=True)
    ]
    return replace(drawn, tuned_columns=columns[0], held_out_columns=columns[1]), seen


def _move_to_specimen(
    task: TrackTask, draws: predict.Draws, specimen: str, rng: np.random.Generator
) -> list[dict[str, float]]:
    """Return the draws' sets of values in a specimen that was not tuned on; none if it was."""
    problem = task.problem
    if specimen in {one.specimen for one in problem.insertions}:
        return []
    model = make_spread_model(problem, task.recipe.specimens, draws.thetas.mean(axis=0))
    moved = draw_population(problem.parameters, model, {"": draws.thetas}, len(draws.thetas), rng)
    return [problem.values(theta) for theta in moved.new]


def _score_prediction(mixture: predict.PredictiveMixture, measured: Floats, rng: np.random.Generator) -> Row:
    off = predict.quantile(mixture, 0.5) - measured
    level = predict.simulate_shape_pit(mixture, np.zeros((len(measured), len(measured))), measured, rng)
    row: Row = {"rms_mm": float(np.sqrt(np.mean(off**2))), "end_error_mm": float(off[-1])}
    row |= {"crps_mm": float(predict.crps(mixture, measured).mean()), "track_pit": level}
    for wanted in predict.INTERVAL_PROBABILITIES:
        name = f"{100 * wanted:.0f}"
        low, high = predict.interval(mixture, wanted)
        within = (low <= measured) & (measured <= high)
        row |= {f"end_in_{name}": bool(within[-1]), f"track_in_{name}": level <= wanted}
        row |= {f"end_width_{name}_mm": float(high[-1] - low[-1])}
    return row


def _reading_rows(track: TipTrack, mixture: predict.PredictiveMixture, placed: int) -> Iterator[Row]:
    predicted = {"median_mm": predict.quantile(mixture, 0.5)}
    for level in predict.INTERVAL_PROBABILITIES:
        low, high = predict.interval(mixture, level)
        predicted |= {f"low_{100 * level:.0f}_mm": low, f"high_{100 * level:.0f}_mm": high}
    first = track.tip[0]
    for n, (depth, guide, tip) in enumerate(zip(track.depths, track.guide, track.tip, strict=True)):
        known = {
            name: float(of[n - placed] - first) if n >= placed else np.nan for name, of in predicted.items()
        }
        about = {"depth_mm": float(depth), "guide_mm": float(guide), "scored": n >= placed}
        yield {"run": track.id, "medium": track.medium, **about, "measured_mm": float(tip - first), **known}


# ---- summaries


def compare_methods_by_run(runs: pd.DataFrame) -> pd.DataFrame:
    """Compare every method with the fitted model on the same predicted runs: the frame "paired"."""
    rows = []
    for medium, group in runs.groupby("medium", sort=False):
        for measure in MEASURES:
            wide = group.pivot_table(index="run", columns="method", values=measure, sort=False)
            if "fitted" not in wide:  # its draws are not certified: no CRPS
                continue
            for method in [name for name in list_track_methods() if name in wide]:
                gap = (wide[method] - wide["fitted"]).to_numpy(dtype=np.float64)
                n, half = len(gap), math.nan
                if n > 1:  # half of the 95 % interval of a mean of few differences
                    half = float(stdtrit(n - 1, 0.975) * gap.std(ddof=1) / np.sqrt(n))
                difference = (gap.mean(), gap.mean() - half, gap.mean() + half, int((gap > 0).sum()))
                rows.append((medium, method, measure, n, wide[method].mean(), *difference))
    return pd.DataFrame(rows, columns=list(FRAMES["paired"]))


def tabulate_coverage(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the coverage of last-reading intervals and whole-track bands: the frame "coverage"."""
    rows, held = [], runs.dropna(subset="track_pit")  # uncertified: no interval
    for medium, group in [*held.groupby("medium", sort=False), ("all", held)]:
        for method, some in group.groupby("method", sort=False):
            trials = some["specimen" if medium == "all" else "run"].tolist()
            for what in ("end", "track"):
                for level in (50, 95):
                    found = estimate_proportion(some[f"{what}_in_{level}"].tolist(), trials)
                    counted = (found.hits, found.trials, some["specimen"].nunique(), found.low, found.high)
                    rows.append((medium, method, what, level, *counted))
    return pd.DataFrame(rows, columns=list(FRAMES["coverage"]))


# ---- the report

TEXT = KindText("tracks")


def describe(results: Run) -> dict[str, Any]:
    """Return what the text prints."""
    paired, data = results.frames["paired"], results.run["dataset"]
    return {
        "media": [
            {"name": medium_name(str(medium)), "found": _compare(group)}
            for medium, group in paired[paired["metric"] == "rms_mm"].groupby("medium", sort=False)
        ],
        "remarks": data["remarks"],
        "notes": data["notes"],
        "placed_by": results.record.registration_depth_mm,
        "faults": bool(results.faults),
        "name": results.name,
    }


def _compare(group: pd.DataFrame) -> dict[str, list[str]]:
    """Return the methods by how the fit compares: better or worse if the interval excludes 0."""
    verdicts: dict[str, list[str]] = {}
    for row in to_records(group[group["method"] != "fitted"]):
        low, high = row["low"], row["high"]
        if low is None or high is None:  # a single run has no scatter
            words = "on one run, without an interval, compared with"
        else:
            words = (
                "better than" if low > 0 else "worse than" if high < 0 else "not significantly different from"
            )
        verdicts.setdefault(words, []).append(f"the {name_track_method(str(row['method']))}")
    return verdicts


def find_answer(results: Run) -> Answer:
    """Return for each medium how the predicted tips compare with the baselines; the worst stands first."""
    verdicts = []
    for one in describe(results)["media"]:
        found = one["found"]
        status: Status = (
            "fail" if "worse than" in found else "pass" if {*found} == {"better than"} else "warn"
        )
        verdicts.append(Verdict(TEXT.sentence("medium", {"one": one}), status, one["name"]))
    worst = max(verdicts, key=lambda one: STATUSES.index(one.status))
    joined = replace(worst, sentence="; ".join(one.sentence for one in verdicts), group="")
    return Answer([joined, *(verdicts if len(verdicts) > 1 else ())], REPORT.lay_out(results)[:1])


def tabulate(results: Run) -> list[Table]:
    """Return the errors of every method on the same runs, the coverage of intervals, and the estimates."""
    frames = {name: to_records(frame) for name, frame in results.frames.items()}
    scores = [
        {**row, "method": name_track_method(row["method"])}
        | ({"difference": "", "better": ""} if row["method"] == "fitted" else {})
        for row in frames["paired"]
        if row["metric"] == "rms_mm"
    ]
    covered: dict[tuple[str, str], Row] = {}
    for row in frames["coverage"]:
        names = {"medium": row["medium"], "method": name_track_method(row["method"])}
        covered.setdefault((row["medium"], row["method"]), names)[
            f"{row['quantity']}_in_{row['level']:g}"
        ] = f"{row['covered']} of {row['runs']} ({100 * row['low']:.0f}–{100 * row['high']:.0f} %)"
    parameters = []
    for row in frames["parameters"]:
        label, unit = choose_printed_unit(str(row["parameter"]), [row["p97_5"]])
        scaled = {one: None if row[one] is None else row[one] / unit for one in ("p2_5", "p50", "p97_5")}
        parameters.append({**row, **scaled, "parameter": label})
    each, compared = ("medium", "method"), ("track_error", "track_difference", "better_runs")
    of_coverage = ("end_in_50", "end_in_95", "track_in_50", "track_in_95")
    estimated = ("fit", "parameter", "p2_5", "p50", "p97_5")
    of_media: dict[str, Any] = {"groups": ("medium",), "strong": "groups"}
    return [
        Table("scores", scores, ("medium", "runs", "method", *compared), **of_media),
        Table("coverage", list(covered.values()), (*each, *of_coverage), **of_media),
        Table("parameters", parameters, estimated),
    ]


def draw(results: Run) -> dict[str, Drawing]:
    """Return every predicted run: the tip at each reading, and the guide below it."""
    return {"readings": Drawing("tracks", results.frames["readings"].assign(origin=results.origin))}


REPORT: StudyReport = StudyReport(
    TEXT,
    describe,
    tabulate,
    draw,
    find_answer,
    to_json=lambda results: {"paired": to_records(results.frames["paired"])},
)
