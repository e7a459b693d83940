"""The observation of one insertion: measured places, and the whitening that makes its residuals independent.

Residuals are differences of deflection between the simulated and the measured curve at the same beam
coordinates, or of what an operator makes of these. In space those along y stand before those along z. A known
pose enters the covariance with its prior; a free one is projected off, as the limit of a prior that is flat,
and so is the shift across where the direction alone is known. Equations: docs/inference.md, sections 1 to 3.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cholesky, qr, solve_triangular

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion, InsertionPose, find_pose
from needlefit.geometry.frames import align_rigid, differentiate_align_rigid
from needlefit.inference.likelihood.nodes import Nodes, make_nodes
from needlefit.inference.likelihood.stated_errors import StatedErrors, no_errors_error
from needlefit.schemas.recipe import LikelihoodRecord


@dataclass(frozen=True)
class Observation:
    """One insertion, prepared for comparison with simulated needles."""

    measured: Floats  #: (K, 2), in space (K, 3), measured places, mm; of a tip track depth and tip
    #: (C, C) of the errors of what is compared at noise scale 1, mm^2: of the K measured y (in space of y,
    #: then z), or of C spline coefficients; of C curvatures, 1/m^2
    point_covariance: Floats
    #: (C, c) what a deviation of the known part of a pose adds to them, mm; c = 0 where it is free
    pose_spread: Floats
    free: Floats  #: (C, f) what the free part of a pose does to them, per unit; f = 0 where it is known
    #: (R, K), in space (R, 2 K), from differences of the deflections to independent residuals of unit
    #: variance; R = C less what a free pose takes
    whitening: Floats
    log_norm: float  #: logarithm of the Gaussian's normalising factor
    pose: InsertionPose  #: a free shape is aligned before its residuals are formed
    #: the layer and insertion depths it is simulated with, and where its points then lie on the beam
    nodes: Nodes
    #: (c, R) what a deviation of the pose does to the residuals, where `whitening` does not know it
    pose_curves: Floats
    #: (R,) added to the residuals: what smoothing would do to points that are stored smoothed
    offset: Floats | float = 0.0
    #: (C, K), in space (C, 2 K), from deflections to what was read; None where these were
    operator: Floats | None = None

    @property
    def rows(self) -> int:
        """R: the number of independent residuals."""
        return len(self.whitening)

    @property
    def insertion(self) -> Insertion:
        return self.nodes.insertions[0]

    @property
    def directions(self) -> int:
        """1 where deflections are compared along y, 2 along y and z."""
        return self.measured.shape[1] - 1

    def stack(self, points: Floats) -> Floats:
        """Return the deflections (..., K) of points (..., K, 3), in space (..., 2 K): along y, then z."""
        return np.concatenate([points[..., 1 + n] for n in range(self.directions)], axis=-1)

    def read(self, points: Floats) -> Floats:
        """Return what is read of points (..., K, 3): (..., C)."""
        across = self.stack(points)
        return across if self.operator is None else across @ self.operator.T

    def covariance(self, scale: float = 1.0) -> Floats:
        """Return the covariance (K, K) of the errors of the measured y, mm^2, with a scale of the noise."""
        return scale**2 * self.point_covariance + self.pose_spread @ self.pose_spread.T

    @cached_property
    def estimator(self) -> Floats:
        """Matrix (f, K) that gives the best coefficients of `free` for measured minus simulated y (K,)."""
        weighted = np.linalg.solve(self.covariance(), self.free)  # (K, f)
        return np.linalg.solve(self.free.T @ weighted, weighted.T)


def whiten_known(
    covariance: Floats, pose: Floats, free: Floats, likelihood: LikelihoodRecord
) -> tuple[Floats, float, Floats]:
    """Return whitening (R, C), log norm, and the pose's curves (c, R) where it is integrated over apart.

    A scale of the noise is none of the pose.
    """
    apart = likelihood.noise_scale != 1.0
    whole = covariance if apart else covariance + pose @ pose.T
    if likelihood.noise == "independent":
        whole = np.diag(np.diag(whole))
    whitening, log_norm = whiten(whole, free)
    return whitening, log_norm, (whitening @ pose).T[: pose.shape[1] if apart else 0]


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
    """Return the whitened residuals (..., R) of points (..., K, 3), aligned if the pose is free."""
    if observation.pose == "free":
        simulated = align_rigid(simulated[..., :2], observation.measured)
    return whiten_deflections(observation, observation.stack(simulated))


def whiten_deflections(observation: Observation, deflections: Floats) -> Floats:
    """Return the whitened residuals (..., R) of stacked deflections, without alignment."""
    measured = observation.stack(observation.measured)
    return (deflections - measured) @ observation.whitening.T + observation.offset


def append_pose_curves(observation: Observation, white: Floats) -> Floats:
    """Return whitened residuals (B, m, R) with the curves of the pose behind them."""
    curves = np.broadcast_to(observation.pose_curves, (len(white), *observation.pose_curves.shape))
    return np.concatenate([white, curves], axis=1)


def whiten_derivatives(observation: Observation, simulated: Floats, slopes: Floats) -> Floats:
    """Return the derivatives (..., R, P) of `whiten_residuals`, given those of the points, (..., K, 3, P)."""
    if observation.pose == "free":
        slopes = differentiate_align_rigid(simulated[..., :2], observation.measured, slopes[..., :2, :])
    across = [slopes[..., 1 + n, :] for n in range(observation.directions)]
    return observation.whitening @ np.concatenate(across, axis=-2)


def complete_observation(
    insertion: Insertion,
    errors: StatedErrors,
    s: Floats,
    measured: Floats,
    covariance: Floats,
    pose: Floats,
    free: Floats,
    operator: Floats | None = None,
    shift: Floats | None = None,
) -> Observation:
    """Return the observation of places measured at beam coordinates `s` (K,), or of C combinations of them.

    `pose` (C, c) and `free` (C, f) are as in `Observation`. `operator` (C, K), in space (C, 2 K), leads to
    the combinations; `shift` (C,) is added to those of the simulation.

    Raises DataError if the errors leave a place without any.
    """
    try:
        whitening, log_norm, curves = whiten_known(covariance, pose, free, errors.likelihood)
    except np.linalg.LinAlgError:
        raise no_errors_error(errors.dataset, insertion) from None
    depths, varies = errors.likelihood.depths, errors.bevels_vary
    nodes = make_nodes(insertion, s, depths, bevel=varies, constants=len(curves))
    offset: Floats | float = 0.0 if shift is None else whitening @ shift
    whitening = whitening if operator is None else whitening @ operator
    pose_known = find_pose(errors.dataset.pose, insertion)
    return Observation(
        measured, covariance, pose, free, whitening, log_norm, pose_known, nodes, curves, offset
    )


def join_observations(first: Observation, other: Observation) -> Observation:
    """Return the observation of an insertion by both; errors of its pose do not change the `other`."""
    directions, counts = first.directions, [len(first.measured), len(other.measured)]
    is_other = np.tile(np.repeat([False, True], counts), directions)
    whitening = np.zeros((first.rows + other.rows, directions * sum(counts)))
    whitening[: first.rows, ~is_other] = first.whitening
    whitening[first.rows :, is_other] = other.whitening
    nothing = np.zeros((len(first.pose_curves), other.rows))
    offsets = [np.broadcast_to(part.offset, part.rows) for part in (first, other)]
    return replace(
        first,
        measured=np.concatenate([first.measured, other.measured]),
        whitening=whitening,
        log_norm=other.log_norm + first.log_norm,
        nodes=replace(first.nodes, s=np.concatenate([first.nodes.s, other.nodes.s], axis=1)),
        offset=np.concatenate(offsets),
        pose_curves=np.column_stack([first.pose_curves, nothing]),
    )
