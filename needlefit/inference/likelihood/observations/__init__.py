"""Observations: what can be measured of an insertion, here or by a plugin, and how a simulation is compared.

An insertion states by what it was measured (`Insertion.observations`). What a file here does not override is
that of points along the needle, read at the end of the insertion.

An `Observation` holds measured places, and the whitening that makes its residuals independent. Residuals are
differences of deflection between the simulated and the measured curve at the same beam coordinates, or of
what an operator makes of these. In space those along y stand before those along z. A known pose enters the
covariance with its prior; a free one is projected off, as the limit of a prior that is flat, and so is the
shift across where the direction alone is known. Equations: docs/inference.md, sections 1 to 3.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from scipy.linalg import cholesky, qr, solve_triangular

from needlefit.arrays import Floats, pad_axis
from needlefit.datasets.columns import OBSERVATION_COLUMN, OBSERVATION_PREFIX
from needlefit.datasets.insertion import (
    Dataset,
    Insertion,
    InsertionPose,
    Noise,
    Pose,
    find_free_reach,
    find_pose,
)
from needlefit.datasets.noise import MEAN_NORM_PER_SD, NoiseFloor, estimate_noise_floor
from needlefit.errors import DataError
from needlefit.geometry.curves import (
    COMPARISON_POINTS,
    ComparedCurves,
    Quantity,
    compare_curves,
    select_compared,
)
from needlefit.geometry.frames import (
    align_lateral,
    align_rigid,
    differentiate_align_lateral,
    differentiate_align_rigid,
)
from needlefit.inference.likelihood.nodes import ErrorAxis, Nodes, Surface, make_nodes
from needlefit.mechanics.batch import (
    Jacobians,
    NeedleShapes,
    compute_batch_positions,
    differentiate_batch_positions,
)
from needlefit.mechanics.shape import NeedleShape, compute_positions
from needlefit.metrics import list_metrics
from needlefit.project.toml import locate_key
from needlefit.registry import Registry
from needlefit.schemas.base import Compared
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


# ---- points at which a simulated and a measured needle are compared, and what lays one on the other


def turn_about_x(points: Floats, angle: Floats | float) -> Floats:
    """Return points (..., K, 3) turned about C's x axis by angles (...,), rad."""
    cos, sin = (np.asarray(part)[..., None] for part in (np.cos(angle), np.sin(angle)))
    x, y, z = np.moveaxis(points, -1, 0)
    return np.stack([x, cos * y - sin * z, sin * y + cos * z], axis=-1)


def draw_rolls(roll_sd: float, directions: int, count: int, rng: np.random.Generator) -> Floats:
    """Draw errors of the roll (count,), rad; none are drawn where y alone is compared: they move nothing."""
    return roll_sd * rng.standard_normal((directions - 1, count)).sum(axis=0)


Curve = Callable[[Floats], Floats]

#: part of the scored points, from the entry side, whose line is x in a free comparison
ENTRY_SIDE_FRACTION = 0.2


# ---- what is compared, and the kinds of observations


@dataclass(frozen=True)
class ComparedPoints:
    """The measured points of one comparison, and where the simulated ones are taken."""

    s: Floats  #: (K,) where on the beam the simulated points are taken, mm from the entry
    measured: Floats  #: (K, 3) measured points, entry side first, tip last, mm
    pose: InsertionPose
    compared: Compared = "plane"
    quantity: Quantity = "places"
    #: (K, M) from simulated points at `s` (M,) to what is compared across; None where these are it
    operator: Floats | None = None

    def read(self, points: Floats, axis: int = -1) -> Floats:
        """Return what is compared (..., K, 3) of simulated points (..., M, 3): combined, at measured x.

        `axis` is that of the coordinates, the points stand before it. Derivatives by theta, whose last axis
        is another, have none along x.
        """
        if self.operator is None:
            return points
        axis %= points.ndim
        across = np.moveaxis(np.tensordot(self.operator, points, (1, axis - 1)), 0, axis - 1)
        x = self.measured[:, 0] if axis == points.ndim - 1 else 0.0
        np.moveaxis(across, axis, 0)[0] = x
        return across

    def select(self, points: Floats, axis: int = -1) -> Floats:
        """Return what is compared of points (..., M, 3): one or two coordinates across them beside x."""
        return select_compared(self.read(points, axis), self.compared, axis)

    @property
    def target(self) -> Floats:
        """The compared coordinates of the measured points, (K, 2) or (K, 3) mm."""
        return select_compared(self.measured, self.compared)

    def compare(self, curve: Curve) -> ComparedCurves:
        """Return a simulated curve beside the measured one."""
        return compare_curves(*align_points(self, curve), self.compared, self.quantity)


