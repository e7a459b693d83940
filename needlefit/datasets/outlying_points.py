"""Compare points with the smooth curves of their own needles: single ones, and all along an axis."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion, Noise
from needlefit.datasets.layers import ListedInsertion
from needlefit.datasets.points import find_rounding
from needlefit.geometry.neighbours import leave_one_out
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.unit_warnings import LENGTH_UNITS

OUTLIER_SD = 5.0  # standard deviations beyond which a point or needle is named
MEDIAN_TO_SD = 0.6745  # median size of a normal variable of unit standard deviation
MIN_SCATTER_MM = 0.01  # SD of points that is always allowed for
MIN_CURVE_POINTS = 6  # of fewer points none has enough neighbours
MAX_OUTLYING_PART = 0.2  # of a curve's points; if more are off, the curve is rough
MIN_AXIS_PART = 0.9  # of a displacement along one axis, from which this coordinate is named
MIN_AXIS_POINTS = 20  # of fewer points the scatter along an axis is not known
# Scatter along an axis over the stated one: from which it is in another unit, up to which it is as stated.
MIN_UNIT_RATIO, MAX_STATED_RATIO = 4.0, 2.0


@dataclass(frozen=True)
class OutlyingPoint:
    """A point that lies off the smooth curve through its neighbours."""

    index: int  # of the point, from the entry
    distance: float  # from the curve, mm
    sds: float  # the same in standard deviations
    measured: Floats  # (3,); world, mm
    expected: Floats  # (3,); where the curve is, world, mm


OutlyingPoints = Mapping[str, Sequence[OutlyingPoint]]  # by the id of their insertion, the worst first


def measure_roughness(insertion: Insertion, noise: Noise, rounding: float) -> tuple[Floats, Floats]:
    """Return how far points are from the curve through their neighbours (N, 2), mm, and the SD of it (N,).

    Errors of `rounding`, mm, are no smaller than its half.
    """
    values = np.column_stack([insertion.planar[:, 1], insertion.out_of_plane])
    left, factor = leave_one_out(insertion.planar[:, 0], values)
    own = 0.0 if insertion.sd is None else insertion.sd
    shared = noise.point_sd**2 + noise.correlated_sd**2 + (rounding / 2) ** 2 + MIN_SCATTER_MM**2
    return left, factor * np.sqrt(shared + np.square(own))


def find_outlying_points(listed: Sequence[ListedInsertion], noise: Noise) -> OutlyingPoints:
    """Return the outlying points of each insertion that has any, by its id.

    Points may scatter as stated, as they are rounded, or as all points of all needles scatter (the median of
    their sizes).
    """
    curves = [one.insertion for one in listed if len(one.insertion.planar) >= MIN_CURVE_POINTS]
    if not curves:
        return {}
    rounding = find_rounding([one.points.values for one in listed])
    measured = [measure_roughness(one, noise, rounding) for one in curves]
    sizes = np.vstack([np.abs(left) / sd[:, None] for left, sd in measured])
    larger = max(1.0, float(np.median(sizes)) / MEDIAN_TO_SD)
    found = {one.id: _find_in_curve(one, noise, rounding, larger) for one in curves}
    return {name: points for name, points in found.items() if points}


def _find_in_curve(insertion: Insertion, noise: Noise, rounding: float, larger: float) -> list[OutlyingPoint]:
    """Return the outlying points of one curve, the worst first: without each the next is sought."""
    kept, found = np.arange(len(insertion.planar)), list[OutlyingPoint]()
    while len(kept) >= MIN_CURVE_POINTS:
        rest = _select_points(insertion, kept)
        left, sd = measure_roughness(rest, noise, rounding)
        ratio = np.abs(left).max(axis=1) / (larger * sd)
        worst = int(np.argmax(ratio))
        if ratio[worst] <= OUTLIER_SD:
            return found
        index = int(kept[worst])
        expected = insertion.centerline[index] - insertion.frame.rotation[:, 1:] @ left[worst]
        off = float(np.linalg.norm(left[worst]))
        measured = insertion.centerline[index]
        found.append(OutlyingPoint(index, off, float(ratio[worst]), measured, expected))
        if len(found) > MAX_OUTLYING_PART * len(insertion.planar):
            return []
        kept = np.delete(kept, worst)
    return found


def _select_points(insertion: Insertion, kept: NDArray[np.int64]) -> Insertion:
    """Return the insertion with the points of these indices alone."""
    return replace(
        insertion,
        planar=insertion.planar[kept],
        out_of_plane=insertion.out_of_plane[kept],
        centerline=insertion.centerline[kept],
        sd=None if insertion.sd is None else insertion.sd[kept],
    )


def drop_outlying_points(listed: ListedInsertion, found: OutlyingPoints) -> ListedInsertion:
    """Return the insertion without its outlying points."""
    if not (off := [point.index for point in found.get(listed.insertion.id, ())]):
        return listed
    kept = np.delete(np.arange(len(listed.insertion.planar)), off)
    return replace(listed, insertion=_select_points(listed.insertion, kept))


def find_point_warnings(listed: Sequence[ListedInsertion], found: OutlyingPoints) -> Iterator[ResultWarning]:
    """Yield a warning for each outlying point, with its row and the coordinate that fits."""
    for one in listed:
        last = len(one.insertion.planar) - 1
        for point in found.get(one.insertion.id, ()):
            name = {0: "the first point", last: "the tip"}.get(point.index, f"point {point.index + 1}")
            what = f"{name} of {one.insertion.id} is {point.distance:.2g} mm off the curve of the others"
            what += f" ({point.sds:.0f} SD){_name_cause(point)}"
            fix = "correct it, or remove the row"
            yield ResultWarning("point_outlier", what, one.points.where(point.index), fix)


def _name_cause(point: OutlyingPoint) -> str:
    """Return which coordinate is off, and what it looks like."""
    away = np.abs(point.measured - point.expected)
    axis = int(np.argmax(away))
    if away[axis] < MIN_AXIS_PART * point.distance:
        return ""
    name, value, fits = "xyz"[axis], point.measured[axis], point.expected[axis]
    text = f": {name} is {value:g}, where {fits:.2f} fits"
    if value == 0:
        return f"{text}, like an empty cell read as 0"
    return f"{text}, like a changed sign" if abs(value + fits) < away[axis] / 4 else text


# ---- one axis in another unit


def measure_axis_scatter(listed: Sequence[ListedInsertion]) -> Floats:
    """Return the SD (3,) of points about their curves along each axis of the world, mm; NaN where none shows.

    An axis shows it across needles, and unless no coordinate of it differs.
    """
    sizes: list[list[Floats]] = [[], [], []]
    for one in (each.insertion for each in listed):
        if len(one.planar) < MIN_CURVE_POINTS:
            continue
        values = np.column_stack([one.planar[:, 1], one.out_of_plane])
        left, factor = leave_one_out(one.planar[:, 0], values)
        across = one.frame.rotation[:, 1:]  # (3, 2)
        for axis in np.flatnonzero(np.linalg.norm(across, axis=1) > MIN_AXIS_PART):
            if np.ptp(one.centerline[:, axis]) > 0:
                sizes[axis].append(np.abs(left @ across[axis]) / factor)
    joined = [np.concatenate(some) if some else np.empty(0) for some in sizes]
    return np.array(
        [float(np.median(some)) / MEDIAN_TO_SD if len(some) >= MIN_AXIS_POINTS else np.nan for some in joined]
    )


def find_constant_warnings(listed: Sequence[ListedInsertion], noise: Noise) -> Iterator[ResultWarning]:
    """Yield a warning for each needle with one value in a coordinate that varies along most others.

    Coordinates that are rounded by more than their noise may well be equal.
    """
    points = [one.points.values for one in listed if len(one.points.values) >= MIN_CURVE_POINTS]
    if not points or find_rounding(points) > max(noise.point_sd, noise.correlated_sd):
        return
    varies = np.mean([np.ptp(one, axis=0) > 0 for one in points], axis=0) > 0.5  # (3,)
    for one in listed:
        still = varies & (np.ptp(one.points.values, axis=0) == 0)
        if still.any() and len(one.points.values) >= MIN_CURVE_POINTS:
            axis = int(np.argmax(still))
            name, value = "xyz"[axis], one.points.values[0, axis]
            what = f"{one.insertion.id}: {name} is {value:g} at all points, where that of the others varies"
            fix = f"export its points again: an empty column may have been saved as {value:g}"
            yield ResultWarning("needle_outlier", what, one.points.where(), fix)


def find_axis_warnings(listed: Sequence[ListedInsertion], noise: Noise) -> Iterator[ResultWarning]:
    """Yield a warning if points scatter along one axis as in another unit, and along the others as stated."""
    stated = math.hypot(noise.point_sd, noise.correlated_sd)
    if not listed or stated == 0:
        return
    rounding = find_rounding([one.points.values for one in listed])
    ratios = np.maximum(measure_axis_scatter(listed), rounding / 2) / stated
    odd = np.flatnonzero((ratios < 1 / MIN_UNIT_RATIO) | (ratios > MIN_UNIT_RATIO))
    right = (ratios > 1 / MAX_STATED_RATIO) & (ratios < MAX_STATED_RATIO)
    if len(odd) != 1 or not right.any():
        return
    (axis,) = odd
    name, factor = "xyz"[axis], float(np.mean(ratios[right]) / ratios[axis])
    units = {unit: abs(math.log(factor / scale)) for unit, scale in LENGTH_UNITS.items()}
    unit = min(units, key=lambda one: units[one])
    looks = f": this looks like {unit}" if units[unit] < math.log(2) else ""
    what = f"points scatter by {ratios[axis] * stated:.2g} mm along {name}, and by "
    what += f"{float(np.mean(ratios[right])) * stated:.2g} mm along the other axes, as stated{looks}"
    fix = f"check the unit of {name}: of the points alone it is {1 / factor:.2g} times too large"
    yield ResultWarning("axis_unit", what, listed[0].points.where(), fix)
