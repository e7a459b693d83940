"""Turn an insertion into an observation: measured points, and the whitening that makes residuals independent.

Residuals are differences of deflection between the simulated and the measured curve at the same beam
coordinates, or, where a reconstruction drew a smoothing spline, of spline coefficients. In space those along
y stand before those along z. A known pose enters the covariance with its prior; a free one is projected off,
as the limit of a prior that is flat, and so is the shift across where the direction alone is known. A tip
track is the same: its points are the tips at some depths, and a shift and a slope of the tracker's frame are
projected off. Equations: docs/inference.md, sections 1 to 3 and "Tip tracks".
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag, cholesky, qr, solve_triangular

from needlefit.arrays import Bools, Floats
from needlefit.datasets.columns import MIN_SENSOR_MM
from needlefit.datasets.insertion import (
    DEFAULT_MEASUREMENT,
    Dataset,
    Insertion,
    InsertionPose,
    Noise,
    TipTrack,
    find_pose,
    select_compared_places,
)
from needlefit.datasets.noise import MEAN_NORM_PER_SD
from needlefit.errors import DataError
from needlefit.geometry.frames import align_rigid, differentiate_align_rigid, make_tracker_columns
from needlefit.geometry.smoothing_spline import SplineSections, fit_matrices, make_knots
from needlefit.inference.compared_points import pad_planes, rotate_to_entry_axes
from needlefit.inference.likelihood.nodes import FRAME, GROUP_GAIN, GROUP_SLOPE, ErrorAxis, Nodes, make_nodes
from needlefit.project.toml import locate_key
from needlefit.schemas.dataset import MeasurementRecord
from needlefit.schemas.recipe import LikelihoodRecord, TrackErrorsRecord

SHARED_ERROR_LENGTH_MM = 7.5  #: length over which errors that neighbouring cross-sections share fade, mm
#: cross-sections within so many deviations of the depth from the needle's base are left out: a depth that
#: errs must not move them off the needle
DEPTH_ERRORS_KEPT = 4.0


@dataclass(frozen=True)
class SectionData:
    """The cross-sections of one insertion, as the likelihood takes them."""

    s: Floats  #: (K,) their beam coordinates, mm; negative outside the tissue
    places: Floats  #: (K, 3) places in C, mm
    operator: Floats  #: (F, K) from their deflections to the F coefficients of the spline
    #: (2 F, 2 F) of these coefficients along y and then z, by the spline and by what neighbours share, mm^2
    covariance: Floats
    shared: Floats  #: (2 K, 2 K) covariance of what neighbours share along y and then z, mm^2
    slope: Floats  #: (K, 2) slopes of the spline there, dy/dx and dz/dx
    reached: Bools  #: (C,) which of the spline's coefficients the F are
    stored: SplineSections  #: as stored; those left out are not in it


def select_sections(insertion: Insertion) -> SectionData | None:
    """Return the cross-sections of an insertion between base (or guide) and tip; None where it has none."""
    stored = insertion.sections
    if stored is None:
        return None
    s = np.minimum(insertion.depth, stored.s * (insertion.depth / stored.s[-1]))
    base = insertion.depth - insertion.needle.length + DEPTH_ERRORS_KEPT * insertion.depth_sd
    first = base if insertion.guide_distance is None else max(base, -insertion.guide_distance)
    kept = s >= first
    s, stored = s[kept], stored.select(kept)
    places = insertion.frame.to_local(stored.points)
    fit = fit_matrices(stored.q, stored.weights, stored.knots)
    fade = np.exp(-np.abs(s[:, None] - s) / SHARED_ERROR_LENGTH_MM)  # (K, K)
    along = insertion.frame.rotation.T @ stored.shared_along
    further = np.outer(along[1:], along[1:])  # of y and z
    shared = stored.shared_sd**2 * fade
    own = stored.sigma**2 * fit.spread + fit.operator @ shared @ fit.operator.T
    covariance = block_diag(own, own) + np.kron(further, fit.operator @ fade @ fit.operator.T)
    shared = block_diag(shared, shared) + np.kron(further, fade)
    by_q = fit.slope @ (fit.operator @ places)  # (K, 3)
    slope = by_q[:, 1:] / by_q[:, :1]
    return SectionData(s, places, fit.operator, covariance, shared, slope, fit.reached, stored)


def points_operator(measurement: MeasurementRecord, s: Floats) -> Floats | None:
    """Return the matrix (R, K) that smooths deflections at the arc lengths `s` (K,) of stored points.

    Of a spline it leads to its coefficients; None where the points are the needle's own.
    """
    if measurement.operator == "spline" and measurement.knot_spacing_mm is not None:
        knots = make_knots(s[0], s[-1], measurement.knot_spacing_mm)
        return fit_matrices(s, np.ones(len(s)), knots).operator
    if measurement.operator == "gaussian" and measurement.width_mm is not None:
        # every point stands for the stretch halfway to its neighbours
        weights = np.gradient(s) * np.exp(-0.5 * ((s[:, None] - s) / measurement.width_mm) ** 2)
        return np.asarray(weights / weights.sum(axis=1, keepdims=True))
    return None


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


#: to both sides of a sensor, over which the simulated curvature is taken, mm
SENSOR_STEP_MM = MIN_SENSOR_MM
#: length over which the direction of a simulated path is taken, mm: shorter than constraints are apart
HEADING_STEP_MM = 0.25
#: prior deviation of a session's slope and of its headings' offset, rad: registrations err by less
SESSION_SD_RAD = 0.2
#: degree of the polynomial whose slope is taken for the needle's: that of the noisy points would be rough
SLOPE_DEGREE = 3


def pose_modes(measured: Floats, slope: Floats | None = None) -> Floats:
    """Return the change (K, 3) of deflections by a unit shift across, turn, and shift along.

    Per mm, per rad, per mm. The turn is about the entry, x = 0, wherever the points (K, 2) begin: what is
    uncertain is the pose of the constraint frame there. The needle's `slope` (K,) is by default that of a
    cubic through the points.
    """
    x = measured[:, 0]
    if slope is None:
        degree = min(SLOPE_DEGREE, len(x) - 1)
        # Polynomial.fit scales x to [-1, 1] itself: np.polyfit on mm would be badly conditioned
        slope = np.polynomial.Polynomial.fit(x, measured[:, 1], degree).deriv()(x)
    return np.column_stack([np.ones(len(x)), x, -slope])


def pose_modes_in_space(measured: Floats, slopes: Floats | None = None) -> Floats:
    """Return the change (2 K, 6) of deflections along y, then z, by unit errors of pose and roll.

    Those of `pose_modes` in the plane, a shift and a turn out of it, and a turn about x. `measured` is
    (K, 3); `slopes` (K, 2) are by default those of cubics through the points.
    """
    (y, z), nothing = measured[:, 1:].T, np.zeros((len(measured), 2))
    along_y = pose_modes(measured, None if slopes is None else slopes[:, 0])
    along_z = pose_modes(measured[:, [0, 2]], None if slopes is None else slopes[:, 1])
    return np.concatenate(
        [
            np.column_stack([along_y, nothing, -z]),
            np.column_stack([nothing, along_z[:, 2], along_z[:, :2], y]),
        ]
    )


def pose_sds_in_space(insertion: Insertion, noise: Noise) -> Floats:
    """Return the prior standard deviations (6,) in the order of `pose_modes_in_space`."""
    return np.concatenate([sds := pose_sds(insertion, noise), sds[:2], [insertion.roll_sd]])


def pose_sds(insertion: Insertion, noise: Noise) -> Floats:
    """Return the prior standard deviations (3,) of a known pose: mm, rad, mm, in the order of `pose_modes`.

    A registration error of mean length m, isotropic in space, has m / sqrt(8 / pi) per axis. It and the
    row's pose deviation are often one error stated twice: the larger one counts, as in the noise floor.
    """
    shift = max(insertion.pose_shift_sd, noise.registration_mean / MEAN_NORM_PER_SD)
    return np.array([shift, insertion.pose_angle_sd, shift])


#: the columns of `pose_modes_in_space` that are shifts across, in the plane and out of it
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


PLAIN_LIKELIHOOD = LikelihoodRecord(bevel_spread=0.0)  #: all insertions have the same b


@dataclass(frozen=True)
class Observation:
    """One insertion, prepared for comparison with simulated needles."""

    measured: Floats  #: (K, 2), in space (K, 3), measured places, mm; of a tip track depth and tip
    #: (C, C) of the errors of what is compared at noise scale 1, mm^2: of the K measured y (in space of y,
    #: then z), or of C spline coefficients
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

    @property
    def rows(self) -> int:
        """R: the number of independent residuals."""
        return len(self.whitening)

    @property
    def insertion(self) -> Insertion:
        return self.nodes.insertions[0]

    @property
    def planes(self) -> int:
        """1 where deflections are compared along y, 2 along y and z."""
        return self.measured.shape[1] - 1

    def stack(self, points: Floats) -> Floats:
        """Return the deflections (..., K) of points (..., K, 2), in space (..., 2 K): along y, then z."""
        if self.planes == 1:
            return points[..., 1]
        padded = pad_planes(points, 2)
        return np.concatenate([padded[..., 1], padded[..., 2]], axis=-1)

    def covariance(self, scale: float = 1.0) -> Floats:
        """Return the covariance (K, K) of the errors of the measured y, mm^2, with a scale of the noise."""
        return scale**2 * self.point_covariance + self.pose_spread @ self.pose_spread.T

    @cached_property
    def estimator(self) -> Floats:
        """Matrix (f, K) that gives the best coefficients of `free` for measured minus simulated y (K,)."""
        weighted = np.linalg.solve(self.covariance(), self.free)  # (K, f)
        return np.asarray(np.linalg.solve(self.free.T @ weighted, weighted.T), dtype=np.float64)


def make_observation(
    dataset: Dataset,
    insertion: Insertion,
    noise: Noise | None = None,
    likelihood: LikelihoodRecord = PLAIN_LIKELIHOOD,
    insertions: int = 1,
    model_error: Discrepancy | None = None,
) -> Observation:
    """Return the observation of one insertion.

    `noise` replaces what the dataset states; the stored points are then taken as the needle's own. So many
    `insertions` are fitted together: they share the bias of an unknown measurement. `model_error` is added to
    the errors of the measurement.

    Raises DataError if no noise is stated: without any, a likelihood has no width.
    """
    smoothed = noise is None and likelihood.measurement == "stored" and likelihood.noise == "correlated"
    if isinstance(insertion, TipTrack):
        stated = dataset.noise if noise is None else noise
        if likelihood.measurement == "points":
            stated = replace(stated, heading_sd=0.0, slope_sd=0.0)
        return _observe_track(dataset, insertion, stated, likelihood, model_error)
    known = select_sections(insertion) if smoothed and dataset.pose == "known" else None
    if known is not None:
        return _observe_sections(dataset, insertion, known, likelihood, model_error)
    measurement = dataset.measurement if smoothed else DEFAULT_MEASUREMENT
    noise = dataset.noise if noise is None else noise
    along, s = select_compared_places(dataset.pose, dataset.drop_proximal, insertion, dataset.planes)
    arc, axes = insertion.measure_arc(dataset.planes), [*insertion.planar.T, insertion.out_of_plane]
    measured = np.column_stack([np.interp(along, arc, axis) for axis in axes[: 1 + dataset.planes]])
    measured = measured if dataset.pose == "known" else rotate_to_entry_axes(measured)
    sd = None if insertion.sd is None else np.interp(along, arc, insertion.sd)
    cov, free = points_covariance(s, noise, sd), make_tracker_columns(measured[:, 0])  # across, and turn
    if measurement.bias_sd_mm is not None and measurement.bias_length_mm is not None:
        # An unknown operator: a smooth bias that all insertions of a fit share. Its covariance counts as
        # often as there are insertions, so that together they do not average it away.
        size = measurement.bias_sd_mm * math.sqrt(insertions)
        cov = cov + Discrepancy(size, measurement.bias_length_mm).covariance(s)
    cov = cov if model_error is None else cov + model_error.covariance(s)
    operator = points_operator(measurement, s)
    if operator is not None and measurement.operator == "spline":
        cov, free = operator @ cov @ operator.T, operator @ free
    if dataset.planes == 2:
        cov, free = block_diag(cov, cov), np.empty((2 * len(cov), 0))
        operator = None if operator is None else block_diag(operator, operator)
        modes, sds = pose_modes_in_space(measured), pose_sds_in_space(insertion, noise)
    else:
        modes, sds = pose_modes(measured), pose_sds(insertion, noise)
    pose = np.empty((len(cov), 0))
    if dataset.pose == "known":
        pose, free = (_apply(operator, part) for part in split_pose_modes(insertion, modes, sds))
    # else across and turn alone: arc lengths are counted from the tip, so that nothing shifts along them
    try:
        whitening, log_norm, curves = _whiten_known(cov, pose, free, likelihood)
    except np.linalg.LinAlgError:
        raise _without_errors(dataset, insertion) from None
    varies = likelihood.bevel_spread > 0
    places = append_sensors(insertion, s)
    nodes = make_nodes(insertion, places, likelihood.depths, bevel=varies, constants=len(curves))
    offset: Floats | float = 0.0
    if measurement.operator == "gaussian":  # what is stored was smoothed already, the simulation was not
        stored = measured[:, 1:].T.ravel()
        offset = whitening @ (_apply(operator, stored) - stored)
    whitening = whitening if operator is None else whitening @ operator
    known_of = find_pose(dataset.pose, insertion)
    found = Observation(measured, cov, pose, free, whitening, log_norm, known_of, nodes, curves, offset)
    return add_curvature(found, likelihood.measurement == "curvature")


def _observe_track(
    dataset: Dataset,
    track: TipTrack,
    noise: Noise,
    likelihood: LikelihoodRecord,
    model_error: Discrepancy | None,
) -> Observation:
    """Return the observation of a tip track: of its readings, and of their headings if their error is stated.

    What is compared are the tips and then the headings of all readings but the first, which is in no tissue;
    in space those along y before those along z.
    """
    errors, directions = likelihood.tip_tracks, track.list_directions(dataset.planes)
    headings = [one.heading for one in directions if noise.heading_sd > 0 and one.heading is not None]
    axes, parts = list[ErrorAxis](), list[tuple[Floats, ...]]()
    for number, one in enumerate(directions):
        cov, operator = points_covariance(one.depths, noise, one.sd), np.eye(len(one.depths))
        frame, measured = make_tracker_columns(one.depths), one.planar
        if len(headings) == len(directions):
            measured, operator = add_headings(one, headings[number])
            cov = block_diag(cov, noise.heading_sd**2 * np.eye(len(operator) - len(cov)))
            turned = np.tile([0.0, 1.0, 1.0], (len(operator) - len(frame), 1))
            frame = np.concatenate([np.column_stack([frame, np.zeros(len(frame))]), turned])
        at = measured[:, 0]
        # along the depth; what they do to a heading is their slope there
        added = entry_covariance(one, at, errors)
        added = added if model_error is None else added + model_error.covariance(at)
        cov = cov + operator @ added @ operator.T
        if likelihood.noise == "independent":
            cov = np.diag(np.diag(cov))
        own = list_session_axes(track.specimen, noise.slope_sd, frame.shape[1] - 1, number)
        free = frame[:, : frame.shape[1] - len(own)]
        session = frame[:, free.shape[1] :] * [SESSION_SD_RAD / axis.shared for axis in own]
        if own and errors.slope_sd_deg:
            own = (*own, make_group_slope(track, number))
            session = np.column_stack([session, math.radians(errors.slope_sd_deg) * frame[:, 1]])
        axes += own
        parts.append((measured[:, 1], operator, cov, free, session))
    across, *blocks = zip(*parts, strict=True)
    operator, cov, free, session = (block_diag(*block) for block in blocks)
    try:
        whitening, log_norm = whiten(cov, free)
    except np.linalg.LinAlgError:
        raise _without_errors(dataset, track) from None
    curves, varies = (whitening @ session).T, likelihood.bevel_spread > 0
    gain, roll_sd_deg = make_gain(track, errors.gain_sd), errors.roll_sd_deg * (len(directions) - 1)
    nodes = make_nodes(
        track, at, "fixed", bevel=varies, constants=len(curves), shared=tuple(axes), gain=gain,
        roll_sd_deg=roll_sd_deg,
    )  # fmt: skip
    measured, whitening = np.column_stack([at, *across]), whitening @ operator
    return Observation(measured, cov, session, free, whitening, log_norm, dataset.pose, nodes, curves)


def _name_group(track: TipTrack) -> str:
    """Return the name of the group of a run: its medium, and whether the guide moved."""
    return f"{track.medium}, {'steered' if track.guided else 'at rest'}"


def make_group_slope(track: TipTrack, direction: int = 0) -> ErrorAxis:
    """Return the axis of the slope that a run's group has along y (0) or z (1)."""
    return ErrorAxis(0.0, 1.0, (track.specimen, GROUP_SLOPE, _name_group(track) + ", along z" * direction))


