"""Predict held-out needles: the predictive distribution of each, compared with its measurement.

A draw of the parameters gives one needle, through the layers that its own planned path meets, with depths of
layers and insertion drawn as the dataset states their errors; about it stand the errors of pose and points.
The measured shape enters nowhere but as what is compared (and laid on, where its pose is free). What the
model misses is not predicted: where coverage falls short of its level, that is why, or the stated errors are
too small. A needle is one trial: its tip, and its shape as a whole, which holds if no point of it leaves a
band that the predicted probability of such needles stays within all along.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.insertion import Insertion
from needlefit.datasets.select import count_layers
from needlefit.geometry.frames import align_rigid
from needlefit.inference.draws import Draws, rms_noise_scale, thin_posterior
from needlefit.inference.forward_model import predict
from needlefit.inference.importance.fit_posterior import resample_draws, sample_about_fit
from needlefit.inference.likelihood.depths import shift_depths
from needlefit.inference.likelihood.observation import (
    Observation,
    make_observation,
    points_covariance,
    pose_modes,
)
from needlefit.inference.predictive_distribution import (
    INTERVAL_PROBABILITIES,
    PredictiveMixture,
    cdf,
    crps,
    interval,
    quantile,
    simulate_shape_pit,
)
from needlefit.mechanics.shape import compute_positions
from needlefit.project.random_streams import random_stream
from needlefit.validation.folds import Fold
from needlefit.validation.job import Job
from needlefit.validation.needles_in_scan import FoldFit
from needlefit.validation.planned_insertions import with_planned_layers
from needlefit.validation.score import Row

Floats = NDArray[np.float64]

PREDICTION_DRAWS = 100
"""Parameter sets of which every held-out needle is predicted."""

FIGURE_DRAWS = 400
"""Parameter sets that a figure of the posterior shows."""

MIN_SOLVED_DRAWS = 10
"""Fewer solved draws make no distribution."""

MAX_LAYERS = 32
"""Depth errors drawn for an insertion, so that what a draw is does not depend on the layers it meets."""

PREDICTIVE_COLUMNS = (
    *("fold", "insertion", "specimen", "medium", "layers", "depth_mm"),
    *("draw_source", "certified", "draws", "failed_solves"),
    *(
        "tip_measured_mm",
        "tip_median_mm",
        "tip_50_low_mm",
        "tip_50_high_mm",
        "tip_95_low_mm",
        "tip_95_high_mm",
    ),
    *("tip_pit", "tip_in_50", "tip_in_95", "tip_crps_mm"),
    *("shape_pit", "shape_in_50", "shape_in_95", "points_in_50", "points_in_95", "shape_crps_mm"),
)
"""Columns: `tip_pit` is the probability predicted of a tip up to the measured one, `shape_pit` of a shape
nearer, at its worst point, than the measured one; `shape_in_*` says whether that is within 50 or 95 %;
`points_in_*` is the part of points within their own interval, which are no independent trials."""


def draw_fold_parameters(job: Job, fold: Fold, known: FoldFit, jobs: int = 1) -> tuple[Draws, Draws]:
    """Draw parameters of a fold: `PREDICTION_DRAWS` to predict with, and `FIGURE_DRAWS` for figures.

    They come from the sampled posterior where there is one, else from importance sampling about the fit.
    """
    if known.posterior is not None:
        few, many = (
            thin_posterior(known.posterior, job.parameters, count)
            for count in (PREDICTION_DRAWS, FIGURE_DRAWS)
        )
        return few, many
    if not len(known.fit.theta):
        few, many = (Draws(np.empty((count, 0)), "importance") for count in (PREDICTION_DRAWS, FIGURE_DRAWS))
        return few, many
    rng = random_stream(job.recipe.seed, job.name, fold.name, "foretold")
    found = sample_about_fit(job.problem(fold), known.fit, rng, jobs)
    # both sets come from one generator: their order is part of the result
    few, many = (resample_draws(found, count, rng) for count in (PREDICTION_DRAWS, FIGURE_DRAWS))
    return few, many


BAND_COLUMNS = (
    *("fold", "insertion", "x_mm", "measured_mm", "median_mm"),
    *("low_50_mm", "high_50_mm", "low_95_mm", "high_95_mm"),
)
"""Columns: where a held-out needle was predicted to be measured, point by point, at its measured x."""

BAND_POINTS = 41
"""Points of a band that are kept, of up to some 200."""


@dataclass(frozen=True)
class HeldOutPrediction:
    """The prediction of one needle: its row of `PREDICTIVE_COLUMNS`, and its rows of `BAND_COLUMNS`.

    `solved` needles were simulated, one a draw, `outside` of them outside what the model assumes.
    """

    row: Row
    band: tuple[Row, ...]
    solved: int
    outside: int


def tabulate_held_out(job: Job, fold: Fold, draws: Draws) -> Iterator[Row]:
    """Yield one row for every insertion that a fold holds out, y toward +y of C, mm."""
    return (one.row for one in predict_held_out(job, fold, draws))


def predict_held_out(job: Job, fold: Fold, draws: Draws) -> Iterator[HeldOutPrediction]:
    """Yield the prediction of every insertion that a fold holds out, y toward +y of C, mm.

    Of an insertion whose points have no stated noise, nothing: its measurement then has no distribution.
    """
    factor = rms_noise_scale(draws, job.parameters, job.recipe.likelihood.noise_scale)
    for insertion in fold.validate:
        if not job.dataset.noise.stated and insertion.sd is None:
            continue
        chance = random_stream(job.recipe.seed, job.name, fold.name, "foretold", insertion.id)
        observation = make_observation(job.dataset, insertion, likelihood=job.recipe.likelihood)
        curves = [_solve_heights(job, theta, insertion, observation, chance) for theta in draws.thetas]
        kept = [curve for curve in curves if curve is not None]
        solved = np.array([heights for heights, _ in kept])
        if len(solved) >= MIN_SOLVED_DRAWS:
            covariance, measured = (
                factor**2 * _measurement_covariance(job, observation),
                observation.measured[:, 1],
            )
            mixture = PredictiveMixture(solved, np.sqrt(np.diag(covariance)))
            row = {"fold": fold.name, **_describe_insertion(job, insertion, draws, len(curves) - len(solved))}
            row |= _score_prediction(
                mixture, measured, simulate_shape_pit(mixture, covariance, measured, chance)
            )
            where = {"fold": fold.name, "insertion": insertion.id}
            band = ({**where, **point} for point in _band_rows(mixture, observation.measured))
            yield HeldOutPrediction(
                {name: row[name] for name in PREDICTIVE_COLUMNS},
                tuple(band),
                len(kept),
                sum(not valid for _, valid in kept),
            )


def _solve_heights(
    job: Job, theta: Floats, insertion: Insertion, observation: Observation, rng: np.random.Generator
) -> tuple[Floats, bool] | None:
    """Return y (K,) of one draw's needle at the measured points, and its validity; None if a solve fails."""
    values = job.parameters.values(theta)
    deep = insertion.depth_sd * rng.normal()
    wrong = rng.normal(size=MAX_LAYERS)
    met = with_planned_layers(insertion, values, job.medium, job.dataset.needle)
    if met is None:
        return None
    count = len(met.boundaries)
    shifts = deep + insertion.boundary_sd * wrong[:count]
    perturbed, s = shift_depths(met, observation.nodes.s[0], shifts, deep)
    shape = predict(values, job.medium, job.dataset.needle, perturbed)
    if not shape.converged:
        return None
    points = compute_positions(shape, s)
    if observation.pose == "free":
        points = align_rigid(points, observation.measured)
    heights: Floats = points[:, 1]
    return heights, shape.valid


