"""Turn one insertion into an observation: its measured points, and the whitening that makes residuals
independent.

Residuals are differences of deflection between the simulated and the measured curve at the same beam
coordinates. The points are the measured ones (thinned, never interpolated), so that no error is counted
twice. A known pose enters their covariance with its prior; a free one is projected off, as the limit of
a prior that is flat. Equations: docs/inference.md.

Errors of the pose in the plane:

A shift across moves all points alike, a turn about the entry moves them by their distance from it, and a
shift along the entry axis moves the curve past itself: a point then differs by the slope.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, qr, solve_triangular

from needlefit.datasets.insertion import Dataset, Insertion, Noise, find_free_reach
from needlefit.datasets.noise import MEAN_NORM_PER_SD
from needlefit.errors import DataError
from needlefit.geometry.curves import arc_length, interpolate_at_arc
from needlefit.geometry.frames import align_rigid, differentiate_align_rigid
from needlefit.inference.compared_points import Pose, rotate_to_entry_axes
from needlefit.inference.likelihood.depths import Nodes, make_nodes
from needlefit.project.toml_lines import locate_key
from needlefit.schemas.recipe import LikelihoodRecord

Floats = NDArray[np.float64]

SLOPE_DEGREE = 3
"""Degree of the polynomial whose slope is taken for the needle's: that of the noisy points would be rough."""


def pose_modes(measured: Floats) -> Floats:
    """Return the change (K, 3) of deflections by a unit shift across, turn, and shift along; points are (K,
    2).

    Per mm, per rad, per mm.
    """
    x = measured[:, 0] - measured[0, 0]
    degree = min(SLOPE_DEGREE, len(x) - 1)
    # Polynomial.fit scales x to [-1, 1] itself: np.polyfit on mm would be badly conditioned
    slope = np.polynomial.Polynomial.fit(x, measured[:, 1], degree).deriv()(x)
    return np.column_stack([np.ones(len(x)), x, -slope])


def pose_sds(insertion: Insertion, noise: Noise) -> Floats:
    """Return the prior standard deviations (3,) of a known pose: mm, rad, mm, in the order of `pose_modes`.

    A registration error of mean length m, isotropic in space, has m / sqrt(8 / pi) per axis. It and the
    row's pose deviation are often one error stated twice: the larger one counts, as in the noise floor.
    """
    shift = max(insertion.pose_shift_sd, noise.registration_mean / MEAN_NORM_PER_SD)
    return np.array([shift, insertion.pose_angle_sd, shift])


def points_covariance(s: Floats, noise: Noise, sd: Floats | None = None) -> Floats:
    """Return the covariance (K, K), mm^2, of points at arc lengths `s` (K,).

    Parameters
    ----------
    noise : Noise
        Its independent part, and how far along the needle the other part is shared.
    sd : (K,) array, optional
        Deviation of each point's shared part, mm; by default the same for all, as `noise` states.
    """
    deviation = np.full(len(s), noise.correlated_sd) if sd is None else sd
    apart = np.abs(s[:, None] - s)  # (K, K)
    shared = np.outer(deviation, deviation) * np.exp(-apart / noise.correlation_length)
    total: Floats = noise.point_sd**2 * np.eye(len(s)) + shared
    return total


MAX_CENTERLINE_POINTS = 200
"""A centreline with more points is thinned to about this many."""

DEFAULT_LIKELIHOOD = LikelihoodRecord()


@dataclass(frozen=True)
class Observation:
    """One insertion, prepared for comparison with simulated needles.

    Attributes
    ----------
    measured : (K, 2) array
        Measured places, mm.
    whitening : (R, K) array
        What makes residuals of deflections independent and of unit variance; R = K less what a free pose
        takes.
    log_norm : float
        Logarithm of the Gaussian's normalising factor.
    pose : "known" or "free"
        A free shape is aligned before its residuals are formed.
    nodes : Nodes
        The layer and insertion depths it is simulated with, and where its points then lie on the beam.
    """

    measured: Floats
    whitening: Floats
    log_norm: float
    pose: Pose
    nodes: Nodes

    @property
    def rows(self) -> int:
        """R: the number of independent residuals."""
        return len(self.whitening)


