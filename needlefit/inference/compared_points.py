"""Choose the points at which a simulated and a measured needle are compared, and read them off a simulation.

Pose known: both curves lie in C and are sampled at equal fractions of their own inserted arc length.

Direction known (the entry is the first point of the inserted needle, which has moved with it): the same,
after the shift across that brings the simulated points closest to the measured ones.

Pose free (shapes known only up to a rigid motion): both are sampled at the same arc lengths from the tip,
over [0, min(measured length, D) - drop], entry side first. The simulated points are then laid on the measured
ones by the rigid motion that fits them best. Both are shown in the axes of the measured entry side: x along
the least-squares line through the first fifth of the scored points, from which deflections are measured.

Tip tracks (known up to a shift and a slope of the tracker's frame): one insertion is simulated with the guide
moved as recorded. The readings are compared with its tips at their depths, after the shift and slope that fit
best; the line through the first fifth of the readings is taken from both.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion, InsertionPose, Pose, TipTrack, find_free_reach, find_pose
from needlefit.errors import DataError
from needlefit.geometry.curves import COMPARISON_POINTS
from needlefit.geometry.frames import (
    align_lateral,
    align_rigid,
    differentiate_align_lateral,
    differentiate_align_rigid,
    make_tracker_columns,
)
from needlefit.mechanics.batch import (
    Jacobians,
    NeedleShapes,
    compute_batch_positions,
    differentiate_batch_positions,
)
from needlefit.mechanics.shape import NeedleShape, compute_positions

DEPTH_TOLERANCE_MM = 1e-9  #: mm; depths closer than this are one
#: constraint points that a moved guide must have between two readings: they tell where the tip stood
MIN_CONSTRAINT_POINTS = 2


def read_points(insertion: Insertion | None, shape: NeedleShape, s: Floats) -> Floats:
    """Return the simulated points (K, 2), in space (K, 3), of an insertion, mm; NaN where the solve failed.

    `s` (K,), mm, are beam coordinates; of a tip track the depths of the readings.
    """
    if not shape.converged:
        return np.full((len(s), 2 if shape.w is None else 3), np.nan)
    if isinstance(insertion, TipTrack):
        tips = shape.tip_track[:, ::2].T
        return np.column_stack([s, *(extrapolate_tip(shape.constraints[:, 0], one, s) for one in tips)])
    return compute_positions(shape, s)


def read_batch_points(insertion: Insertion, shapes: NeedleShapes, s: Floats) -> Floats:
    """Return `read_points` (B, K, 2), in space (B, K, 3), of many simulations of one insertion."""
    if not isinstance(insertion, TipTrack):
        return compute_batch_positions(shapes, s)
    found = np.full((len(shapes), len(s), shapes.constraints.shape[2]), np.nan)
    found[..., 0] = s
    for plane, tips in enumerate(np.moveaxis(shapes.tip_track[:, :, ::2], -1, 0), start=1):
        tip = extrapolate_tip(shapes.constraints[0, :, 0], tips, s)
        found[..., plane] = np.where(shapes.converged[:, None], tip, np.nan)
    return found


def read_batch_derivatives(
    insertion: Insertion, shapes: NeedleShapes, jacobians: Jacobians, s: Floats
) -> Floats:
    """Return the derivatives (B, K, 2, P), in space (B, K, 3, P), of `read_batch_points`."""
    if not isinstance(insertion, TipTrack):
        return differentiate_batch_positions(shapes, jacobians, s)
    found = np.zeros((len(shapes), len(s), shapes.constraints.shape[2], len(jacobians.names)))
    tracks = jacobians.tip_track.reshape(-1, len(shapes), *jacobians.tip_track.shape[-2:])
    for plane, track in enumerate(tracks, start=1):
        moved = extrapolate_tip(shapes.constraints[0, :, 0], track.transpose(0, 2, 1), s)
        found[:, :, plane] = moved.transpose(0, 2, 1)
    return found


def extrapolate_tip(passed: Floats, tip: Floats, depth: Floats) -> Floats:
    """Return the tip (..., n) at depths (n,), mm, extrapolated from the two constraint points before each.

    `passed` (M + 1,) are the depths of the constraint points, mm, `tip` (..., M + 1) the tip as it stood at
    each. Within 0.002 mm of an insertion that stops there (tests). What stands at a constraint point where a
    guide was moved is the tip after the move, so the points before a reading count, and never the one at it.
    """
    # the last constraint point strictly before the reading, by more than rounding
    at = np.maximum(np.searchsorted(passed, depth - DEPTH_TOLERANCE_MM) - 1, 0)
    before = np.maximum(at - 1, 0)
    apart = np.where(at > before, passed[at] - passed[before], 1.0)
    return tip[..., at] + (tip[..., at] - tip[..., before]) * ((depth - passed[at]) / apart)


def find_end(track: TipTrack, spacing: float) -> float:
    """Return how deep a run is simulated, mm: to the constraint point at or beyond its last reading.

    Constraint points lie at whole multiples of their spacing, whatever the depths of the readings.
    """
    # the tolerance keeps rounding from adding one
    return spacing * math.ceil(track.depth / spacing - DEPTH_TOLERANCE_MM)


def share_simulations(insertions: Sequence[Insertion], spacing: float) -> tuple[Insertion, ...]:
    """Return of each insertion the one whose simulation it is read from.

    Runs of one needle into the same layers under a guide at rest are one insertion, the deepest, that is read
    at different depths.
    Everything else is simulated for itself.

    Raises DataError if a moved guide's readings are too close: the tip is known at constraint points only.
    """
    deepest: dict[tuple[object, ...], TipTrack] = {}
    keys = []
    for one in insertions:
        key = None
        if isinstance(one, TipTrack) and not (one.guided or any(depth for depth, _ in one.turns)):
            layers = one.sequence, tuple(one.boundaries.tolist())
            key = one.needle, one.side, one.turns, one.bevel_factor, layers
            if one.depth > deepest.setdefault(key, one).depth:
                deepest[key] = one
        elif isinstance(one, TipTrack):
            nearest, least = float(np.diff(one.depths).min()), MIN_CONSTRAINT_POINTS * spacing
            if nearest < least:
                raise DataError(
                    f"run {one.id} has readings {nearest:.3g} mm apart while guide or bevel moves",
                    expected=f"{least:g} mm or more, {MIN_CONSTRAINT_POINTS} times the model's constraint "
                    "spacing",
                    fix="leave readings out, or lessen constraint_spacing_mm of the medium (b is then "
                    "another)",
                )
        keys.append(key)
    return tuple(one if key is None else deepest[key] for one, key in zip(insertions, keys, strict=True))


def pad_planes(points: Floats, planes: int, axis: int = -1) -> Floats:
    """Return points in as many planes, of which those that bend in one alone lie at z = 0.

    `axis` has the coordinates, two or three.
    """
    missing = 1 + planes - points.shape[axis]
    if missing <= 0:
        return points
    shape = [*points.shape]
    shape[axis] = missing
    return np.concatenate([points, np.zeros(shape)], axis=axis)


def turn_about_x(points: Floats, angle: Floats | float) -> Floats:
    """Return points (..., K, 3) turned about C's x axis by angles (...,), rad."""
    cos, sin = (np.asarray(part)[..., None] for part in (np.cos(angle), np.sin(angle)))
    x, y, z = np.moveaxis(points, -1, 0)
    return np.stack([x, cos * y - sin * z, sin * y + cos * z], axis=-1)


