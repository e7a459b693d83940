"""Predict the runs of tip tracks that a fold holds out, reading by reading, beside baseline curves."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.folds import Fold
from needlefit.datasets.insertion import Insertion
from needlefit.datasets.select import select_same_needle
from needlefit.errors import ConfigError
from needlefit.geometry.curves import compare_curves
from needlefit.grouping import group_values
from needlefit.inference.baselines import BASELINES, list_baselines
from needlefit.inference.curve_bands import find_bands
from needlefit.inference.draw_simulation import vary_bevels
from needlefit.inference.draws import Draws
from needlefit.inference.forward_model import PreparedModel
from needlefit.inference.later_readings import (
    MIN_TUNED_RUNS,
    PredictedReadings,
    predict_by_curve,
    predict_runs,
)
from needlefit.inference.likelihood.observation import Observation
from needlefit.inference.likelihood.observations import make_observation
from needlefit.inference.likelihood.observations.tip_track import follow_guide, split_directions
from needlefit.inference.parameter_names import NOISE_SCALE
from needlefit.inference.point_prediction import PointPrediction, choose_point
from needlefit.inference.predictive_mixture import PredictiveMixture
from needlefit.inference.problem import Problem
from needlefit.metrics import TRACK_RMS
from needlefit.project.callbacks import Step
from needlefit.reporting.figures import Drawing
from needlefit.reporting.table_files import Row
from needlefit.schemas.recipe import TrackErrorsRecord
from needlefit.schemas.run_metadata import CountMetadata
from needlefit.schemas.study import StudyRecord
from needlefit.studies.fit_figures import select_by_rank
from needlefit.studies.fold_draws import Specimens
from needlefit.studies.job import Job
from needlefit.studies.observations import (
    PREDICTIVE_COLUMNS,
    HeldOutPrediction,
    StudiedObservation,
    describe_held_out,
)
from needlefit.studies.prediction_scores import list_band_ends, score_tip
from needlefit.studies.run import PREDICTION_METHOD, FitFrames, Run
from needlefit.studies.score import Scorer, make_scorer

NAME = "tip_track"
MIN_SCORED_READINGS = 2  #: smallest number of readings of a predicted track that are scored
# a row per reading of a run predicted, direction and method; `measured_mm` counts from the run's first
# reading, `scored` are those below the depth that places it in the tracker's frame
READING_COLUMNS = (
    *("fold", "run", "medium", "direction", "method", "depth_mm", "guide_mm", "scored", "measured_mm"),
    *("predicted_mm", "low_50_mm", "high_50_mm", "low_95_mm", "high_95_mm"),
)
# a row per run, direction, method and depth down to which its readings register it; `depth_mm` is its end
END_COLUMNS = (
    *("fold", "run", "medium", "direction", "method", "registered_mm", "depth_mm", "measured_mm"),
    *("predicted_mm", "low_95_mm", "high_95_mm"),
)
MAX_PANELS = 20  #: largest number of panels of runs: a page has room for 5 rows of 4
END_PARTS = 4  #: number of equal parts of the readings ahead, after each of which an end is predicted again


def check_tracks(job: Job) -> None:
    """Refuse tracks of which nothing is left to be predicted, or that nothing places in their frame."""
    tracks = [track for fold in job.folds for track in fold.validate if track.observation == NAME]
    if not tracks:
        return
    depth = _registration_depth(job)
    if depth is None:
        raise ConfigError(
            "tip tracks are predicted, and nothing places them in the tracker's frame",
            key="registration_depth_mm",
            expected="the depth up to which a run's own readings do, mm",
        )
    for fold in job.folds:
        fitted, held = (
            [run for run in part if run.observation == NAME] for part in (fold.tune, fold.validate)
        )
        if held and not fitted:
            raise ConfigError(
                f"all tip tracks of {fold.name} would be predicted, and none is fitted to",
                key="folds" if isinstance(job.record, StudyRecord) and job.record.folds else "validate",
                expected="runs on both sides: they estimate what all share, and the curves beside the model",
            )
    for track in tracks:
        if count_registered(track, depth) > len(track.points) - MIN_SCORED_READINGS:
            raise ConfigError(
                f"of run {track.id} nothing is left to be predicted: its readings end at "
                f"{track.depth:g} mm, and those down to {depth:g} mm place it",
                key="registration_depth_mm",
                expected=f"{MIN_SCORED_READINGS} readings below it, at least",
                fix="lower registration_depth_mm, or leave the run out",
            )


def _registration_depth(job: Job) -> float | None:
    return job.record.registration_depth_mm if isinstance(job.record, StudyRecord) else None


def count_registered(track: Insertion, depth_mm: float) -> int:
    """Return how many readings of a track, down to a depth, place it in the tracker's frame."""
    return max(1, int(np.sum(track.points[:, 0] <= depth_mm)))


