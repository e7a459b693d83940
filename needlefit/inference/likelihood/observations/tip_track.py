"""A tip that was tracked on the way, in the frame of a tracker: known up to a shift and a slope of it.

One insertion is simulated with the guide moved as recorded. The readings are compared with its tips at their
depths, after the shift and slope that fit best. Equations: docs/inference.md, "Tip tracks".
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Dataset, Insertion, Noise, Pose, find_pose
from needlefit.datasets.noise import NoiseFloor, estimate_noise_floor
from needlefit.geometry.frames import make_tracker_columns
from needlefit.inference.likelihood.compared_points import ComparedPoints, count_entry_side
from needlefit.inference.likelihood.nodes import CARRIED, FRAME, GROUP_SLOPE, ErrorAxis, make_nodes
from needlefit.inference.likelihood.observation import Observation, whiten
from needlefit.inference.likelihood.observations import ObservationType, TrueNeedle
from needlefit.inference.likelihood.stated_errors import (
    Discrepancy,
    StatedErrors,
    no_errors_error,
    points_covariance,
)
from needlefit.mechanics.batch import Jacobians, NeedleShapes
from needlefit.mechanics.shape import NeedleShape
from needlefit.schemas.base import Compared
from needlefit.schemas.recipe import TrackErrorsRecord

#: length (mm) over which the direction of a simulated path is taken: shorter than constraints are apart
HEADING_STEP_MM = 0.25
#: prior SD of the offset of a session's headings (rad): registrations err by less
HEADING_OFFSET_SD_RAD = 0.2


DEPTH_TOLERANCE_MM = 1e-9  #: difference (mm) below which two depths are one


def extrapolate_tip(passed: Floats, tip: Floats, depth: Floats) -> Floats:
    """Return the tip (..., n) at depths (n,), mm, extrapolated from the two constraint points before each.

    `passed` (M + 1,) are the depths of the constraint points, mm, `tip` (..., M + 1) the tip as it stood at
    each. Within 0.002 mm of an insertion that stops there (tests). What stands at a constraint point where a
    guide was moved is the tip after the move, so the points before a reading count, and never the one at it.
    """
    # the last constraint point strictly before the reading, by more than rounding
    last_passed = np.maximum(np.searchsorted(passed, depth - DEPTH_TOLERANCE_MM) - 1, 0)
    before = np.maximum(last_passed - 1, 0)
    apart = np.where(last_passed > before, passed[last_passed] - passed[before], 1.0)
    return tip[..., last_passed] + (tip[..., last_passed] - tip[..., before]) * (
        (depth - passed[last_passed]) / apart
    )


@dataclass(frozen=True)
class _TipTrack(ObservationType):
    on_the_way: bool = True

    def select_points(
        self, pose: Pose, drop: float, insertion: Insertion, stations: int, compared: Compared
    ) -> ComparedPoints:
        """Return the readings, whatever `stations`, without the line through the first of them."""
        depth, *tips = insertion.points.T
        frame = make_tracker_columns(depth)
        first = frame[: count_entry_side(len(depth))]
        tip, across = (tip - frame @ np.linalg.lstsq(first, tip[: len(first)], rcond=None)[0] for tip in tips)
        measured = np.column_stack([depth, tip, across])
        return ComparedPoints(depth, measured, find_pose(pose, insertion), compared)

    def compare(self, dataset: Dataset, insertion: Insertion) -> tuple[ComparedPoints, ...]:
        """Return the readings as places, and as readings."""
        (places,) = super().compare(dataset, insertion)
        return places, replace(places, quantity="readings")

    def estimate_floor(self, dataset: Dataset, insertion: Insertion, rng: np.random.Generator) -> NoiseFloor:
        """Return the mean errors of a track that is read again, after the best shift and slope."""
        return estimate_noise_floor(
            dataset, insertion, rng, quantities=("places", "readings"), at_depths=True
        )

    def read_points(self, shape: NeedleShape, s: Floats) -> Floats:
        """Return depths and tips (K, 3) at depths `s` (K,), mm."""
        tips = shape.tip_track[:, ::2].T
        return np.column_stack([s, *(extrapolate_tip(shape.constraints[:, 0], tip, s) for tip in tips)])

    def read_batch_points(self, shapes: NeedleShapes, s: Floats) -> Floats:
        """Return `read_points` of many simulations; NaN where the solve failed."""
        points = np.full((len(shapes), len(s), 3), np.nan)
        points[..., 0] = s
        for plane, tips in enumerate(np.moveaxis(shapes.tip_track[:, :, ::2], -1, 0), start=1):
            tip = extrapolate_tip(shapes.constraints[0, :, 0], tips, s)
            points[..., plane] = np.where(shapes.converged[:, None], tip, np.nan)
        return points

    def read_batch_derivatives(self, shapes: NeedleShapes, jacobians: Jacobians, s: Floats) -> Floats:
        """Return the derivatives of `read_batch_points`."""
        derivatives = np.zeros((len(shapes), len(s), 3, len(jacobians.names)))
        for plane, track in enumerate(jacobians.tip_track, start=1):
            moved = extrapolate_tip(shapes.constraints[0, :, 0], track.transpose(0, 2, 1), s)
            derivatives[:, :, plane] = moved.transpose(0, 2, 1)
        return derivatives

    def measure(self, dataset: Dataset, insertion: Insertion, needle: TrueNeedle) -> Insertion:
        """Return the insertion with tips and headings at its depths, in the frame of a tracker."""
        depths, count = insertion.points[:, 0], len(insertion.points)
        tips, before = (
            self.read_points(needle.shape, at)[:, 1:] for at in (depths, depths - HEADING_STEP_MM)
        )
        slopes = (tips - before).T / HEADING_STEP_MM
        if needle.rng is not None:
            errors = needle.errors or StatedErrors(dataset, dataset.noise)
            read = self.observe(insertion, replace(errors, noise=dataset.noise.of(insertion)))
            off = needle.draw_errors(needle.scale**2 * read.point_covariance)
            along = read.nodes.axes[len(read.nodes.axes) - read.pose_spread.shape[1] :]
            off += read.pose_spread @ needle.draw_along(along)
            for n, part in enumerate(np.split(off, len(split_directions(insertion, dataset.directions)))):
                tips[:, n] += part[:count]
                slopes[n, 1:] += part[count:] if len(part) > count else 0.0
        headings = tuple(np.arctan(slopes[: len(insertion.headings)]))
        return replace(insertion.with_points(np.column_stack([depths, tips])), headings=headings)

    def thin(self, insertion: Insertion, count: int) -> Insertion:
        """Return the insertion with all its readings."""
        return insertion

    def observe(self, insertion: Insertion, errors: StatedErrors) -> Observation:
        """Return the observation of a track, and of its headings if their error is stated.

        What is compared are the tips and then the headings of all readings but the first, which is in no
        tissue; in space those along y before those along z.
        """
        dataset, noise, likelihood = errors.dataset, errors.noise, errors.likelihood
        if likelihood.measurement == "points":
            noise = replace(noise, heading_sd=0.0, slope_sd=0.0)
        further, directions = likelihood.tip_tracks, split_directions(insertion, dataset.directions)
        with_headings = noise.heading_sd > 0 and all(direction.headings for direction in directions)
        axes, parts = list[ErrorAxis](), list[tuple[Floats, ...]]()
        for number, direction in enumerate(directions):
            depths, measured = direction.points[:, 0], direction.points[:, :2]
            cov, operator = points_covariance(depths, noise, direction.sd), np.eye(len(depths))
            frame = make_tracker_columns(depths)
            if with_headings:
                measured, operator = add_headings(direction)
                cov = block_diag(cov, noise.heading_sd**2 * np.eye(len(operator) - len(cov)))
                turned = np.tile([0.0, 1.0, 1.0], (len(operator) - len(frame), 1))
                frame = np.concatenate([np.column_stack([frame, np.zeros(len(frame))]), turned])
            depths_of_readings = measured[:, 0]
            # along the depth; what they do to a heading is their slope there
            added = entry_covariance(direction, depths_of_readings, further)
            added = (
                added
                if errors.model_error is None
                else added + errors.model_error.covariance(depths_of_readings)
            )
            cov = cov + operator @ added @ operator.T
            if likelihood.noise == "independent":
                cov = np.diag(np.diag(cov))
            run_axes = list_session_axes(insertion.specimen, noise, frame.shape[1] - 1, number)
            free = frame[:, : frame.shape[1] - len(run_axes)]
            sds = [noise.whole_slope_sd, HEADING_OFFSET_SD_RAD]
            session = frame[:, free.shape[1] :] * sds[: len(run_axes)]
            if run_axes and further.slope_sd_deg:
                run_axes = (*run_axes, make_group_slope(insertion, number))
                session = np.column_stack([session, math.radians(further.slope_sd_deg) * frame[:, 1]])
            axes += run_axes
            parts.append((measured[:, 1], operator, cov, free, session))
        across, *blocks = zip(*parts, strict=True)
        operator, cov, free, session = (block_diag(*block) for block in blocks)
        try:
            whitening, log_norm = whiten(cov, free)
        except np.linalg.LinAlgError:
            raise no_errors_error(dataset, insertion) from None
        if further.gain_sd and insertion.guided:
            assert errors.respond is not None
            moves = errors.respond(insertion, depths_of_readings)[..., 1 : 1 + len(directions)]  # (M, K, D)
            moves = operator @ block_diag(*moves.transpose(2, 1, 0))  # gains of y and z differ
            axes += [ErrorAxis()] * moves.shape[1]
            session = np.column_stack([session, further.gain_sd * moves])
            if further.carried_sd:  # tissue that follows moves the tip, and is moved less against the needle
                followed = operator @ np.concatenate(
                    [follow_guide(direction, depths_of_readings) for direction in directions]
                )
                axes.append(ErrorAxis(0.0, 1.0, (insertion.specimen, CARRIED, insertion.setup)))
                session = np.column_stack([session, further.carried_sd * (followed - moves.sum(axis=1))])
        curves = (whitening @ session).T
        roll_sd_deg = further.roll_sd_deg * (len(directions) - 1)
        nodes = make_nodes(
            insertion, depths_of_readings, "fixed", bevel=errors.bevels_vary, constants=len(curves),
            along=tuple(axes), roll_sd_deg=roll_sd_deg,
        )  # fmt: skip
        measured, whitening = np.column_stack([depths_of_readings, *across]), whitening @ operator
        pose = find_pose(dataset.pose, insertion)
        return Observation(measured, cov, session, free, whitening, log_norm, pose, nodes, curves)


def make_group_slope(track: Insertion, direction: int = 0) -> ErrorAxis:
    """Return the axis of the slope along y (0) or z (1) of the runs into one medium, steered or at rest."""
    group = f"{track.medium}, {'steered' if track.guided else 'at rest'}{', along z' * direction}"
    return ErrorAxis(0.0, 1.0, (track.specimen, GROUP_SLOPE, group))


def follow_guide(track: Insertion, depths: Floats) -> Floats:
    """Return how far the guide has moved on the way to each of the depths (K,) of the tip, mm."""
    assert track.guide is not None
    reading = np.searchsorted(track.guide.depths, depths - DEPTH_TOLERANCE_MM)
    return np.asarray(track.guide.y[np.minimum(reading, len(track.guide.y) - 1)] - track.guide.y[0])


def entry_covariance(track: Insertion, depths: Floats, errors: TrackErrorsRecord) -> Floats:
    """Return the covariance (K, K), mm^2, of errors by a yielding entry, at `depths` (K,) of the tip.

    The tip is then off by an unknown length, and by an unknown part of how far the guide has moved. Both fade
    with depth, over the same length over which they vary.
    """
    assert track.guide is not None
    moved = np.interp(depths, track.guide.depths, track.guide.y - track.guide.y[0])
    fading = np.exp(-depths / errors.entry_length_mm)
    size = np.array([np.full(len(depths), errors.entry_sd_mm), errors.entry_yield * moved]) * fading
    return (size.T @ size) * Discrepancy(1.0, errors.entry_length_mm).covariance(depths)


def add_headings(track: Insertion) -> tuple[Floats, Floats]:
    """Return places (2n - 1, 2) and what takes their deflections to n tips and n - 1 headings.

    Behind the readings stand places `HEADING_STEP_MM` before them, where the headings say the tip was.
    """
    heading, step = track.headings[0], HEADING_STEP_MM
    n = len(heading)
    before = (track.points[:, :2] - step * np.column_stack([np.ones(n), np.tan(heading)]))[1:]
    rows = [[np.eye(n), np.zeros((n, n - 1))], [np.eye(n)[1:] / step, -np.eye(n - 1) / step]]
    return np.concatenate([track.points[:, :2], before]), np.block(rows)


def list_session_axes(specimen: str, noise: Noise, parts: int, direction: int = 0) -> tuple[ErrorAxis, ...]:
    """Return the axes of what a session's runs share: slope, and the offset of headings if `parts` is 2.

    They are of a direction, y (0) or z (1). There are none where nothing is known of how much runs differ.
    """
    if not noise.slope_sd:
        return ()
    own, shared = np.divide([noise.slope_sd, noise.session_slope_sd], noise.whole_slope_sd).tolist()
    slope = ErrorAxis(own, shared, (specimen, FRAME, 2 * direction))
    return (slope, ErrorAxis(0.0, 1.0, (specimen, FRAME, 2 * direction + 1)))[:parts]


def split_directions(track: Insertion, count: int) -> tuple[Insertion, ...]:
    """Return what was read along y, and, in place of that, what was along z: as many as are compared."""
    assert track.guide is not None
    along_z = replace(
        track,
        points=track.points[:, [0, 2, 1]],
        guide=replace(track.guide, y=track.guide.z),
        headings=track.headings[1:],
        directions=1,
    )
    return (track, along_z)[: min(count, track.directions)]


TIP_TRACK = _TipTrack("tip_track")