def make_gain(track: TipTrack, sd: float) -> tuple[ErrorAxis, float] | None:
    """Return the axis of a run's gain, and its SD, `sd` of the group and as much of the run; or None."""
    if not (track.guided and sd):
        return None
    part = math.sqrt(0.5)
    return ErrorAxis(part, part, (track.specimen, GROUP_GAIN, _name_group(track))), sd / part


def entry_covariance(track: TipTrack, depths: Floats, errors: TrackErrorsRecord) -> Floats:
    """Return the covariance (K, K), mm^2, of errors by a yielding entry, at `depths` (K,) of the tip.

    The tip is then off by an unknown length, and by an unknown part of how far the guide has moved. Both fade
    with depth, over the same length over which they vary.
    """
    moved = np.interp(depths, track.depths, track.guide - track.guide[0])
    fading = np.exp(-depths / errors.entry_length_mm)
    size = np.array([np.full(len(depths), errors.entry_sd_mm), errors.entry_yield * moved]) * fading
    return (size.T @ size) * Discrepancy(1.0, errors.entry_length_mm).covariance(depths)


def add_headings(track: TipTrack, heading: Floats) -> tuple[Floats, Floats]:
    """Return places (2n - 1, 2) and what takes their deflections to n tips and n - 1 headings.

    Behind the readings stand places `HEADING_STEP_MM` before them, where the headings say the tip was.
    """
    n, step = len(heading), HEADING_STEP_MM
    before = np.column_stack([track.depths - step, track.tip - step * np.tan(heading)])[1:]
    rows = [[np.eye(n), np.zeros((n, n - 1))], [np.eye(n)[1:] / step, -np.eye(n - 1) / step]]
    return np.concatenate([track.planar, before]), np.block(rows)