def predict_tracks(
    specimens: Specimens, tracks: Sequence[Insertion], bands: bool, step: Step
) -> Iterator[HeldOutPrediction]:
    """Yield the prediction of every run, with the errors of every method: root mean squares over readings.

    What was fitted along y alone is compared along y; where all runs were tracked along z, too, their
    readings there are predicted as in space.
    """
    job, done = specimens.job, 0
    tuned = tuple(insertion for insertion in specimens.fold.tune if insertion.observation == NAME)
    for of_specimen in group_values((track.specimen, track) for track in tracks).values():
        fold = replace(specimens.fold, tune=tuned, validate=tuple(of_specimen))
        predictions, whole = _predict_runs(specimens, job, fold), _restore_directions(job, fold)
        further = [] if whole is None else _predict_runs(specimens, *whole)
        for n, prediction in enumerate(predictions):
            rows = dict(prediction.rows)
            for table in ("readings", "ends") if further else ():
                rows[table] = [
                    *rows[table],
                    *(row for row in further[n].rows[table] if row["direction"] == "z"),
                ]
            yield replace(prediction, rows=rows)
            step(done := done + 1, len(tracks))


def _restore_directions(job: Job, fold: Fold) -> tuple[Job, Fold] | None:
    """Return a job and its fold in space, if all its runs were tracked along more than what is compared."""
    whole = fold.of_dataset(job.measured)
    if min(insertion.directions for insertion in (*whole.tune, *whole.validate)) == job.dataset.directions:
        return None
    return replace(job, dataset=replace(job.dataset, compared="space")), whole


def _predict_runs(specimens: Specimens, job: Job, fold: Fold) -> list[HeldOutPrediction]:
    """Return the predictions of the runs of a fold into one specimen.

    `job` may compare in space, unlike that of `specimens`.
    """
    depth, held = _registration_depth(job), fold.validate[0]
    assert depth is not None
    thetas, modes = dict[str, Floats](), dict[str, Floats]()
    for run in (*fold.tune, held):  # draws that are not certified are of all specimens together
        draws = replace(specimens.draws, faults=specimens.faults)
        draws = draws if draws.faults else specimens.draws_in(run)
        mode = draws.mode if draws.faults else specimens.mode_in(run)
        assert mode is not None
        thetas[run.specimen], modes[run.specimen] = draws.thetas, mode
    problem = job.problem(specimens.fold if job is specimens.job else specimens.fold.of_dataset(job.measured))
    placed = [count_registered(track, depth) for track in fold.validate]
    rng = job.random(job.name, fold.name, "fitted")
    bevel_sd = specimens.bevel_sd_in(held)
    simulated = simulate_runs(problem, fold, thetas, specimens.jobs, (bevel_sd, rng))
    ahead = predict_runs(*simulated, placed, rng)
    chosen, fitted, points = _choose_readings(
        problem, fold, modes, ahead, placed, specimens.jobs, are_certified=not draws.faults
    )
    methods = {PREDICTION_METHOD: points, "fitted": fitted, **_predict_by_curves(job, fold, placed)}
    scorer, predictions = make_scorer(job), list[HeldOutPrediction]()
    # how a moved guide leads a needle is known from runs with one, or as well as the recipe states
    led = any(insertion.guided for insertion in fold.tune) or job.recipe.likelihood.tip_tracks.gain_sd > 0
    ends = [] if draws.faults else _predict_ends(job, fold, simulated, placed, rng)
    for n, (run, drawn) in enumerate(zip(fold.validate, ahead, strict=True)):
        errors, readings = list[Row](), list[Row]()
        certain = drawn if not draws.faults and (led or not run.guided) else None
        for method, predicted in methods.items():
            place = {"fold": fold.name, "role": "validate", "insertion": run.id, "method": method}
            errors.append(_score_run(scorer, place, run, placed[n], predicted[n], drawn.sd))
            if method != "fitted":
                shown = certain if method == PREDICTION_METHOD else None
                readings += _list_readings(fold, run, method, placed[n], predicted[n], shown)
        rows = {"errors": errors, "readings": readings, "ends": ends[n] if certain is not None else []}
        if certain is not None:
            rows["predictive"] = [_describe_run(specimens, job, run, placed[n], certain, draws)]
        count = CountMetadata(simulations=len(drawn.values), outside=0)
        predictions.append(HeldOutPrediction(run.id, rows, count, chosen))
    return predictions


