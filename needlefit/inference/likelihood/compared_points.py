"""Points at which a simulated and a measured needle are compared, and what lays one on the other."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import InsertionPose
from needlefit.geometry.curves import ComparedCurves, Quantity, compare_curves, select_compared
from needlefit.geometry.frames import (
    align_lateral,
    align_rigid,
    differentiate_align_lateral,
    differentiate_align_rigid,
)
from needlefit.schemas.base import Compared

Curve = Callable[[Floats], Floats]

#: fraction of the scored points, from the entry side, whose line is x in a free comparison
ENTRY_SIDE_FRACTION = 0.2


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


#: number of unknowns of a frame across the needle: a shift, or a shift and a slope
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