def make_observation(
    dataset: Dataset,
    insertion: Insertion,
    noise: Noise | None = None,
    likelihood: LikelihoodRecord = DEFAULT_LIKELIHOOD,
) -> Observation:
    """Return the observation of one insertion; `noise` replaces the noise that the dataset states.

    Raises
    ------
    DataError
        If no noise is stated: without any, a likelihood has no width.
    """
    noise = dataset.noise if noise is None else noise
    s, measured, sd = _select_points(dataset, insertion)
    cov, directions = points_covariance(s, noise, sd), pose_modes(measured)
    if dataset.pose == "known":
        spread = directions * pose_sds(insertion, noise)
        cov, free = cov + spread @ spread.T, directions[:, :0]
    else:
        free = directions[:, :2]  # arc lengths are counted from the tip: nothing shifts along them
    if likelihood.noise == "independent":
        cov = np.diag(np.diag(cov))
    try:
        whitening, log_norm = whiten(cov, free)
    except np.linalg.LinAlgError:
        raise DataError(
            f"the noise stated by `{dataset.name}` leaves the points of `{insertion.id}` without errors",
            where=locate_key(dataset.path, "noise.point_sd_mm"),
            expected="noise.point_sd_mm above 0",
            fix="write how well a point is known, per axis; `needlefit check` names such datasets",
        ) from None
    return Observation(
        measured, whitening, log_norm, dataset.pose, make_nodes(insertion, s, likelihood.depths)
    )


def whiten(cov: Floats, free: Floats) -> tuple[Floats, float]:
    """Return whitening (R, K) and log norm of a Gaussian with covariance (K, K); columns `free` (K, f) are
    projected out.

    The limit, for prior deviations S of the columns' coefficients that grow without end, of the Gaussian
    with covariance cov + free S^2 free^T, times (2 pi)^(f / 2) det S for f columns.
    """
    factor = cholesky(cov, lower=True)
    inverse: Floats = solve_triangular(factor, np.eye(len(cov)), lower=True)
    log_norm = -float(np.sum(np.log(np.diag(factor))))
    if free.shape[1]:
        # the columns of `basis` beyond f span what the free columns cannot reach; corner's diagonal is their
        # volume
        basis, corner = qr(inverse @ free)  # (K, K), (K, f)
        log_norm -= float(np.sum(np.log(np.abs(np.diag(corner)))))
        inverse = basis[:, free.shape[1] :].T @ inverse
    return inverse, log_norm - 0.5 * len(inverse) * math.log(2 * math.pi)


def whiten_residuals(observation: Observation, simulated: Floats) -> Floats:
    """Return the whitened residuals (..., R) of points (..., K, 2), aligned first if the pose is free."""
    if observation.pose == "free":
        simulated = align_rigid(simulated, observation.measured)
    return whiten_deflections(observation, simulated[..., 1])


def whiten_deflections(observation: Observation, deflections: Floats) -> Floats:
    """Return the whitened residuals (..., R) of deflections (..., K), without alignment."""
    white: Floats = (deflections - observation.measured[:, 1]) @ observation.whitening.T
    return white


def whiten_derivatives(observation: Observation, simulated: Floats, slopes: Floats) -> Floats:
    """Return the derivatives (R, P) of `whiten_residuals`, given those of the points, (K, 2, P)."""
    if observation.pose == "free":
        slopes = differentiate_align_rigid(simulated, observation.measured, slopes)
    white: Floats = observation.whitening @ slopes[:, 1]
    return white


def _select_points(dataset: Dataset, insertion: Insertion) -> tuple[Floats, Floats, Floats | None]:
    """Return beam coordinates (K,), places (K, 2) and deviations (K,) of the measured points used."""
    whole = arc_length(insertion.planar)
    along = whole
    if dataset.pose == "known":
        at = along * (insertion.depth / along[-1])
    else:
        to_tip = along[-1] - along
        kept = to_tip <= find_free_reach(dataset.drop_proximal, insertion)
        along, at = along[kept], insertion.depth - to_tip[kept]
    step = max(1, math.ceil(len(at) / MAX_CENTERLINE_POINTS))
    chosen = np.arange(len(at) - 1, -1, -step)[::-1]  # keeps the tip
    places = interpolate_at_arc(insertion.planar, along[chosen])
    sd = None if insertion.sd is None else np.interp(along[chosen], whole, insertion.sd)
    return at[chosen], places if dataset.pose == "known" else rotate_to_entry_axes(places), sd