def align_points(target: ComparedPoints, curve: Curve) -> tuple[Floats, Floats]:
    """Return the simulated and the measured points (K, 3), aligned in the plane where the pose is unknown."""
    simulated, measured = target.read(curve(target.s)), target.measured
    if target.pose != "free":
        return align(target.pose, simulated, measured), measured
    planar = align(target.pose, simulated[:, :2], measured[:, :2])
    return np.column_stack([planar, simulated[:, 2]]), measured


#: what of a frame is unknown across the needle: a shift, or a shift and a slope
LATERAL_TERMS: Mapping[InsertionPose, Literal[1, 2]] = {"direction": 1, "tracker": 2}


def align(pose: InsertionPose, simulated: Floats, measured: Floats) -> Floats:
    """Return simulated points (..., K, 2) as the pose allows them to lie beside the measured ones (K, 2).

    In space both have three coordinates; free shapes are in a plane.
    """
    if pose == "free":
        return align_rigid(simulated, measured)
    terms = LATERAL_TERMS.get(pose)
    return simulated if terms is None else align_lateral(simulated, measured, terms)


def differentiate_align(pose: InsertionPose, simulated: Floats, measured: Floats, slopes: Floats) -> Floats:
    """Return the derivatives (..., K, 2, P) of `align`, given those of the simulated points (..., K, 2)."""
    if pose == "free":
        return differentiate_align_rigid(simulated, measured, slopes)
    terms = LATERAL_TERMS.get(pose)
    return slopes if terms is None else differentiate_align_lateral(measured, slopes, terms)


def rotate_to_entry_axes(points: Floats) -> Floats:
    """Return points (K, 2) relative to the first one, with x along the line through their entry side."""
    first = points[: count_entry_side(len(points))]
    centred = first - first.mean(axis=0)
    # the first right singular vector is the least-squares line; its sign is arbitrary
    direction = np.linalg.svd(centred, full_matrices=False)[2][0]
    direction = direction if direction @ (first[-1] - first[0]) >= 0 else -direction
    to_axes = np.array([[direction[0], -direction[1]], [direction[1], direction[0]]])
    return (points - points[0]) @ to_axes


def count_entry_side(count: int) -> int:
    """Return how many of `count` points, from the entry side, give the line that is x."""
    return max(2, round(ENTRY_SIDE_FRACTION * count))


# ---- what can be measured


