"""Predict the runs of tip tracks that a fold holds out, reading by reading, beside baseline curves."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.folds import Fold
from needlefit.datasets.insertion import Insertion
from needlefit.datasets.select import select_same_needle
from needlefit.inference import predict
from needlefit.inference.baselines import BASELINES, list_baselines
from needlefit.inference.curve_bands import find_bands
from needlefit.inference.draw_simulation import vary_bevels
from needlefit.inference.forward_model import PreparedModel
from needlefit.inference.likelihood.observation import Observation
from needlefit.inference.likelihood.observations import make_observation
from needlefit.inference.likelihood.observations.tip_track import split_directions
from needlefit.inference.parameter_names import NOISE_SCALE
from needlefit.inference.point_prediction import PointPrediction, choose_point
from needlefit.inference.track_predictions import MIN_TUNED_RUNS, predict_by_curve, predict_runs
from needlefit.project.random_streams import random_stream
from needlefit.schemas.recipe import TrackErrorsRecord
from needlefit.schemas.study import StudyRecord
from needlefit.studies.fit_warnings import describe_point
from needlefit.studies.job import Job
from needlefit.studies.load import count_registered
from needlefit.studies.score import Row

# a row per reading of a run predicted, direction and method; `measured_mm` counts from the run's first
# reading, `scored` are those below the depth that places it in the tracker's frame
READING_COLUMNS = (
    *("fold", "run", "medium", "direction", "method", "depth_mm", "guide_mm", "scored", "measured_mm"),
    *("predicted_mm", "low_50_mm", "high_50_mm", "low_95_mm", "high_95_mm"),
)
# a row per run predicted, direction (y, or z of runs that were tracked in both) and method: errors of the
# readings scored; `tip_...` at the last one
RUN_COLUMNS = (
    *("fold", "run", "medium", "direction", "specimen", "method", "readings", "rms_mm", "crps_mm"),
    *("tip_measured_mm", "tip_predicted_mm", "tip_in_50", "tip_in_95", "tip_95_low_mm", "tip_95_high_mm"),
)


def predict_tracks(job: Job, fold: Fold, draws: predict.Draws, jobs: int) -> dict[str, list[Row]]:
    """Return the rows of `runs` and `readings` of the runs that a fold holds out, by every method.

    Those of `medians` name runs whose prediction is the predictive median.

    What was fitted along y alone is predicted as it was fitted, and along z as in space, where all runs were
    tracked there.
    """
    found = _predict_runs(job, fold, draws, jobs)
    if (whole := _restore_directions(job, fold)) is not None:
        for frame, rows in _predict_runs(*whole, draws, jobs).items():
            found[frame] += [row for row in rows if row.get("direction") == "z"]
    return found


def _restore_directions(job: Job, fold: Fold) -> tuple[Job, Fold] | None:
    """Return a job and its fold in space, if all its runs were tracked along more than what is compared."""
    whole = fold.of_dataset(job.measured)
    if min(one.directions for one in (*whole.tune, *whole.validate)) == job.dataset.directions:
        return None
    return replace(job, dataset=replace(job.dataset, compared="space")), whole


def _predict_runs(job: Job, fold: Fold, draws: predict.Draws, jobs: int) -> dict[str, list[Row]]:
    """Return rows of what every method makes of the runs of one fit, and of their readings.

    Curves predict each direction by itself.
    """
    runs, readings, medians, directions = list[Row](), list[Row](), list[Row](), job.dataset.directions
    assert isinstance(job.record, StudyRecord) and job.record.registration_depth_mm is not None
    placed = [count_registered(track, job.record.registration_depth_mm) for track in fold.validate]
    # curves are of readings in a frame whose slope they estimate from their own residuals
    exact = {"measurement": "points", "bevel_spread": 0.0, "tip_tracks": TrackErrorsRecord()}
    plain = job.recipe.likelihood.model_copy(update=exact)
    flat = replace(job.dataset, compared="plane")
    tuned, held = (
        [
            [make_observation(flat, one, likelihood=plain) for one in split_directions(track, directions)]
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
                slope_sd = job.dataset.noise.slope_sd
                parts = [predict_by_curve(BASELINES[method], *pair, count, slope_sd) for pair in pairs]
                ahead.append(np.concatenate(parts)[None])
            points = [one[0] for one in ahead]
        else:
            rng = random_stream(job.recipe.seed, job.name, fold.name, method)
            ahead = predict_runs(*simulate_runs(job, fold, draws.thetas, jobs, rng), placed, rng)
            chosen, points = _choose_readings(job, fold, draws, ahead, placed, jobs)
            about = describe_point(chosen, job.parameters)
            medians += [
                {"fold": fold.name, "insertion": run.id, **about} for run in fold.validate if chosen.is_median
            ]
        certified = method not in BASELINES and not draws.faults
        steered = any(one.guided for one in fold.tune)
        for track, count, predicted, point in zip(fold.validate, placed, ahead, points, strict=True):
            split = zip(np.split(predicted, directions, axis=1), np.split(point, directions), strict=True)
            axes = zip("yz", split_directions(track, directions), split, strict=False)
            for direction, one, (part, mean) in axes:
                # how a moved guide leads a needle, no run at rest has tested
                row, rows = _score_run(one, count, part, mean, certified, steered or not track.guided)
                about = {"fold": fold.name, "method": method, "direction": direction}
                runs.append({**about, **row})
                readings += [{**about, **each} for each in rows]
    return {"runs": runs, "readings": readings, "medians": medians}


def _choose_readings(
    job: Job, fold: Fold, draws: predict.Draws, ahead: Sequence[Floats], placed: Sequence[int], jobs: int
) -> tuple[PointPrediction, list[Floats]]:
    """Return which prediction of all runs held out is reported, and the readings (n - k,) of each, mm.

    `ahead` (B, n - k) are those of draws; of draws that are not certified there is no median.
    """
    assert draws.mode is not None
    drawn = np.concatenate(ahead, axis=1)

    def predict_all(theta: Floats) -> Floats:
        simulated = simulate_runs(job, fold, theta[None], jobs)
        solved = len(simulated[0]) > 0
        return np.hstack(predict_runs(*simulated, placed))[0] if solved else np.full(drawn.shape[1], np.nan)

    point = PointPrediction()
    if not draws.faults:
        point = choose_point(job.problem(fold), draws.mode, drawn, predict_all)
    ends = np.cumsum([one.shape[1] for one in ahead])[:-1]
    return point, np.split(point.take(predict_all(draws.mode), drawn), ends)


def simulate_runs(
    job: Job, fold: Fold, thetas: Floats, jobs: int, rng: np.random.Generator | None = None
) -> tuple[Floats, list[Observation], list[Observation], list[Floats]]:
    """Return the scales of the noise, the runs fitted to and predicted, and the model's curves of both.

    As for `predict_runs`; `thetas` (B, P) of which a solve fails are left out. Runs fitted to have the
    needle's bevel, those predicted each one of their own, without `rng` the same.
    """
    problem, noise = job.problem(fold), replace(job.dataset.noise, heading_sd=0.0)
    likelihood = problem.likelihood.model_copy(update={"bevel_spread": 0.0, "measurement": "stored"})
    sets = [problem.values(theta) for theta in thetas]

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
        varied = sets if rng is None else vary_bevels(sets, problem.new_bevel_sd, rng)
        curves += simulate(varied, [one])
    good = np.all([np.isfinite(one).all(axis=(1, 2)) for one in curves], axis=0)
    scale = np.array([values.get(NOISE_SCALE, 1.0) for values in sets])
    return scale[good], tuned, held, [one[good] for one in curves]


def _score_run(
    track: Insertion, placed: int, predicted: Floats, point: Floats, certified: bool, tested: bool
) -> tuple[Row, list[Row]]:
    """Return the row of `runs` and the rows of `readings`; intervals are of certified draws, where tested.

    `predicted` (B, n - placed) are draws of the readings after the first `placed`, mm, `point` (n - placed,)
    is their prediction.
    """
    mixture = predict.PredictiveMixture(predicted, np.zeros(predicted.shape[1]))
    (depths, tips, _), guide = track.points.T, track.guide
    assert guide is not None
    first, measured = tips[0], tips[placed:]
    known = {"measured": measured, "predicted": point}
    row: Row = {"run": track.id, "medium": track.medium, "specimen": track.specimen}
    row |= {"readings": len(measured), "rms_mm": float(np.sqrt(np.mean((point - measured) ** 2)))}
    if certified or len(predicted) == 1:  # of a point CRPS is the absolute error
        row["crps_mm"] = float(predict.crps(mixture, measured).mean())
    if certified:
        bands, shown = find_bands(predicted), 1.0 if tested else math.nan
        for level in predict.INTERVAL_PROBABILITIES:
            name, ends = f"{100 * level:.0f}", bands.ends(level)
            known |= {f"{side}_{name}": shown * end for side, end in zip(("low", "high"), ends, strict=True)}
            low, high = (shown * float(end[-1]) for end in predict.interval(mixture, level))
            row[f"tip_in_{name}"] = bool(low <= measured[-1] <= high) if tested else None
            if level == max(predict.INTERVAL_PROBABILITIES):
                row |= {"tip_95_low_mm": low - float(first), "tip_95_high_mm": high - float(first)}
    row |= {f"tip_{name}_mm": float(known[name][-1] - first) for name in ("measured", "predicted")}
    rows = [
        {
            **{"run": track.id, "medium": track.medium, "depth_mm": float(depth), "guide_mm": float(place)},
            **{f"{name}_mm": float(of[n - placed] - first) for name, of in known.items() if n >= placed},
            **{"scored": n >= placed, "measured_mm": float(tip - first)},
        }
        for n, (depth, place, tip) in enumerate(zip(depths, guide.y, tips, strict=True))
    ]
    return row, rows