def list_session_axes(
    specimen: str, slope_sd: float, parts: int, direction: int = 0
) -> tuple[ErrorAxis, ...]:
    """Return the axes of what a session's runs share: slope, and the offset of headings if `parts` is 2.

    They are of a direction, y (0) or z (1). There are none where nothing is known of how much runs differ.
    """
    if not slope_sd:
        return ()
    whole = math.hypot(slope_sd, SESSION_SD_RAD)
    slope = ErrorAxis(slope_sd / whole, SESSION_SD_RAD / whole, (specimen, FRAME, 2 * direction))
    return (slope, ErrorAxis(0.0, 1.0, (specimen, FRAME, 2 * direction + 1)))[:parts]


def _without_errors(dataset: Dataset, insertion: Insertion) -> DataError:
    return DataError(
        f"the noise stated by `{dataset.name}` leaves the points of `{insertion.id}` without errors",
        where=locate_key(dataset.path, "noise.point_sd_mm"),
        expected="noise.point_sd_mm above 0",
        fix="write how well a point is known, per axis; `needlefit check` names such datasets",
    )


def _apply(operator: Floats | None, values: Floats) -> Floats:
    return values if operator is None else np.asarray(operator @ values)


def _observe_sections(
    dataset: Dataset,
    insertion: Insertion,
    known: SectionData,
    likelihood: LikelihoodRecord,
    model_error: Discrepancy | None,
) -> Observation:
    """Return the observation of an insertion by the spline through its cross-sections, of a known pose."""
    operator = block_diag(*[known.operator] * dataset.planes)
    cov = known.covariance[: len(operator), : len(operator)]
    if model_error is not None:
        misfit = block_diag(*[model_error.covariance(known.s)] * dataset.planes)
        cov = cov + operator @ misfit @ operator.T
    if dataset.planes == 2:
        measured = known.places
        # the roll turns the needle, not what sections share; the modes turn both
        quarter = operator @ np.kron(
            [[0.0, -insertion.roll_sd], [insertion.roll_sd, 0.0]], np.eye(len(measured))
        )
        cov = cov + quarter @ known.shared @ quarter.T
        modes = pose_modes_in_space(measured, known.slope)
        sds = pose_sds_in_space(insertion, dataset.noise)
    else:
        measured = known.places[:, :2]
        modes, sds = pose_modes(measured, known.slope[:, 0]), pose_sds(insertion, dataset.noise)
    pose, free = (operator @ part for part in split_pose_modes(insertion, modes, sds))
    whitening, log_norm, curves = _whiten_known(cov, pose, free, likelihood)
    varies = likelihood.bevel_spread > 0
    places = append_sensors(insertion, known.s)
    nodes = make_nodes(insertion, places, likelihood.depths, bevel=varies, constants=len(curves))
    whitening = whitening @ operator
    known_of = find_pose(dataset.pose, insertion)
    found = Observation(measured, cov, pose, free, whitening, log_norm, known_of, nodes, curves)
    return add_curvature(found, only=False)


