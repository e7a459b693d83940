"""An observation: measured places, and the whitening that makes its residuals independent.

Residuals are differences of deflection between the simulated and the measured curve at the same beam
coordinates, or of what an operator makes of these. In space those along y stand before those along z. A known
pose enters the covariance with its prior; a free one is projected off, as the limit of a prior that is flat,
and so is the shift across where the direction alone is known. Which places are measured, and with which
errors, is of each kind of observation: see `observations/`. Equations: docs/inference.md, sections 1 to 3.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cholesky, qr, solve_triangular

from needlefit.arrays import Floats, pad_axis
from needlefit.datasets.insertion import Dataset, Insertion, InsertionPose, Noise, find_pose
from needlefit.datasets.noise import MEAN_NORM_PER_SD
from needlefit.errors import DataError
from needlefit.geometry.frames import align_rigid, differentiate_align_rigid
from needlefit.inference.likelihood.nodes import Nodes, make_nodes
from needlefit.project.toml import locate_key
from needlefit.schemas.recipe import LikelihoodRecord

PLAIN_LIKELIHOOD = LikelihoodRecord(bevel_spread=0.0)  #: all insertions have the same b


@dataclass(frozen=True)
class Discrepancy:
    """A smooth misfit of the model, independent between insertions: a Gaussian process along the needle."""

    #: sd, length: its standard deviation and the length over which it fades, mm
    sd: float
    length: float

    def covariance(self, s: Floats) -> Floats:
        """Return its covariance (K, K), mm^2, at arc lengths `s` (K,)."""
        apart = (s[:, None] - s) / self.length
        return self.sd**2 * np.exp(-0.5 * apart**2)


@dataclass(frozen=True)
class StatedErrors:
    """What the errors of an observation are made of, beside what its insertion states.

    Attributes
    ----------
    noise : Noise
        That of the dataset, or what replaces it.
    insertions : int
        So many are fitted together: they share the bias of an unknown measurement.
    model_error : Discrepancy or None
        Added to the errors of the measurement.
    smoothed : bool
        Whether the smoothing that the dataset states is applied to the simulation; else the stored points are
        taken as the needle's own.
    respond : callable or None
        Gives how points read at s (K,) change with the gain of each of M moves of the guide, (M, K, 3), mm.
    """

    dataset: Dataset
    noise: Noise
    likelihood: LikelihoodRecord = PLAIN_LIKELIHOOD
    insertions: int = 1
    model_error: Discrepancy | None = None
    smoothed: bool = False
    respond: Callable[[Insertion, Floats], Floats] | None = None

    @property
    def bevels_vary(self) -> bool:
        """Whether the bevel may differ between insertions."""
        return self.likelihood.bevel_spread > 0


#: degree of the polynomial whose slope is taken for the needle's: that of the noisy points would be rough
SLOPE_DEGREE = 3


def pose_modes(measured: Floats, slopes: Floats | None = None) -> Floats:
    """Return the change of deflections along y, and then z, by unit errors of a pose, per mm and rad.

    Along y (K, 3): by a shift across, a turn and a shift along. Of points in space (2 K, 6): further by a
    shift and a turn out of that plane, and by a turn about x, the roll. Turns are about the entry, x = 0,
    wherever the points (K, 2) or (K, 3) begin: what is uncertain is the pose of the constraint frame there.
    The needle's `slopes` (K, 1) or (K, 2) are by default those of cubics through the points.
    """
    count, directions = len(measured), measured.shape[1] - 1
    x, y, z = pad_axis(measured, 3).T
    slope_y, slope_z = (
        [_fit_slope(x, values) for values in (y, z)] if slopes is None else pad_axis(slopes, 2).T
    )
    ones, nothing = np.ones(count), np.zeros(count)
    along_y = [ones, x, -slope_y, nothing, nothing, -z]
    along_z = [nothing, nothing, -slope_z, ones, x, y]
    modes = np.concatenate([np.column_stack(along_y), np.column_stack(along_z)])
    return modes[: directions * count, : 3 * directions]


def _fit_slope(x: Floats, y: Floats) -> Floats:
    """Return the slopes (K,) of the cubic through points."""
    degree = min(SLOPE_DEGREE, len(x) - 1)
    # Polynomial.fit scales x to [-1, 1] itself: np.polyfit on mm would be badly conditioned
    return np.asarray(np.polynomial.Polynomial.fit(x, y, degree).deriv()(x))


def pose_sds(insertion: Insertion, noise: Noise, directions: int = 1) -> Floats:
    """Return the prior standard deviations (3,), in 2 directions (6,), of a known pose: mm and rad.

    They are in the order of `pose_modes`. A registration error of mean length m, isotropic in space, has
    m / sqrt(8 / pi) per axis. It and the row's pose deviation are often one error stated twice: the larger
    one counts, as in the noise floor.
    """
    shift, angle = (
        max(insertion.pose_shift_sd, noise.registration_mean / MEAN_NORM_PER_SD),
        insertion.pose_angle_sd,
    )
    return np.array([shift, angle, shift, shift, angle, insertion.roll_sd])[: 3 * directions]


#: a small turn about x moves deflections (y, z) by so much of them
QUARTER_TURN = np.array([[0.0, -1.0], [1.0, 0.0]])
#: the columns of `pose_modes` that are shifts across, in the plane and out of it
ACROSS = (0, 3)


def split_pose_modes(insertion: Insertion, modes: Floats, sds: Floats) -> tuple[Floats, Floats]:
    """Return the change (C, c) by a deviation of what is known of a pose, and (C, f) by a unit of the rest.

    `modes` (C, c + f) are the changes by unit errors of a pose in the world, `sds` their deviations. Where
    the direction alone is known, shifts across are the rest.
    """
    rest = [n for n in ACROSS if n < len(sds) and find_pose("known", insertion) == "direction"]
    return np.delete(modes * sds, rest, axis=1), modes[:, rest]


def points_covariance(s: Floats, noise: Noise, sd: Floats | None = None) -> Floats:
    """Return the covariance (K, K), mm^2, of points at arc lengths `s` (K,).

    `sd` (K,), mm, is the deviation of each point's shared part; by default that of `noise` for all.
    """
    deviation = np.full(len(s), noise.correlated_sd) if sd is None else sd
    shared = np.outer(deviation, deviation) * noise.correlate(s)
    return noise.point_sd**2 * np.eye(len(s)) + shared


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


def no_errors_error(dataset: Dataset, insertion: Insertion) -> DataError:
    """Return the error of a dataset whose noise leaves the points of an insertion without errors."""
    return DataError(
        f"the noise stated by `{dataset.name}` leaves the points of `{insertion.id}` without errors",
        where=locate_key(dataset.path, "noise.point_sd_mm"),
        expected="noise.point_sd_mm above 0",
        fix="write how well a point is known, per axis",
    )


def list_pose_modes(
    insertion: Insertion, errors: StatedErrors, measured: Floats, slopes: Floats | None = None
) -> tuple[Floats, Floats]:
    """Return the changes (C, c) by errors of a known pose, and their deviations (c,), of what is compared."""
    return pose_modes(measured, slopes), pose_sds(insertion, errors.noise, errors.dataset.directions)


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