Curve = Callable[[Floats], Floats]

#: part of the scored points, from the entry side, whose line is x in a free comparison
ENTRY_SIDE_FRACTION = 0.2


@dataclass(frozen=True)
class SimulatedCurve:
    """A simulated insertion as a function: beam coordinates (K,) -> points (K, 2) in C.

    Of a tip track: depths of the readings -> depths and tips; see `read_points`.
    """

    shape: NeedleShape
    insertion: Insertion | None = None

    def __call__(self, s: Floats) -> Floats:
        """Return the points at `s` (K,)."""
        return read_points(self.insertion, self.shape, s)


@dataclass(frozen=True)
class ComparedPoints:
    """The measured points of one comparison, and where the simulated ones are taken."""

    s: Floats  #: (K,) where on the beam the simulated points are taken, mm from the entry
    measured: Floats  #: (K, 2) measured points, entry side first, tip last, mm
    pose: InsertionPose
    out_of_plane: Floats  #: (K,) their z, mm

    @property
    def in_space(self) -> Floats:
        """The measured points in space, (K, 3) mm."""
        return np.column_stack([self.measured, self.out_of_plane])

    def measured_in(self, planes: int) -> Floats:
        """Return the measured points in one plane, (K, 2) mm, or in two, (K, 3)."""
        return self.measured if planes == 1 else self.in_space


def select_points(
    pose: Pose, drop: float, insertion: Insertion, stations: int = COMPARISON_POINTS, planes: int = 1
) -> ComparedPoints:
    """Return the measured points that a curve is compared with, entry side first, tip last.

    `drop` is the proximal length left out where the pose is free, mm. Of a tip track the points are its
    readings, whatever `stations`.
    """
    if isinstance(insertion, TipTrack):
        depth, *tips = *insertion.planar.T, insertion.out_of_plane
        frame = make_tracker_columns(depth)
        first = frame[: _count_entry_side(len(depth))]
        tip, across = (one - frame @ np.linalg.lstsq(first, one[: len(first)], rcond=None)[0] for one in tips)
        return ComparedPoints(depth, np.column_stack([depth, tip]), pose, across)
    along = insertion.measure_arc(planes)
    if pose == "known":
        fractions = np.linspace(0.0, 1.0, stations)
        s, at = insertion.depth * fractions, fractions * along[-1]
    else:
        to_tip = np.linspace(find_free_reach(drop, insertion), 0.0, stations)
        s, at = insertion.depth - to_tip, float(along[-1]) - to_tip
    measured = np.column_stack([np.interp(at, along, axis) for axis in insertion.planar.T])
    measured = measured if pose == "known" else rotate_to_entry_axes(measured)
    z = np.interp(at, along, insertion.out_of_plane)
    return ComparedPoints(s, measured, find_pose(pose, insertion), z)


def align_points(target: ComparedPoints, curve: Curve) -> tuple[Floats, Floats]:
    """Return the simulated and the measured points (K, 3), aligned in the plane where the pose is unknown."""
    simulated = pad_planes(curve(target.s), 2)
    if target.pose != "free":
        return align(target.pose, simulated, target.in_space), target.in_space
    planar = align(target.pose, simulated[:, :2], target.measured)
    return np.column_stack([planar, simulated[:, 2]]), target.in_space


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
    first = points[: _count_entry_side(len(points))]
    centred = first - first.mean(axis=0)
    # the first right singular vector is the least-squares line; its sign is arbitrary
    direction = np.linalg.svd(centred, full_matrices=False)[2][0]
    direction = direction if direction @ (first[-1] - first[0]) >= 0 else -direction
    to_axes = np.array([[direction[0], -direction[1]], [direction[1], direction[0]]])
    return (points - points[0]) @ to_axes


def _count_entry_side(count: int) -> int:
    """Return how many of `count` points, from the entry side, give the line that is x."""
    return max(2, round(ENTRY_SIDE_FRACTION * count))