def append_sensors(insertion: Insertion, s: Floats) -> Floats:
    """Return beam coordinates `s` (K,), mm, and behind them three about each sensor of curvature."""
    if insertion.curvature is None:
        return s
    at = insertion.depth - insertion.curvature[:, 0]
    return np.concatenate([s, (at[:, None] + SENSOR_STEP_MM * np.array([-1.0, 0.0, 1.0])).ravel()])


def require_curvature(insertion: Insertion) -> None:
    """Raise DataError where an insertion that is fitted to by curvatures alone has none."""
    if insertion.curvature is None:
        raise DataError(
            f"insertion `{insertion.id}` has no curvature",
            expected='those of every insertion fitted to (`measurement = "curvature"`)',
            fix="name their table under insertions.curvature",
        )


def add_curvature(one: Observation, only: bool) -> Observation:
    """Return an observation with the curvatures of its insertion, or of them `only`.

    A curvature is the second difference of the deflections about its sensor, over `SENSOR_STEP_MM`. In space
    those of a needle share an error of its roll, beside that of the points. The places about a sensor are
    given deflections with the measured curvature.

    Raises DataError if nothing else counts, and no curvature was measured.
    """
    known = one.insertion.curvature
    if only:
        require_curvature(one.insertion)
    if known is None:
        return one
    (_, *kappa, sd), planes, step = known.T, one.planes, SENSOR_STEP_MM
    sensors, points = len(sd), len(one.measured)
    shape = np.kron(np.ones(sensors), 0.5 * step**2 * np.array([1.0, 0.0, 1.0]))
    about = [one.nodes.s[0, points:], *(shape * np.repeat(part, 3) for part in kappa[:planes])]
    rows, whole = (0 if only else one.rows), points + 3 * sensors
    cov = np.diag(np.tile(sd**2, planes))
    if planes == 2:  # an error of the roll turns all curvatures alike
        turned = one.insertion.roll_sd * np.concatenate([-kappa[1], kappa[0]])
        cov += np.outer(turned, turned)
    root = np.linalg.cholesky(cov)
    second = np.kron(np.eye(planes * sensors), np.array([1.0, -2.0, 1.0]) / step**2)
    whitening = np.zeros((rows + planes * sensors, planes * whole))
    is_sensor = np.tile(np.arange(whole) >= points, planes)
    whitening[:rows, ~is_sensor] = one.whitening[:rows]
    whitening[rows:, is_sensor] = np.linalg.solve(root, second)
    log_norm = -float(np.sum(np.log(np.diag(root))) + 0.5 * planes * sensors * math.log(2 * math.pi))
    nothing = np.zeros(planes * sensors)
    offset = 0.0 if only or isinstance(one.offset, float) else np.concatenate([one.offset, nothing])
    curves = one.pose_curves[:, :rows]
    return replace(
        one,
        measured=np.concatenate([one.measured, np.column_stack(about)]),
        whitening=whitening,
        log_norm=log_norm + (0.0 if only else one.log_norm),
        offset=offset,
        pose_curves=np.column_stack([curves, np.zeros((len(curves), len(nothing)))]),
    )


def _whiten_known(
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
    """Return the whitened residuals (..., R) of points (..., K, 2 or 3), aligned if the pose is free."""
    if observation.pose == "free":
        simulated = align_rigid(simulated, observation.measured)
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
    """Return the derivatives (..., R, P) of `whiten_residuals`, given those of the points, (..., K, D, P)."""
    if observation.pose == "free":
        slopes = differentiate_align_rigid(simulated, observation.measured, slopes)
    if observation.planes == 1:
        return observation.whitening @ slopes[..., 1, :]
    padded = pad_planes(slopes, 2, axis=-2)
    return observation.whitening @ np.concatenate([padded[..., 1, :], padded[..., 2, :]], axis=-2)