def _measurement_covariance(job: Job, observation: Observation) -> Floats:
    """Return the covariance (K, K) of the measured y about a given needle: of points, and of a known pose.

    A free shape is laid on the measured one, which takes from its errors what a motion can.
    """
    if observation.pose == "known":
        return np.asarray(np.linalg.inv(observation.whitening.T @ observation.whitening), dtype=np.float64)
    moved_by: Floats = np.linalg.qr(pose_modes(observation.measured)[:, :2])[0]  # (K, 2): across, turn
    left = np.eye(len(moved_by)) - moved_by @ moved_by.T
    aligned: Floats = left @ points_covariance(observation.nodes.s[0], job.dataset.noise) @ left
    return aligned


def _describe_insertion(job: Job, insertion: Insertion, draws: Draws, failed: int) -> Row:
    return {
        "insertion": insertion.id,
        "specimen": insertion.specimen,
        "medium": insertion.medium,
        "layers": count_layers(insertion, job.record.layer_count_rule),
        "depth_mm": insertion.depth,
        "draw_source": draws.source,
        "certified": not draws.faults,
        "draws": len(draws.thetas),
        "failed_solves": failed,
    }


def _band_rows(mixture: PredictiveMixture, measured: Floats) -> Iterator[Row]:
    """Yield median and intervals at some of the measured points (K, 2), the tip the last."""
    kept = np.unique(np.linspace(0, len(measured) - 1, BAND_POINTS).round().astype(np.int64))
    some = PredictiveMixture(mixture.means[:, kept], mixture.sd[kept])
    columns = {"x_mm": measured[kept, 0], "measured_mm": measured[kept, 1], "median_mm": quantile(some, 0.5)}
    for level in INTERVAL_PROBABILITIES:
        ends = zip(("low", "high"), interval(some, level), strict=True)
        columns |= {f"{side}_{100 * level:.0f}_mm": end for side, end in ends}
    for k in range(len(kept)):
        yield {name: float(values[k]) for name, values in columns.items()}


def _score_prediction(mixture: PredictiveMixture, measured: Floats, shape_pit: float) -> Row:
    """Return what became of the prediction of points (K,), the last of them the tip."""
    tip = PredictiveMixture(mixture.means[:, -1:], mixture.sd[-1:])
    at, score = float(measured[-1]), crps(mixture, measured)
    row: Row = {"tip_measured_mm": at, "tip_median_mm": float(quantile(tip, 0.5)[0])}
    row |= {"tip_pit": float(cdf(tip, [at])[0]), "tip_crps_mm": float(score[-1])}
    row |= {"shape_crps_mm": float(score.mean()), "shape_pit": shape_pit}
    for level in INTERVAL_PROBABILITIES:
        name = f"{100 * level:.0f}"
        low, high = interval(mixture, level)
        row |= {f"tip_{name}_low_mm": float(low[-1]), f"tip_{name}_high_mm": float(high[-1])}
        row |= {f"tip_in_{name}": bool(low[-1] <= at <= high[-1])}
        row |= {f"shape_in_{name}": shape_pit <= level}
        row |= {f"points_in_{name}": float(np.mean((low <= measured) & (measured <= high)))}
    return row