def _predict_ends(
    job: Job,
    fold: Fold,
    simulated: tuple[Floats, list[Observation], list[Observation], list[Floats]],
    placed: Sequence[int],
    rng: np.random.Generator,
) -> list[list[Row]]:
    """Return the rows of "ends" of every run, predicted again as its readings come."""
    rows: list[list[Row]] = [[] for _ in fold.validate]
    for part in range(END_PARTS):
        counts = [
            count + part * (len(run.points) - count) // END_PARTS
            for run, count in zip(fold.validate, placed, strict=True)
        ]
        ahead = predict_runs(*simulated, counts, rng)
        curves = _predict_by_curves(job, fold, counts)
        for n, (run, count) in enumerate(zip(fold.validate, counts, strict=True)):
            left, registered = len(run.points) - count, float(run.points[count - 1, 0])
            for number, direction in enumerate("yz"[: job.dataset.directions]):
                last, first = (number + 1) * left - 1, run.points[0, 1 + number]
                quantiles = np.quantile(ahead[n].values[:, last], [0.5, 0.025, 0.975])
                ends = {PREDICTION_METHOD: quantiles} | {
                    name: np.array([predicted[n][last], math.nan, math.nan])
                    for name, predicted in curves.items()
                }
                for method, tips in ends.items():
                    places = np.array([run.points[-1, 1 + number], *tips]) - first
                    about = (fold.name, run.id, run.medium, direction, method, registered, run.depth)
                    rows[n].append(dict(zip(END_COLUMNS, (*about, *places.tolist()), strict=True)))
    return rows


def _predict_by_curves(job: Job, fold: Fold, placed: Sequence[int]) -> dict[str, list[Floats]]:
    """Return by baseline the later readings of every run, mm; curves predict each direction by itself."""
    # curves are of readings in a frame whose slope they estimate from their own residuals
    exact = {"measurement": "points", "bevel_spread": 0.0, "tip_tracks": TrackErrorsRecord()}
    plain = job.recipe.likelihood.model_copy(update=exact)
    flat, directions = replace(job.dataset, compared="plane"), job.dataset.directions

    def observe(track: Insertion) -> list[Observation]:
        return [
            make_observation(flat, flat_track, likelihood=plain)
            for flat_track in split_directions(track, directions)
        ]

    tuned = {insertion.id: observe(insertion) for insertion in fold.tune}
    by_curves: dict[str, list[Floats]] = {baseline.name: [] for baseline in list_baselines("tracks")}
    for run, count in zip(fold.validate, placed, strict=True):
        alike = [
            tuned[insertion.id] for insertion in select_same_needle(fold.tune, run.needle, MIN_TUNED_RUNS)
        ]
        pairs = list(zip(zip(*alike, strict=True), observe(run), strict=True))  # direction by direction
        for name, curves in by_curves.items():
            parts = [
                predict_by_curve(BASELINES[name], *pair, count, job.dataset.noise.slope_sd) for pair in pairs
            ]
            curves.append(np.concatenate(parts))
    return by_curves


