"""Predict the later readings of a run of a tip track from its first ones, by the model and by baselines.

Given the deflections y of one draw of the parameters, the readings of a run are Gaussian. Those of the model
have the errors of the likelihood, of which the fitted runs determine what all runs share, z:

    t = y + shift + sum_j x_j (own_j e_j + shared_j . z) + noise,      e, z ~ N(0, 1),   shift free

with columns x_j by slope and by the response to the guide. Conditioned on the first readings of a run this is
Gaussian again; what the run does further on enters nowhere.

Baselines are curves without tissue or guide, fitted to the same runs. The slope of a further run has the mean
of those of k fitted runs and the variance s^2 (1 + 1/k) f / (f - 2) of Student's t; s^2 is their scatter, of
f degrees of freedom. Their predictions are the mean given the first readings.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from needlefit.arrays import Bools, Floats
from needlefit.datasets.insertion import Insertion
from needlefit.inference.baselines import BASELINES, Baseline
from needlefit.inference.likelihood.nodes import NodeGroup
from needlefit.inference.likelihood.observation import Observation

SHIFT_SD_MM = 100.0  #: prior SD of a shift (mm): no reading lies as far from another
MIN_TUNED_RUNS = 4  #: smallest number of runs from whose scatter the slope of a further one is estimated


class PredictedReadings(NamedTuple):
    """The later readings of a run by draws of the parameters, in space those along y before those along z."""

    values: Floats  #: (B, R), mm
    sd: Floats  #: (B, R) of each, mm, given the parameters and the first readings


def predict_runs(
    scale: Floats,
    tuned: Sequence[Observation],
    held_out: Sequence[Observation],
    curves: Sequence[Floats],
    registered: Sequence[int],
    rng: np.random.Generator | None = None,
) -> list[PredictedReadings]:
    """Return of each run held out draws (B, n - k) of its readings after the first k, `registered`, mm.

    Without `rng` they are the means of the readings, given each draw of the parameters. In space they are
    (B, 2 (n - k)), and curves are ordered alike. `scale` (B,) is what each draw
    multiplies the stated deviations of the noise by; `curves` are the deflections (B, m, n), mm, of the runs
    `tuned` and `held_out` at the m nodes of each. What runs share is estimated from the runs fitted to, for
    every draw, and from the first readings.
    """
    runs = (*tuned, *held_out)
    surfaces = sorted({axis.surface for run in runs for axis in run.nodes.axes if axis.surface})
    group = NodeGroup(tuple(run.nodes for run in runs), tuple(surfaces))

    def spread(k: int) -> tuple[Floats, Floats]:
        """Return the covariance (B, n, n) of a run's own errors, and the columns (B, n, K) of the shared."""
        pose = runs[k].pose_spread.T
        frame = np.broadcast_to(pose, (len(scale), *pose.shape))
        # (B, d, n): the changes by one SD along the d axes of the run's errors
        columns = runs[k].nodes.linear[1:] @ np.concatenate([curves[k], frame], axis=1)
        own_columns = group.own[k][:, None] * columns
        shifts = SHIFT_SD_MM**2 * runs[k].free @ runs[k].free.T
        noise = scale[:, None, None] ** 2 * runs[k].point_covariance + shifts
        return noise + own_columns.transpose(0, 2, 1) @ own_columns, columns.transpose(
            0, 2, 1
        ) @ group.shared[k]

    pull = np.zeros((len(scale), len(surfaces)))
    precision = np.tile(np.eye(len(surfaces)), (len(pull), 1, 1))
    for k, run in enumerate(tuned):
        covariance, shared = spread(k)
        weighted = np.linalg.solve(covariance, shared).transpose(0, 2, 1)  # (B, K, n)
        precision = precision + weighted @ shared
        pull = pull + np.einsum("bkn,bn->bk", weighted, run.stack(run.measured) - curves[k][:, 0])
    inverse = np.linalg.inv(precision)
    best = np.einsum("bkl,bl->bk", inverse, pull)
    predicted = []
    for k, (run, count) in enumerate(zip(held_out, registered, strict=True), start=len(tuned)):
        covariance, shared = spread(k)
        mean = curves[k][:, 0] + np.einsum("bnk,bk->bn", shared, best)
        total = covariance + shared @ inverse @ shared.transpose(0, 2, 1)
        first = np.tile(np.arange(len(run.measured)) < count, run.directions)
        centre, left = condition(mean, total, first, run.stack(run.measured)[first])
        if rng is not None:
            root = np.linalg.cholesky(left)
            centre = centre + np.einsum("brs,bs->br", root, rng.normal(size=centre.shape))
        predicted.append(PredictedReadings(centre, np.sqrt(np.diagonal(left, axis1=1, axis2=2))))
    return predicted


