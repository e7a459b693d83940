"""Gaussian likelihood of a measured centreline about a simulated one.

The residuals are the differences of deflection, r_i = y_sim(s_i) - y_measured,i of K points, y normal to
C's x axis (of a free shape, to its own entry side). s is the measured points' own arc length, so what noise
does along the needle is not seen, and is not counted as data either:

    cov(r) = point^2 I + correlated^2 exp(-|s_i - s_j| / length)      noise of the points
             + shift^2 1 1^T + angle^2 x x^T                          pose, marginalised

1 and x are what a small shift across and a small rotation about the entry do to the deflections.
Neighbouring points share their error and a wrong pose moves all of them at once, which is why
independent errors would give a posterior far too narrow. The points are the measured ones (thinned,
never interpolated), so that no error is counted twice. Not in it: errors of the layer depths, and of
the model.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular

from needlefit.datasets.insertion import Dataset, Insertion, Noise
from needlefit.datasets.noise import MEAN_OF_NORM
from needlefit.datasets.reach import reach_from_tip
from needlefit.errors import DataError
from needlefit.geometry.curves import arc_length, at_arc
from needlefit.geometry.frames import align_rigid, align_rigid_slopes
from needlefit.inference.comparison import Curve, Pose, in_entry_axes

Floats = NDArray[np.float64]

MOST_POINTS = 200
"""A centreline with more points is thinned to about this many."""

FREE_SHIFT, FREE_ANGLE = 100.0, 1.0
"""Prior standard deviations (mm, rad) that stand for a pose not known at all."""


@dataclass(frozen=True)
class Evidence:
    """One insertion, ready to be compared.

    Attributes
    ----------
    s : (K,) array
        Beam coordinates of the compared points, mm.
    measured : (K, 2) array
        Their measured places, mm.
    factor : (K, K) array
        Lower Cholesky factor of the covariance of the residuals.
    log_norm : float
        Logarithm of the Gaussian's normalising factor.
    pose : "known" or "free"
        A free shape is aligned before its residuals are formed.
    """

    s: Floats
    measured: Floats
    factor: Floats
    log_norm: float
    pose: Pose

    @cached_property
    def whitening(self) -> Floats:
        """The inverse of `factor`, (K, K): many curves at once are whitened by one product."""
        inverse: Floats = solve_triangular(self.factor, np.eye(len(self.factor)), lower=True)
        return inverse


def evidence(dataset: Dataset, insertion: Insertion, noise: Noise | None = None) -> Evidence:
    """Return the evidence of one insertion; `noise` replaces what the dataset states.

    Raises
    ------
    DataError
        If no noise is stated: without any, a likelihood has no width.
    """
    noise = dataset.noise if noise is None else noise
    s, measured = _compared(dataset, insertion)
    cov = covariance(s, measured, noise, pose_sds(dataset.pose, insertion, noise))
    try:
        factor: Floats = cholesky(cov, lower=True)
    except np.linalg.LinAlgError:
        raise DataError(
            f"the noise stated by `{dataset.name}` leaves the points of `{insertion.id}` without errors",
            where="noise",
            expected="point_sd_mm above 0",
        ) from None
    log_norm = -float(np.sum(np.log(np.diag(factor)))) - 0.5 * len(factor) * math.log(2 * math.pi)
    return Evidence(s, measured, factor, log_norm, dataset.pose)


def whitened(evidence: Evidence, simulated: Floats) -> Floats:
    """Return the residuals (K,) of points (K, 2): uncorrelated and of unit variance if all is right."""
    if evidence.pose == "free":
        simulated = align_rigid(simulated, evidence.measured)
    white: Floats = evidence.whitening @ (simulated[:, 1] - evidence.measured[:, 1])
    return white


def whitened_slopes(evidence: Evidence, simulated: Floats, slopes: Floats) -> Floats:
    """Return the derivatives (K, P) of `whitened`, given those of the simulated points, (K, 2, P)."""
    if evidence.pose == "free":
        slopes = align_rigid_slopes(simulated, evidence.measured, slopes)
    white: Floats = evidence.whitening @ slopes[:, 1]
    return white


def log_likelihood(evidence: Evidence, curve: Curve) -> float:
    """Return the logarithm of the density of the measured points, given the simulated curve."""
    white = whitened(evidence, curve(evidence.s))
    return evidence.log_norm - 0.5 * float(white @ white)


def log_likelihoods(evidence: Evidence, simulated: Floats) -> Floats:
    """Return the same (B,) for many simulated curves, points (B, K, 2) at the beam coordinates `s`."""
    if evidence.pose == "free":
        simulated = np.array([align_rigid(points, evidence.measured) for points in simulated])
    residuals = simulated[:, :, 1] - evidence.measured[:, 1]  # (B, K)
    white = residuals @ evidence.whitening.T  # (B, K)
    found: Floats = evidence.log_norm - 0.5 * np.sum(white**2, axis=1)
    return found


def covariance(s: Floats, points: Floats, noise: Noise, pose: tuple[float, float]) -> Floats:
    """Return the covariance (K, K) of the residuals; `pose` is (shift, angle) in mm and rad."""
    apart = np.abs(s[:, None] - s[None, :])  # (K, K)
    shared = noise.correlated_sd**2 * np.exp(-apart / noise.correlation_length)
    shift, angle = pose
    modes = np.stack([np.full(len(s), shift), angle * (points[:, 0] - points[0, 0])])  # (2, K)
    total: Floats = noise.point_sd**2 * np.eye(len(s)) + shared + modes.T @ modes
    return total


def pose_sds(pose: Pose, insertion: Insertion, noise: Noise) -> tuple[float, float]:
    """Return the prior standard deviations of the pose in the plane, mm per axis and rad.

    A registration error of mean length m, isotropic in space, has m / sqrt(8 / pi) per axis. It and the
    row's pose deviation are often one error told twice: the larger one counts, as in the noise floor.
    """
    if pose == "free":
        return FREE_SHIFT, FREE_ANGLE
    registration = noise.registration_mean / MEAN_OF_NORM
    return max(insertion.pose_shift_sd, registration), insertion.pose_angle_sd


def _compared(dataset: Dataset, insertion: Insertion) -> tuple[Floats, Floats]:
    """Return beam coordinates (K,) and places (K, 2) of the measured points used."""
    along = arc_length(insertion.planar)
    if dataset.pose == "known":
        at = along * (insertion.depth / along[-1])
    else:
        to_tip = along[-1] - along
        kept = to_tip <= reach_from_tip(dataset.drop_proximal, insertion)
        along, at = along[kept], insertion.depth - to_tip[kept]
    step = max(1, math.ceil(len(at) / MOST_POINTS))
    chosen = np.arange(len(at) - 1, -1, -step)[::-1]  # keeps the tip
    places = at_arc(insertion.planar, along[chosen])
    return at[chosen], places if dataset.pose == "known" else in_entry_axes(places)