@dataclass(frozen=True)
class ObservationType:
    """One thing that can be measured of an insertion."""

    #: what insertions state in `observation`
    name: str
    #: whether it is read while the needle is inserted: insertions alike are then simulated once
    on_the_way: bool = False
    #: whether a curve is measured: without one some metrics and baselines mean nothing
    is_curve: bool = True
    #: whether the place of the tip is measured
    has_tip: bool = True

    def take_alone(self, dataset: Dataset, insertion: Insertion) -> tuple[Dataset, Insertion]:
        """Return dataset and insertion as if this observation alone had been made of what was measured."""
        return dataset, replace(insertion, curvature=None, tip=None, observation_values={})

    def compare(self, dataset: Dataset, insertion: Insertion) -> tuple[ComparedPoints, ...]:
        """Return what a curve is compared with."""
        pose, compared = dataset.pose, dataset.compared
        return (self.select_points(pose, dataset.drop_proximal, insertion, COMPARISON_POINTS, compared),)

    def estimate_floor(self, dataset: Dataset, insertion: Insertion, rng: np.random.Generator) -> NoiseFloor:
        """Return the mean errors of the measurement against itself, made again."""
        return estimate_noise_floor(dataset, insertion, rng)

    def select_points(
        self, pose: Pose, drop: float, insertion: Insertion, stations: int, compared: Compared
    ) -> ComparedPoints:
        """Return the measured points that a curve is compared with; see the function of that name."""
        along = insertion.measure_arc(compared)
        if pose == "known":
            fractions = np.linspace(0.0, 1.0, stations)
            s, at = insertion.depth * fractions, fractions * along[-1]
        else:
            to_tip = np.linspace(find_free_reach(drop, insertion), 0.0, stations)
            s, at = insertion.depth - to_tip, float(along[-1]) - to_tip
        measured = np.column_stack([np.interp(at, along, axis) for axis in insertion.points.T])
        if pose != "known":
            measured[:, :2] = rotate_to_entry_axes(measured[:, :2])
        return ComparedPoints(s, measured, find_pose(pose, insertion), compared)

    def read_points(self, shape: NeedleShape, s: Floats) -> Floats:
        """Return the simulated points (K, 3) at beam coordinates `s` (K,), mm."""
        return compute_positions(shape, s)

    def read_batch_points(self, shapes: NeedleShapes, s: Floats) -> Floats:
        """Return `read_points` (B, K, 3) of many simulations of one insertion."""
        return compute_batch_positions(shapes, s)

    def read_batch_derivatives(self, shapes: NeedleShapes, jacobians: Jacobians, s: Floats) -> Floats:
        """Return the derivatives (B, K, 3, P) of `read_batch_points`."""
        return differentiate_batch_positions(shapes, jacobians, s)

    def measure(self, dataset: Dataset, insertion: Insertion, needle: "TrueNeedle") -> Insertion | None:
        """Return the insertion as this measures a simulated needle; None where that bends as none can."""
        return OBSERVATIONS["points"].measure(dataset, insertion, needle)

    def thin(self, insertion: Insertion, count: int) -> Insertion:
        """Return an insertion of which about `count` places were measured, of more."""
        step = max(1, math.ceil(len(insertion.points) / count))
        chosen = np.arange(len(insertion.points) - 1, -1, -step)[::-1]  # keeps the tip
        sd = None if insertion.sd is None else insertion.sd[chosen]
        return replace(insertion.with_points(insertion.points[chosen, :2]), sd=sd)

    def observe(self, insertion: Insertion, errors: StatedErrors) -> Observation:
        """Return what the likelihood compares; DataError if the errors that are stated leave it no width."""
        return OBSERVATIONS["points"].observe(insertion, errors)

    def observe_values(self, insertion: Insertion, errors: StatedErrors) -> Observation:
        """Return what it compares besides, where the insertion has `observation_values`, in a known pose.

        Fits are to both; what is predicted is that of `observe`.
        """
        raise DataError(
            f"the observation `{self.name}` has no numbers besides, and {insertion.id} has some",
            expected=f"no columns {OBSERVATION_PREFIX}{', '.join(insertion.observation_values)}",
            fix=f"remove the columns, or name their {OBSERVATION_COLUMN}",
        )


OBSERVATIONS = Registry(ObservationType, __name__, "observation")


