"""Choose the points at which a simulated and a measured needle are compared.

Pose known: both curves lie in C and are sampled at equal fractions of their own inserted arc length.

Pose free (shapes known only up to a rigid motion): both are sampled at the same arc lengths from the
tip, over [0, min(measured length, D) - drop], entry side first. The simulated points are then laid on
the measured ones by the rigid motion that fits them best, so the errors are those `aligned`. Both are
shown in the axes of the measured entry side: x along the least-squares line through the first fifth of
the scored points, from the first of them. Errors do not depend on that choice; the deflection does, by
which EDP divides: it is the tip's distance from the continuation of that line.

Tip tracks (known up to a shift and a slope of the tracker's frame): the readings are compared with the tips
simulated at their depths, after the shift and slope that fit best; the line through the first fifth of the
readings is taken from both.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion, Pose, find_free_reach
from needlefit.datasets.tip_tracks import TipTrack
from needlefit.geometry.compare import COMPARISON_POINTS
from needlefit.geometry.curves import arc_length, interpolate_at_arc, resample_curve
from needlefit.geometry.frames import (
    align_lateral,
    align_rigid,
    differentiate_align_lateral,
    differentiate_align_rigid,
    make_tracker_columns,
)
from needlefit.inference.simulated_points import read_points
from needlefit.mechanics.shape import NeedleShape

Curve = Callable[[Floats], Floats]

ENTRY_SIDE_FRACTION = 0.2
"""Part of the scored points, from the entry side, whose line is x in a free comparison."""


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


def make_curve(shape: NeedleShape, insertion: Insertion | None = None) -> SimulatedCurve:
    """Return a simulated insertion as a function of the beam coordinate; by default its shape."""
    return SimulatedCurve(shape, insertion)


@dataclass(frozen=True)
class ComparedPoints:
    """The measured points of one comparison, and where the simulated ones are taken.

    Attributes
    ----------
    s : (K,) array
        Where on the beam the simulated points are taken, mm from the entry.
    measured : (K, 2) array
        Measured points, entry side first, tip last, mm.
    pose : "known", "free" or "tracker"
    """

    s: Floats
    measured: Floats
    pose: Pose


def select_points(
    pose: Pose, drop: float, insertion: Insertion, stations: int = COMPARISON_POINTS
) -> ComparedPoints:
    """Return the measured points that a curve is compared with; see `compare_points`.

    Of a tip track they are its readings, whatever `stations`.
    """
    if isinstance(insertion, TipTrack):
        depth, tip = insertion.planar.T
        frame = make_tracker_columns(depth)
        first = frame[: _count_entry_side(len(depth))]
        line = frame @ np.linalg.lstsq(first, tip[: len(first)], rcond=None)[0]
        return ComparedPoints(depth, np.column_stack([depth, tip - line]), pose)
    if pose == "known":
        fractions = np.linspace(0.0, 1.0, stations)
        return ComparedPoints(insertion.depth * fractions, resample_curve(insertion.planar, fractions), pose)
    to_tip = np.linspace(find_free_reach(drop, insertion), 0.0, stations)
    length = float(arc_length(insertion.planar)[-1])
    measured = rotate_to_entry_axes(interpolate_at_arc(insertion.planar, length - to_tip))
    return ComparedPoints(insertion.depth - to_tip, measured, pose)


def align_points(target: ComparedPoints, curve: Curve) -> tuple[Floats, Floats]:
    """Return the simulated and the measured points (K, 2), aligned where the pose is unknown."""
    return align(target.pose, curve(target.s), target.measured), target.measured


def align(pose: Pose, simulated: Floats, measured: Floats) -> Floats:
    """Return simulated points (..., K, 2) as the pose allows them to lie beside the measured ones (K, 2)."""
    if pose == "free":
        return align_rigid(simulated, measured)
    return align_lateral(simulated, measured) if pose == "tracker" else simulated


def differentiate_align(pose: Pose, simulated: Floats, measured: Floats, slopes: Floats) -> Floats:
    """Return the derivatives (..., K, 2, P) of `align`, given those of the simulated points (..., K, 2)."""
    if pose == "free":
        return differentiate_align_rigid(simulated, measured, slopes)
    return differentiate_align_lateral(measured, slopes) if pose == "tracker" else slopes


def compare_points(
    pose: Pose, drop: float, insertion: Insertion, curve: Curve, stations: int = COMPARISON_POINTS
) -> tuple[Floats, Floats]:
    """Return the simulated and the measured points (K, 2) that are compared, entry side first, tip last.

    Parameters
    ----------
    pose : "known", "free" or "tracker"
    drop : float
        Proximal length left out where the pose is free, mm.
    curve : callable
        Beam coordinates (K,), 0 at the entry and `insertion.depth` at the tip -> points (K, 2) in C, mm.
    stations : int
        K.
    """
    return align_points(select_points(pose, drop, insertion, stations), curve)


def rotate_to_entry_axes(points: Floats) -> Floats:
    """Return points (K, 2) relative to the first one, with x along the line through their entry side."""
    first = points[: _count_entry_side(len(points))]
    centred = first - first.mean(axis=0)
    # the first right singular vector is the least-squares line; its sign is arbitrary
    direction = np.linalg.svd(centred, full_matrices=False)[2][0]
    direction = direction if direction @ (first[-1] - first[0]) >= 0 else -direction
    to_axes = np.array([[direction[0], -direction[1]], [direction[1], direction[0]]])
    turned: Floats = (points - points[0]) @ to_axes
    return turned


def _count_entry_side(count: int) -> int:
    """Return how many of `count` points, from the entry side, give the line that is x."""
    return max(2, round(ENTRY_SIDE_FRACTION * count))
