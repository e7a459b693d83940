"""Overlays of the simulated needle: a measured needle, and the draws of the band of a fit."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from needlefit.arrays import Floats
from needlefit.geometry.frames import align_rigid
from needlefit.mechanics.shape import NeedleShape, compute_positions

if TYPE_CHECKING:
    from needlefit.datasets.insertion import Dataset, Insertion
    from needlefit.inference.compared_points import ComparedPoints

# What takes long to import, or only measured insertions need, is imported where it is used.


@dataclass(frozen=True)
class MeasuredOverlay:
    """A measured needle, prepared for comparison with many simulated ones."""

    id: str
    #: (N, 3) in C, entry first, mm. A shape known only up to a rigid motion, or a shift across, lies on the
    #: needle of the parameters with which it was opened.
    points: Floats
    #: (N,) Where on a needle of the same depth each of the points belongs, at equal fractions of length, mm
    s: Floats
    target: "ComparedPoints"  #: the points that a study compares with a needle of the measured depth
    depth: float  #: inserted arc length, mm
    floor: float | None  #: TE that the true parameters would still show, mm; None where no noise is stated
    #: the prediction of a run that has held it out: x, y, mm, and its errors
    prediction: Mapping[str, Any] | None = None


def make_measured_overlay(
    dataset: "Dataset", insertion: "Insertion", floor: float, shape: NeedleShape
) -> MeasuredOverlay:
    """Return the overlay of a measured insertion.

    `floor` is the TE of its noise floor, mm, in space where the dataset's needles are compared there; NaN
    where there is none. A shape whose pose, or the place of whose entry, is unknown is laid on `shape`.
    """
    from needlefit.inference.compared_points import align
    from needlefit.inference.likelihood.observations import select_points

    aim = select_points(dataset.pose, dataset.drop_proximal, insertion, compared=dataset.compared)
    points, s = insertion.points, insertion.measure_arc(dataset.compared)
    s = s * (insertion.depth / s[-1])
    if dataset.pose == "free":
        points, s = aim.measured.copy(), aim.s
        if shape.converged:
            points[:, :2] = align_rigid(points[:, :2], compute_positions(shape, s)[:, :2])
    elif aim.pose == "direction" and shape.converged:
        points = align(aim.pose, points, compute_positions(shape, s))
    stated = None if math.isnan(floor) else floor
    return MeasuredOverlay(insertion.id, points, s, aim, insertion.depth, stated)