def make_observation(
    dataset: Dataset,
    insertion: Insertion,
    noise: Noise | None = None,
    likelihood: LikelihoodRecord = PLAIN_LIKELIHOOD,
    insertions: int = 1,
    model_error: Discrepancy | None = None,
    respond: Callable[[Insertion, Floats], Floats] | None = None,
) -> Observation:
    """Return the observation of one insertion, by all that was measured of it.

    `noise` replaces what the dataset states; the stored points are then taken as the needle's own. See
    `StatedErrors` for the others.

    Raises DataError if no noise is stated: without any, a likelihood has no width.
    """
    smoothed = noise is None and likelihood.measurement == "stored" and likelihood.noise == "correlated"
    dataset = dataset if noise is None else replace(dataset, noise=noise)
    errors = StatedErrors(
        dataset, dataset.noise.of(insertion), likelihood, insertions, model_error, smoothed, respond
    )
    if likelihood.measurement == "curvature":
        return OBSERVATIONS["curvature"].observe(insertion, errors)
    # the cross-sections are what the points were drawn through, and stand in their place alone
    first, *others = list_observations(insertion)
    found = (OBSERVATIONS["sections"] if smoothed and has_sections(dataset, insertion) else first).observe(
        insertion, errors
    )
    # a scale of the noise counts for the poses of others, too: joined observations have no curves of a pose
    plain = likelihood.model_copy(update={"noise_scale": 1.0})
    for kind in others:
        data, alone = kind.take_alone(dataset, insertion)
        errors_alone = replace(errors, dataset=data, noise=data.noise.of(alone), likelihood=plain)
        found = join_observations(found, kind.observe(alone, errors_alone))
    if not insertion.observation_values:
        return found
    if dataset.pose != "known":
        raise DataError(
            f"{insertion.id} has numbers besides its points, and its pose is not known",
            expected=f"no columns {OBSERVATION_PREFIX}{', '.join(insertion.observation_values)}",
            fix='remove the columns, or state poses (pose = "known")',
        )
    return join_observations(found, OBSERVATIONS[insertion.observation].observe_values(insertion, errors))


def has_sections(dataset: Dataset, insertion: Insertion) -> bool:
    """Return whether the cross-sections stand in the place of the points that were drawn through them."""
    is_shape = insertion.observation == "points" and dataset.pose == "known"
    return is_shape and insertion.sections is not None


def select_points(
    pose: Pose,
    drop: float,
    insertion: Insertion,
    stations: int = COMPARISON_POINTS,
    compared: Compared = "plane",
) -> ComparedPoints:
    """Return the measured points that a curve is compared with, entry side first, tip last.

    Pose known: both curves lie in C and are sampled at equal fractions of their own inserted arc length.

    Direction known (the entry is the first point of the inserted needle, which has moved with it): the same,
    after the shift across that brings the simulated points closest to the measured ones.

    Pose free (shapes known only up to a rigid motion): both are sampled at the same arc lengths from the tip,
    over [0, min(measured length, D) - `drop`]. The simulated points are then laid on the measured ones by the
    rigid motion that fits them best. Both are shown in the axes of the measured entry side: x along the
    least-squares line through the first fifth of the scored points, from which deflections are measured.
    """
    return OBSERVATIONS[insertion.observation].select_points(pose, drop, insertion, stations, compared)


def list_observations(insertion: Insertion) -> list[ObservationType]:
    """Return by what an insertion was measured, first what it states in `observation`."""
    return [OBSERVATIONS[name] for name in insertion.observations]


def measures_tip(insertion: Insertion) -> bool:
    """Return whether the place of the tip was measured of an insertion."""
    return any(kind.has_tip for kind in list_observations(insertion))


class ScoredObservation(NamedTuple):
    """An observation by which an insertion is scored; dataset and insertion as if it alone had been made."""

    kind: ObservationType
    dataset: Dataset
    insertion: Insertion


def list_scored(dataset: Dataset, insertion: Insertion) -> list[ScoredObservation]:
    """Return by what an insertion is scored: each of its observations that has all directions compared."""
    scored = [
        ScoredObservation(kind, *kind.take_alone(dataset, insertion)) for kind in list_observations(insertion)
    ]
    others = [part for part in scored[1:] if part.insertion.directions >= dataset.directions]
    return [*scored[:1], *others]


