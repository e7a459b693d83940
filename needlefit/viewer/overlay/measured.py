"""A measured needle as an overlay, and its distance from the simulated one."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.geometry.compare import COMPARISON_POINTS, ComparedCurves, compare_curves
from needlefit.geometry.curves import arc_length
from needlefit.geometry.frames import align_rigid
from needlefit.inference.compared_points import ComparedPoints, align_points, make_curve, select_points
from needlefit.mechanics.shape import NeedleShape, compute_positions
from needlefit.metrics import compute_metrics

DEPTH_TOLERANCE_MM = 1e-6
"""A needle this near to the measured depth, mm, has reached it."""

MIN_COMPARED_MM = 1.0
"""Shorter overlaps than this, mm, are not compared."""

_FRACTIONS = np.linspace(0.0, 1.0, COMPARISON_POINTS)


@dataclass(frozen=True)
class MeasuredOverlay:
    """A measured needle, prepared for comparison with many simulated ones.

    Attributes
    ----------
    points : (N, 2) array
        In C, entry first, mm. A shape known only up to a rigid motion lies on the needle of the parameters
        with which it was opened.
    s : (N,) array
        Where on a needle of the same depth each of the points belongs, at equal fractions of length, mm.
    target : ComparedPoints
        The points that a study compares with a needle of the measured depth.
    depth : float
        Inserted arc length, mm.
    side : int
        The side of C's x axis that the bevel faces, +1 or -1.
    floor : float or None
        TE that the true parameters would still show, mm; None where no noise is stated.
    """

    id: str
    points: Floats
    s: Floats
    target: ComparedPoints
    depth: float
    side: int
    floor: float | None


@dataclass(frozen=True)
class LiveErrors:
    """The errors of the simulated needle against the measured one; mm unless stated.

    Attributes
    ----------
    values : mapping
        By metric, as in a study where `whole`; else of the length that both have in common, counted from the
        entry, with its end as the tip. None where a metric is not defined: EDP of a straight needle.
    upto : float
        Inserted length that is compared.
    whole : bool
        Whether the needle has the measured depth, so that these are the errors of a study.
    floor : float or None
        Of TE, for the whole needle.
    """

    values: Mapping[str, float | None]
    upto: float
    whole: bool
    floor: float | None


def make_measured_overlay(
    dataset: Dataset, insertion: Insertion, floor: float, shape: NeedleShape
) -> MeasuredOverlay:
    """Return the overlay of a measured insertion.

    Parameters
    ----------
    floor : float
        TE of its noise floor, mm; NaN where there is none.
    shape : NeedleShape
        The needle on which a shape of unknown pose is laid.
    """
    aim = select_points(dataset.pose, dataset.drop_proximal, insertion)
    points, s = insertion.planar, arc_length(insertion.planar)
    s = s * (insertion.depth / s[-1])
    if dataset.pose == "free":
        points, s = aim.measured, aim.s
        if shape.converged:
            points = align_rigid(points, compute_positions(shape, s))
    stated = None if math.isnan(floor) else floor
    return MeasuredOverlay(insertion.id, points, s, aim, insertion.depth, insertion.side, stated)


def compute_live_errors(measured: MeasuredOverlay, shape: NeedleShape) -> LiveErrors | None:
    """Return the errors of a simulated needle against the measured one.

    None where that is undefined: the needle has no solution, has hardly begun, or is not as deep as a
    measured one of which only the shape is known.
    """
    upto = min(shape.depth, measured.depth)
    if not shape.converged or upto < MIN_COMPARED_MM:
        return None
    beyond = shape.depth - measured.depth
    whole = abs(beyond) <= DEPTH_TOLERANCE_MM
    if whole:
        # The depths agree only to a tolerance: positions are read from the tip, so that both tips are
        # compared.
        curve = make_curve(shape)
        errors = compare_curves(*align_points(measured.target, lambda s: curve(s + beyond)))
    elif measured.target.pose == "known":
        errors = _compare_common_length(measured, shape, upto)
    else:
        return None
    values = {name: v if math.isfinite(v) else None for name, v in compute_metrics(errors).items()}
    return LiveErrors(values, upto, whole, measured.floor)


def _compare_common_length(measured: MeasuredOverlay, shape: NeedleShape, upto: float) -> ComparedCurves:
    """Compare both needles up to the same inserted length."""
    s = upto * _FRACTIONS
    seen = np.column_stack([np.interp(s, measured.s, axis) for axis in measured.points.T])
    return compare_curves(compute_positions(shape, s), seen)