def condition(mean: Floats, covariance: Floats, first: Bools, measured: Floats) -> tuple[Floats, Floats]:
    """Return mean (..., n - k) and covariance (..., n - k, n - k) of the rest of a Gaussian, given a part.

    Of n numbers with `mean` (..., n) and `covariance` (..., n, n), the k where `first` (n,) is true were
    `measured` (k,).
    """
    above, below = covariance[..., first, :], covariance[..., ~first, :]
    cross = above[..., ~first]
    gain = np.linalg.solve(above[..., first], cross)  # (..., k, n - k): from residuals to the rest
    centre = mean[..., ~first] + np.einsum("...k,...kr->...r", measured - mean[..., first], gain)
    return centre, below[..., ~first] - np.swapaxes(gain, -1, -2) @ cross


def predict_by_curve(
    baseline: Baseline, tuned: Sequence[Observation], further: Observation, registered: int, slope_sd: float
) -> Floats:
    """Return the readings (n - registered,) of a run after the first `registered`, mm, by a baseline.

    `slope_sd`: of the slopes of runs, rad, that is taken where too few are `tuned` to estimate it.
    """
    assert baseline.track_basis is not None
    with BASELINES.plugin_error_context(baseline.name):
        *bases, columns = (baseline.track_basis(run.insertion) for run in (*tuned, further))  # each (n, P)
    # least squares of the readings in frames of any shift and slope
    basis = np.concatenate([run.whitening @ run_basis for run, run_basis in zip(tuned, bases, strict=True)])
    measured = np.concatenate([run.whitening @ run.measured[:, 1] for run in tuned])
    best, _, rank, _ = np.linalg.lstsq(basis, measured)
    variance = float(np.sum((measured - basis @ best) ** 2)) / (len(measured) - rank)
    left = (run.measured[:, 1] - run_basis @ best for run, run_basis in zip(tuned, bases, strict=True))
    slopes = np.array([off @ run.estimator[1] for run, off in zip(tuned, left, strict=True)])
    slope, slope_variance = float(slopes.mean()), slope_sd**2 * (1 + 1 / len(slopes))
    if len(tuned) >= MIN_TUNED_RUNS:
        slope, slope_variance = _predict_slope(slopes, [run.insertion for run in (*tuned, further)], baseline)
    design, first = further.free, np.arange(len(further.measured)) < registered  # (n, 2), (n,)
    total = variance * further.point_covariance
    total = total + design @ np.diag([SHIFT_SD_MM**2, slope_variance]) @ design.T
    mean = columns @ best + slope * design[:, 1]
    return condition(mean, total, first, further.measured[first, 1])[0]


def _predict_slope(slopes: Floats, runs: Sequence[Insertion], baseline: Baseline) -> tuple[float, float]:
    """Return mean and variance of the slope of the last run, from those (k,) of the others.

    By runs alike, where there are any: the scatter is taken from both kinds, each about its own mean.
    """
    k = len(slopes)
    *guided, like = (run.guided for run in runs)
    apart = baseline.track_slope == "alike" and k > MIN_TUNED_RUNS and like in guided
    kinds = np.array(guided) if apart else np.full(k, like)
    alike = slopes[kinds == like]
    squares = sum(
        len(slopes_of_kind) * slopes_of_kind.var()
        for slopes_of_kind in (alike, slopes[kinds != like])
        if len(slopes_of_kind)
    )
    freedom = k - len(set(kinds.tolist()))
    return float(alike.mean()), float(squares / freedom * (1 + 1 / len(alike)) * freedom / (freedom - 2))
