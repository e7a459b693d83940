"""Studies of tip tracks: fit to some runs, and predict others reading by reading, beside baseline curves."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import stdtrit  # scipy.stats takes 0.4 s to load

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.datasets.read import read
from needlefit.datasets.select import select_insertions, select_same_needle
from needlefit.errors import ConfigError
from needlefit.inference import predict
from needlefit.inference.baselines import BASELINES, list_baselines
from needlefit.inference.fit import Callbacks
from needlefit.inference.forward_model import PreparedModel
from needlefit.inference.identifiability.precision import add_estimated_noise
from needlefit.inference.likelihood.observation import Observation
from needlefit.inference.likelihood.observations import make_observation
from needlefit.inference.likelihood.observations.tip_track import list_directions
from needlefit.inference.optimize import minimize
from needlefit.inference.parameter_names import NOISE_SCALE
from needlefit.inference.sampling.importance import resample_draws, sample_about_fit
from needlefit.inference.sampling.posterior import Posterior
from needlefit.inference.sampling.sample import sample
from needlefit.inference.track_predictions import MIN_TUNED_RUNS, predict_by_curve, predict_runs
from needlefit.project.checkpoint import Checkpoint, open_checkpoint
from needlefit.project.locate import find_file
from needlefit.project.random_streams import random_stream
from needlefit.project.result_warnings import to_stored_rows
from needlefit.project.toml import locate_key, renamed_keys
from needlefit.reporting.figures import Drawing
from needlefit.reporting.table import Table
from needlefit.reporting.table_files import to_records
from needlefit.reporting.text import KindText
from needlefit.schemas.recipe import TrackErrorsRecord
from needlefit.schemas.run_metadata import TracksMetadata
from needlefit.schemas.tracks import TrackFitRecord, TrackStudyRecord
from needlefit.studies.advice import advise
from needlefit.studies.answer import Answer, Check, Finding, RunFault, Verdict, find_fault_kind
from needlefit.studies.draw_simulation import vary_bevels
from needlefit.studies.fit_frames import MEDIAN_METHOD
from needlefit.studies.fold_draws import PREDICTION_DRAWS
from needlefit.studies.folds import check_reach, prepare, print_notes
from needlefit.studies.job import Fold, Job, Settings
from needlefit.studies.judge import CLOSER, STATUS, check_data, check_intervals, judge_tracks
from needlefit.studies.kind import StudyKind
from needlefit.studies.provenance import describe_configuration
from needlefit.studies.report import StudyReport, list_data_notes
from needlefit.studies.run import Run
from needlefit.studies.score import Row

KIND = StudyKind("tracks", TrackStudyRecord, __name__, TracksMetadata)

FRAMES: Mapping[str, tuple[str, ...]] = {
    # a row per reading of a run predicted and method; `measured_mm` counts from the run's first reading. The
    # direction is y, or z of runs that were tracked in both.
    "readings": (
        *("fit", "run", "medium", "direction", "method", "depth_mm", "guide_mm", "scored", "measured_mm"),
        *("median_mm", "low_50_mm", "high_50_mm", "low_95_mm", "high_95_mm"),
    ),
    # a row per run predicted and method; `tip_...` at its last reading
    "runs": (
        *("fit", "run", "medium", "direction", "specimen", "method", "readings", "rms_mm", "crps_mm"),
        *("tip_measured_mm", "tip_median_mm", "tip_in_50", "tip_in_95", "tip_95_low_mm", "tip_95_high_mm"),
    ),
    # mean error over the runs into a medium; the method's error minus the fitted model's, and its 95 %
    # interval (Student)
    "methods": ("medium", "direction", "method", "runs", "rms_mm", "difference", "low", "high", "better"),
}

MIN_SCORED_READINGS = 2  #: fewest readings of a predicted run that are scored


# ---- fits and the runs that they are scored on


def make_jobs(
    name: str, record: TrackStudyRecord, one: TrackFitRecord, settings: Settings, dataset: Dataset
) -> Iterator[Job]:
    """Yield one fit, with one fold, or the fits of its folds; runs that are predicted are not fitted to.

    Raises ConfigError if a medium or run is missing, the needle is too short, or a run is predicted in a
    specimen in which none is fitted to.
    """
    job = prepare(name, record.tuning(one), settings, dataset)
    print_notes(job, settings)
    held = select_insertions(job.dataset, one.validate_.selection(), key="validate")
    tuned = select_insertions(job.dataset, one.tune.selection())
    count = min(one.folds or 1, len(held))
    for k in range(count):
        left = held[k::count]
        names = {track.id for track in left}
        kept = tuple(track for track in tuned if track.id not in names)
        fold = Fold(one.name if one.folds is None else f"{one.name}-{k + 1}", kept, left)
        if other := {track.specimen for track in left} - {track.specimen for track in fold.tune}:
            raise ConfigError(
                f"runs into {', '.join(sorted(other))} would be predicted, and none is fitted to",
                key="validate",
                expected="runs into specimens that are fitted",
            )
        found = replace(job, name=fold.name, folds=(fold,))
        check_reach(found)
        yield found


def run(name: str, record: TrackStudyRecord, settings: Settings) -> Run:
    """Fit to runs, and predict others by draws of the posterior: by importance sampling, else by MCMC."""
    dataset, jobs = read(find_file("dataset", record.dataset)), list[Job]()
    if not dataset.noise.slope_sd:
        raise ConfigError(
            "by how much the slopes of runs differ in the tracker's frame is not stated",
            where=locate_key(dataset.path, "noise.slope_sd_deg"),
            expected="[noise] with slope_sd_deg above 0",
        )
    for n, fit_record in enumerate(record.fits, start=1):
        keys = ("medium", "tune", "validate", "priors", "folds")
        with renamed_keys({key: f"fits.{n}.{key}" for key in keys}):
            jobs += make_jobs(name, record, fit_record, settings, dataset)
    placed_by = record.registration_depth_mm
    for track in (track for one in jobs for track in one.folds[0].validate):
        if _count_placed(track, placed_by) > len(track.planar) - MIN_SCORED_READINGS:
            raise ConfigError(
                f"of run {track.id} nothing is left to be predicted: its readings end at "
                f"{track.depth:g} mm, and those down to {placed_by:g} mm place it",
                key="registration_depth_mm",
                expected=f"{MIN_SCORED_READINGS} readings below it, at least",
                fix="lower registration_depth_mm, or leave the run out",
            )
    fits = {one.name: describe_configuration(one) for one in jobs}
    first = fits[jobs[0].name]
    work = TracksMetadata(
        name=name,
        versions=first.versions,
        dataset=first.dataset,
        recipe=first.recipe,
        study=record.model_dump(mode="json", by_alias=True),
        fits={fit: one.to_json() for fit, one in fits.items()},
        prediction_draws=PREDICTION_DRAWS,
    )
    checkpoint = open_checkpoint(settings.checkpoint, settings.resume, work.to_json(), settings.note)
    rows: dict[str, list[Row]] = {"readings": [], "runs": []}
    draws, posteriors = dict[str, predict.Draws](), dict[str, Posterior]()
    for n, one in enumerate(jobs):
        settings.progress(f"{name}: fit {one.name}", n, len(jobs))
        drawn = _draw_posterior(name, one, settings, checkpoint)
        if drawn is None:
            break
        draws[one.name], posterior = drawn
        posteriors |= {} if posterior is None else {one.name: posterior}
        whole = restore_directions(one, dataset)
        for job in (one,) if whole is one else (one, whole):
            found = _predict_runs(name, job, draws[one.name], placed_by, settings.jobs)
            added = "yz" if job is one else "z"  # what was fitted is predicted as it was fitted
            for frame, more in found.items():
                rows[frame] += [row for row in more if str(row["direction"]) in added]
    frames = {key: pd.DataFrame(each, columns=FRAMES[key]) for key, each in rows.items()}
    faults = tuple(
        RunFault(find_fault_kind(one), f"{fit}: {why}") for fit, one in draws.items() for why in one.faults
    )
    return Run(
        kind=KIND.name,
        name=name,
        record=record,
        origin=dataset.origin,
        dataset_title=dataset.title,
        frames={**frames, "methods": compare_methods_by_run(frames["runs"])},
        metadata=work.state(
            draws={fit: one.describe() for fit, one in draws.items()},
            warnings=to_stored_rows(dataset.warnings),
        ),
        timing={"dataset": str(dataset.path)},
        interrupted=len(draws) < len(jobs),
        faults=faults,
        posteriors=posteriors,
    )


def _draw_posterior(
    name: str, job: Job, settings: Settings, checkpoint: Checkpoint
) -> tuple[predict.Draws, Posterior | None] | None:
    """Return draws of the posterior of one fit, from the ends of its searches; None after an early stop."""
    stream, problem = partial(random_stream, job.recipe.seed, name, job.name), job.problem(job.folds[0])
    callbacks = Callbacks(stop=settings.stop, jobs=settings.jobs)
    fit = minimize(problem, job.recipe, stream("starts"), callbacks)
    if fit.interrupted or settings.stop():
        return None
    rng = stream("weighed")
    found = sample_about_fit(problem, fit, rng, settings.jobs)
    if found.certified:
        return resample_draws(found, PREDICTION_DRAWS, rng), None
    known = add_estimated_noise(problem, np.array(fit.theta))
    posterior = sample(known, found, job.recipe.sample, stream("posterior"), callbacks, checkpoint, job.name)
    if posterior is None or posterior.interrupted:
        return None
    return predict.thin_posterior(posterior, job.parameters, PREDICTION_DRAWS, found.k), posterior


# ---- predictions and their scores


def _count_placed(track: Insertion, placed_by: float) -> int:
    """Return how many readings of a run, down to `placed_by` mm, locate it; the others are scored."""
    return max(1, int(np.sum(track.planar[:, 0] <= placed_by)))


def restore_directions(job: Job, dataset: Dataset) -> Job:
    """Return a job with its runs as the dataset has them, in space if all of them were tracked along z."""
    if job.dataset.compared == "space":
        return job
    whole, (fold,) = {one.id: one for one in dataset.insertions}, job.folds
    tune, validate = (tuple(whole[one.id] for one in part) for part in (fold.tune, fold.validate))
    if any(one.directions == 1 for one in (*tune, *validate)):
        return job
    return replace(
        job, dataset=replace(job.dataset, compared="space"), folds=(Fold(fold.name, tune, validate),)
    )


def _predict_runs(
    name: str, job: Job, draws: predict.Draws, placed_by: float, jobs: int
) -> dict[str, list[Row]]:
    """Return rows of what every method makes of the runs of one fit, and of their readings.

    Curves predict each direction by itself.
    """
    (fold,), runs, readings, compared = job.folds, list[Row](), list[Row](), job.dataset.compared
    placed = [_count_placed(track, placed_by) for track in fold.validate]
    # curves are of readings in a frame whose slope they estimate from their own residuals
    exact = {"measurement": "points", "bevel_spread": 0.0, "tip_tracks": TrackErrorsRecord()}
    plain = job.recipe.likelihood.model_copy(update=exact)
    flat = replace(job.dataset, compared="plane")
    tuned, held = (
        [
            [make_observation(flat, one, likelihood=plain) for one in list_directions(track, compared)]
            for track in tracks
        ]
        for tracks in (fold.tune, fold.validate)
    )
    for method in ("fitted", *(one.name for one in list_baselines("tracks"))):
        if method in BASELINES:
            ahead = []
            for run, observed, count in zip(fold.validate, held, placed, strict=True):
                alike = select_same_needle(fold.tune, run.needle, MIN_TUNED_RUNS)
                kept = [own for one, own in zip(fold.tune, tuned, strict=True) if one in alike]
                pairs = zip(zip(*kept, strict=True), observed, strict=True)  # direction by direction
                parts = [predict_by_curve(BASELINES[method], *pair, count) for pair in pairs]
                ahead.append(np.concatenate(parts)[None])
        else:
            rng = random_stream(job.recipe.seed, name, job.name, method)
            ahead = predict_runs(*simulate_runs(job, draws, jobs, rng), placed, rng)
        certified = method not in BASELINES and not draws.faults  # only certified draws predict intervals
        for track, count, predicted in zip(fold.validate, placed, ahead, strict=True):
            parts = np.split(predicted, job.dataset.directions, axis=1)
            for direction, one, part in zip("yz", list_directions(track, compared), parts, strict=False):
                row, rows = _score_run(one, count, part, certified)
                about = {"fit": job.name, "method": method, "direction": direction}
                runs.append({**about, **row})
                readings += [{**about, **each} for each in rows]
    return {"runs": runs, "readings": readings}


def simulate_runs(
    job: Job, draws: predict.Draws, jobs: int, rng: np.random.Generator
) -> tuple[Floats, list[Observation], list[Observation], list[Floats]]:
    """Return the scales of the noise, the runs fitted to and predicted, and the model's curves of both.

    As for `predict_runs`; draws of which a solve fails are left out. Runs fitted to have the needle's bevel,
    those predicted each one of their own.
    """
    (fold,) = job.folds
    problem, noise = job.problem(fold), replace(job.dataset.noise, heading_sd=0.0)
    likelihood = problem.likelihood.model_copy(update={"bevel_spread": 0.0, "measurement": "stored"})
    sets = [problem.values(theta) for theta in draws.thetas]

    def simulate(sets: Sequence[Mapping[str, float]], some: Sequence[Observation]) -> Iterator[Floats]:
        pairs = [pair for one in some for pair in zip(one.nodes.insertions, one.nodes.s, strict=True)]
        every, depths = [run for run, _ in pairs], [at for _, at in pairs]
        points = PreparedModel(job.medium, every).read_points(sets, depths, jobs)
        for one in some:
            yield np.stack([one.stack(next(points)) for _ in one.nodes.s], axis=1)  # (B, m, n or 2 n)

    tuned, held = (
        [make_observation(job.dataset, track, noise, likelihood) for track in tracks]
        for tracks in (fold.tune, fold.validate)
    )
    curves = list(simulate(sets, tuned))
    for one in held:
        curves += simulate(vary_bevels(sets, problem.new_bevel_sd, rng), [one])
    good = np.all([np.isfinite(one).all(axis=(1, 2)) for one in curves], axis=0)
    scale = np.array([values.get(NOISE_SCALE, 1.0) for values in sets])
    return scale[good], tuned, held, [one[good] for one in curves]


def _score_run(track: Insertion, placed: int, predicted: Floats, certified: bool) -> tuple[Row, list[Row]]:
    """Return the row of `runs` and the rows of `readings`; intervals are NaN where not certified.

    `predicted` (B, n - placed) are draws of the readings after the first `placed`, mm.
    """
    mixture = predict.PredictiveMixture(predicted, np.zeros(predicted.shape[1]))
    (depths, tips), guide = track.planar.T, track.guide
    assert guide is not None
    first, measured = tips[0], tips[placed:]
    known = {"measured": measured, "median": predict.quantile(mixture, 0.5)}
    row: Row = {"run": track.id, "medium": track.medium, "specimen": track.specimen}
    row |= {"readings": len(measured), "rms_mm": float(np.sqrt(np.mean((known["median"] - measured) ** 2)))}
    if certified or len(predicted) == 1:  # of a point CRPS is the absolute error
        row["crps_mm"] = float(predict.crps(mixture, measured).mean())
    if certified:
        for level in predict.INTERVAL_PROBABILITIES:
            name, (low, high) = f"{100 * level:.0f}", predict.interval(mixture, level)
            known |= {f"low_{name}": low, f"high_{name}": high, f"{name}_low": low, f"{name}_high": high}
            row[f"tip_in_{name}"] = bool(low[-1] <= measured[-1] <= high[-1])
    row |= {f"tip_{name}_mm": float(of[-1] - first) for name, of in known.items()}
    rows = [
        {
            **{"run": track.id, "medium": track.medium, "depth_mm": float(depth), "guide_mm": float(place)},
            **{f"{name}_mm": float(of[n - placed] - first) for name, of in known.items() if n >= placed},
            **{"scored": n >= placed, "measured_mm": float(tip - first)},
        }
        for n, (depth, place, tip) in enumerate(zip(depths, guide.y, tips, strict=True))
    ]
    return row, rows


def compare_methods_by_run(runs: pd.DataFrame) -> pd.DataFrame:
    """Compare every method with the fitted model on the same predicted runs: the frame "methods"."""
    rows = []
    for place, group in runs.groupby(["medium", "direction"], sort=False):
        wide = group.pivot_table(index="run", columns="method", values="rms_mm", sort=False)
        for method in wide:
            gap = (wide[method] - wide["fitted"]).to_numpy(dtype=np.float64)
            n, half = len(gap), math.nan
            if n > 1:  # half of the 95 % interval of a mean of few differences
                half = float(stdtrit(n - 1, 0.975) * gap.std(ddof=1) / np.sqrt(n))
            difference = (gap.mean(), gap.mean() - half, gap.mean() + half, int((gap > 0).sum()))
            known = (math.nan,) * len(difference) if method == "fitted" else difference
            rows.append((*place, method, n, wide[method].mean(), *known))
    return pd.DataFrame(rows, columns=FRAMES["methods"])


# ---- the report

TEXT = KindText("tracks")


def describe(run: Run) -> dict[str, Any]:
    """Return what the text prints."""
    errors = run.frames["runs"].groupby("method")["rms_mm"].mean()
    curve = str(errors.drop("fitted").idxmin())
    return {
        **{"rms_mm": errors["fitted"], "curve": curve, "curve_mm": errors[curve]},
        "fits": run.frames["runs"]["fit"].nunique(),
        "outcome": judge_tracks(run.frames["runs"], errors["fitted"], errors[curve]),
        "runs": run.frames["runs"]["run"].nunique(),
        "notes": list_data_notes(run),
        "placed_by": run.record.registration_depth_mm,
        "faults": bool(run.faults),
        "name": run.name,
    }


def find_answer(run: Run) -> Answer:
    """Return how the predicted tracks compare with the baselines, and whether their intervals cover."""
    about = describe(run)
    status = STATUS[about["outcome"]]
    numbers = {key: about[key] for key in ("outcome", "rms_mm", "curve", "curve_mm", "runs")}
    errors = about["rms_mm"], about["curve_mm"]
    closer = CLOSER.get(about["outcome"], errors[0] < errors[1])
    checks = [Finding(Check.CURVES, closer, *errors, about["curve"], fits=about["fits"])]
    ends = run.frames["runs"].query("method == 'fitted'").dropna(subset="tip_95_low_mm")
    if len(ends):
        named = ends.rename(columns={"fit": "fold", "run": "hole"})
        checks += check_intervals(named, run.metadata.recipe)
    return Answer(
        [Verdict(TEXT.sentence("answer", about), status, numbers=numbers)],
        REPORT.lay_out(run)[:1],
        TEXT.sentence("about", about | {"title": run.dataset_title}),
        [*checks, check_data(run)],
        None if status == "pass" else advise(["tracks_missed"], about),
    )


def tabulate(run: Run) -> list[Table]:
    """Return the errors of every method on the same runs."""
    named = {"fitted": MEDIAN_METHOD}  # the model predicts by all its draws
    rows = to_records(run.frames["methods"].replace({"method": named}))
    in_space = run.frames["methods"]["direction"].nunique() > 1
    keys = ["medium", "direction"] if in_space else ["medium"]
    columns = (*keys, "runs", "method", "track_error", "track_difference", "better_runs")
    return [Table("scores", rows, columns, groups=tuple(keys), heads=1 + len(keys), strong="groups")]


def draw(run: Run) -> dict[str, Drawing]:
    """Return every predicted run: the tip at each reading, and the guide below it."""
    return {"readings": Drawing("tracks", run.frames["readings"].assign(origin=run.origin))}


REPORT: StudyReport = StudyReport(
    TEXT,
    describe,
    tabulate,
    draw,
    find_answer,
    to_json=lambda run: {"methods": to_records(run.frames["methods"])},
)