def _choose_readings(
    problem: Problem,
    fold: Fold,
    modes: Mapping[str, Floats],
    ahead: Sequence[PredictedReadings],
    placed: Sequence[int],
    jobs: int,
    *,
    are_certified: bool,
) -> tuple[PointPrediction, list[Floats], list[Floats]]:
    """Return which prediction of all runs is reported, and the readings (n - k,) of the mode and of it, mm.

    `modes`, theta (P,), by specimen. Of draws that are not certified there is no median.
    """
    mode, specimen = modes[fold.validate[0].specimen], fold.validate[0].specimen
    drawn = np.concatenate([observation.values for observation in ahead], axis=1)

    def predict_all(theta: Floats) -> Floats:
        thetas = {name: of_specimen[None] for name, of_specimen in {**modes, specimen: theta}.items()}
        simulated = simulate_runs(problem, fold, thetas, jobs)
        solved = len(simulated[0]) > 0
        means = [readings.values for readings in predict_runs(*simulated, placed)]
        return np.hstack(means)[0] if solved else np.full(drawn.shape[1], np.nan)

    predicted, point = predict_all(mode), PointPrediction()
    if are_certified:
        point = choose_point(problem, mode, drawn, predict_all)
    ends = np.cumsum([observation.values.shape[1] for observation in ahead])[:-1]
    return point, np.split(predicted, ends), np.split(point.take(predicted, drawn), ends)


def simulate_runs(
    problem: Problem,
    fold: Fold,
    thetas: Mapping[str, Floats],
    jobs: int,
    bevels: tuple[float, np.random.Generator] | None = None,
) -> tuple[Floats, list[Observation], list[Observation], list[Floats]]:
    """Return the scales of the noise, the runs fitted to and predicted, and the model's curves of both.

    As for `predict_runs`, whose runs predicted are of one specimen; `thetas` (B, P), by specimen, of which a
    solve fails are left out. Runs fitted to have the needle's bevel, those predicted each one of their own,
    by the SD and the generator of `vary_bevels`; without `bevels` the same.
    """
    dataset = problem.dataset
    noise = replace(dataset.noise, heading_sd=0.0)
    likelihood = problem.likelihood.model_copy(update={"bevel_spread": 0.0, "measurement": "stored"})
    sets = {
        specimen: [problem.values(theta) for theta in of_specimen] for specimen, of_specimen in thetas.items()
    }

    def simulate(sets: Sequence[Mapping[str, float]], observation: Observation) -> Floats:
        """Return the curves (B, m, n) of a run."""
        model = PreparedModel(problem.medium, observation.nodes.insertions)
        points = model.read_points(sets, [*observation.nodes.s], jobs)
        return np.stack([*map(observation.stack, points)], axis=1)

    tuned, held = (
        [make_observation(dataset, track, noise, likelihood, respond=problem.respond) for track in tracks]
        for tracks in (fold.tune, fold.validate)
    )
    curves = [simulate(sets[observation.insertion.specimen], observation) for observation in tuned]
    ours = sets[fold.validate[0].specimen]
    curves += [simulate(ours if bevels is None else vary_bevels(ours, *bevels), run) for run in held]
    good = np.all([np.isfinite(curve).all(axis=(1, 2)) for curve in curves], axis=0)
    scale = np.array([values.get(NOISE_SCALE, 1.0) for values in ours])
    return scale[good], tuned, held, [curve[good] for curve in curves]