def list_comparisons(dataset: Dataset, insertion: Insertion) -> list[ComparedPoints]:
    """Return all that a curve is compared with of an insertion, by each of its observations."""
    scored = list_scored(dataset, insertion)
    return [goal for kind, data, alone in scored for goal in kind.compare(data, alone)]


def estimate_floor(dataset: Dataset, insertion: Insertion, rng: np.random.Generator) -> NoiseFloor:
    """Return the mean errors of all that was measured of an insertion against itself, measured again.

    Those of places are NaN where none was measured; of a tip that was measured by itself they are its own.
    """
    floors = {metric.name: math.nan for metric in list_metrics("places") if metric.has_floor}
    for kind, data, alone in list_scored(dataset, insertion):
        estimated = kind.estimate_floor(data, alone, rng)
        floors |= {name: floor for name, floor in estimated.items() if not math.isnan(floor)}
    return floors


def read_points(insertion: Insertion, shape: NeedleShape, s: Floats) -> Floats:
    """Return the simulated points (K, 3) of an insertion, mm; NaN where the solve failed.

    `s` (K,), mm, are those of its observation: beam coordinates, or depths.
    """
    if not shape.converged:
        return np.full((len(s), 3), np.nan)
    return OBSERVATIONS[insertion.observation].read_points(shape, s)


@dataclass(frozen=True)
class TrueNeedle:
    """A simulated needle that is measured, with errors `scale` times as large as stated."""

    insertion: Insertion  #: as it truly was
    shape: NeedleShape
    deeper: float = 0.0  #: than stated, mm
    scale: float = 1.0
    rng: np.random.Generator | None = None  #: draws the errors; None: there are none
    errors: StatedErrors | None = None  #: of readings on the way; None: those that the dataset states
    #: errors, in standard deviations, that several insertions share; filled as needed
    shared: dict[Surface, float] = field(default_factory=dict)

    def read(self, s: Floats) -> Floats:
        """Return its points (K, 3) at stated beam coordinates `s` (K,), mm."""
        return read_points(self.insertion, self.shape, s + self.deeper)

    def draw(self, *shape: int) -> Floats:
        """Return errors in standard deviations."""
        return np.zeros(shape) if self.rng is None else self.rng.standard_normal(shape)

    def draw_errors(self, covariance: Floats) -> Floats:
        """Return errors (K,) with a covariance (K, K)."""
        draws = self.draw(len(covariance))
        return draws if self.rng is None else np.linalg.cholesky(covariance) @ draws

    def draw_along(self, axes: Sequence[ErrorAxis]) -> Floats:
        """Return errors (d,) in standard deviations along axes; what insertions share is drawn once."""
        errors = self.draw(len(axes))
        for n, axis in enumerate(axes):
            if axis.surface and axis.surface not in self.shared:
                self.shared[axis.surface] = float(self.draw(1)[0])
            errors[n] = axis.own * errors[n] + axis.shared * self.shared.get(axis.surface, 0.0)
        return errors


def measure(dataset: Dataset, insertion: Insertion, needle: TrueNeedle) -> Insertion | None:
    """Return an insertion as all that it holds measures a simulated needle; None where nothing can."""
    measured: Insertion | None = insertion
    for kind in list_observations(insertion) if needle.shape.converged else ():
        measured = None if measured is None else kind.measure(dataset, measured, needle)
    return measured if needle.shape.converged else None


@dataclass(frozen=True)
class SimulatedCurve:
    """A simulated insertion as a function: see `read_points`."""

    shape: NeedleShape
    insertion: Insertion

    def __call__(self, s: Floats) -> Floats:
        """Return the points at `s` (K,)."""
        return read_points(self.insertion, self.shape, s)