def _score_run(scorer: Scorer, place: Row, run: Insertion, placed: int, predicted: Floats, sd: Floats) -> Row:
    """Return the row of "errors" of a method that predicts readings (n - placed,) after the first ones, mm.

    The noise floor is what a run with the right parameters misses them by: `sd` (B, n - placed), mm.
    """
    directions, first = scorer.dataset.directions, run.points[0] * [0.0, 1.0, 1.0]
    measured = (run.points - first)[:, : 1 + directions]
    ours = measured.copy()
    ours[placed:, 1:] = predicted.reshape(directions, -1).T - first[1 : 1 + directions]
    floor = {TRACK_RMS.name: float(np.sqrt(np.mean(sd**2) * directions))}
    curves = compare_curves(ours[placed:], measured[placed:], scorer.dataset.compared, "readings")
    row = scorer.describe({**place, "boundaries": "measured"}, run, floor)
    row |= scorer.compute_errors(run, [curves])
    row["deflection_mm"], row["predicted_deflection_mm"] = (
        run.side * float(coordinate[-1, 1]) for coordinate in (measured, ours)
    )
    return row


def _describe_run(
    specimens: Specimens,
    job: Job,
    run: Insertion,
    placed: int,
    drawn: PredictedReadings,
    draws: Draws,
) -> Row:
    """Return the row of "predictive": the tip at the last reading along y, and all readings as a shape."""
    count = drawn.values.shape[1] // job.dataset.directions
    first, measured = run.points[0, 1], run.points[placed:, 1 : 1 + job.dataset.directions].T.ravel()
    mixture = PredictiveMixture(drawn.values, np.zeros(drawn.values.shape[1]))
    along_y = PredictiveMixture(drawn.values[:, :count] - first, np.zeros(count))
    row = {
        **describe_held_out(specimens, run, draws, mixture, measured, find_bands(drawn.values)),
        **score_tip(along_y, measured[:count] - first),
    }
    return {name: row.get(name) for name in PREDICTIVE_COLUMNS}


def _list_readings(
    fold: Fold,
    run: Insertion,
    method: str,
    placed: int,
    predicted: Floats,
    drawn: PredictedReadings | None,
) -> Iterator[Row]:
    """Yield the rows of "readings" of a method; `predicted` (n - placed,), mm, are those along y before z.

    `drawn` are those by draws, of which there are simultaneous bands; None without.
    """
    count = len(run.points) - placed
    for number, flat in enumerate(split_directions(run, len(predicted) // count)):
        part, (depths, tips, _) = slice(number * count, (number + 1) * count), flat.points.T
        columns = {"predicted_mm": predicted[part]}
        if drawn is not None:
            ends = list_band_ends(find_bands(drawn.values[:, part]))
            columns |= {f"{name}_mm": end for name, end in ends.items()}
        for n, guide in enumerate(follow_guide(flat, depths)):
            about = (fold.name, run.id, run.medium, "yz"[number], method, depths[n], guide)
            row = dict(zip(READING_COLUMNS, (*about, n >= placed, tips[n] - tips[0]), strict=False))
            later = {name: ends[n - placed] - tips[0] for name, ends in columns.items() if n >= placed}
            yield dict.fromkeys(READING_COLUMNS, math.nan) | row | later


def draw_tracks(run: Run, role: str) -> dict[str, Drawing]:
    """Return predicted runs by rank of their errors: the tip at each reading and the guide below it."""
    frames = FitFrames.of(run)
    readings = frames.readings
    if readings.empty:
        return {}
    errors = frames.select_errors(method=PREDICTION_METHOD)
    errors = errors[errors["insertion"].isin(readings["run"])]
    count = MAX_PANELS // readings["direction"].nunique()
    runs = select_by_rank(errors, TRACK_RMS.name, count)["insertion"].tolist()
    return {"readings": Drawing("tip_track.draw", readings, {"runs": runs})}


TIP_TRACK = StudiedObservation(NAME, draw_tracks, predict_tracks, has_errors=True, check=check_tracks)
