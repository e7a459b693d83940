"""Compare points with the smooth curves of their own needles: single ones, steps, and all along an axis."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats
from needlefit.datasets.comparison import MIN_OTHERS, OUTLIER_SD, compare, design_lengths
from needlefit.datasets.insertion import Insertion, Noise
from needlefit.datasets.layers import ListedInsertion
from needlefit.datasets.points import find_rounding
from needlefit.geometry.neighbours import find_steps, leave_last_out, leave_one_out
from needlefit.grouping import group_values
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.unit_warnings import LENGTH_UNITS

MEDIAN_TO_SD = 0.6745  # median size of a normal variable of unit standard deviation
MIN_SCATTER_MM = 0.01  # SD of points that is always allowed for
MIN_CURVE_POINTS = 6  # of fewer points none has enough neighbours
MAX_OUTLYING_PART = 0.2  # of a curve's points; if more are off, the curve is rough
# By how much ends of sound needles differ from a parabola.
NATURAL_END_MM = 0.02  # SD, mm
NATURAL_END_PART = 0.01  # SD, per mm of their bend
MAX_END_CHANCE = 1e-5  # of a deviation of a sound end: there are few, so this is 4.4 SD
MIN_EVEN_PART = 0.8  # of the steps between points that are alike, where these are evenly spaced
MIN_AXIS_PART = 0.9  # of a displacement along one axis, from which this coordinate is named
STEP_AXIS_PART = 0.3  # of a step along an axis, from which this is named
MIN_AXIS_POINTS = 20  # of fewer points the scatter along an axis is not known
# Scatter along an axis over the stated one.
MIN_UNIT_RATIO = 4.0  # from which it is in another unit
MAX_STATED_RATIO = 2.0  # up to which it is as stated


@dataclass(frozen=True)
class OutlyingPoint:
    """A point that lies off the smooth curve through its neighbours, or the first one behind a step."""

    index: int  # of the point, from the entry
    distance: float  # from the curve, mm
    sds: float  # the same in standard deviations
    measured: Floats  # (3,); world, mm
    expected: Floats  # (3,); where the curve is, world, mm
    is_step: bool = False  # whether all later points are off by as much


OutlyingPoints = Mapping[str, Sequence[OutlyingPoint]]  # by the id of their insertion, the worst first


@dataclass(frozen=True)
class Scatter:
    """The errors that points may have, as they are stated, rounded and measured."""

    noise: Noise
    rounding: float  # step of their coordinates, mm
    larger: float = 1.0  # factor by which all points scatter more

    def sd_of(self, insertion: Insertion) -> Floats:
        """Return the standard deviation of each point (N,), mm; that of rounding is no less than its half."""
        own = np.zeros(len(insertion.points)) if insertion.sd is None else insertion.sd
        shared = self.noise.point_sd**2 + self.noise.correlated_sd**2
        shared += (self.rounding / 2) ** 2 + MIN_SCATTER_MM**2
        return self.larger * np.sqrt(shared + np.square(own))


def estimate_scatter(curves: Sequence[ListedInsertion], noise: Noise) -> Scatter:
    """Return the errors of points: stated, or as all points of all needles scatter (their median size)."""
    scatter = Scatter(noise, find_rounding([one.points.values for one in curves]))
    sizes = []
    for one in (each.insertion for each in curves):
        left, factor = leave_one_out(one.points[:, 0], one.points[:, 1:])
        sizes.append(np.abs(left) / (factor * scatter.sd_of(one))[:, None])
    return replace(scatter, larger=max(1.0, float(np.median(np.vstack(sizes))) / MEDIAN_TO_SD))


def find_outlying_points(listed: Sequence[ListedInsertion], noise: Noise) -> OutlyingPoints:
    """Return the outlying points, and steps, of each insertion that has any, by its id."""
    curves = [one for one in listed if len(one.insertion.points) >= MIN_CURVE_POINTS]
    if not curves:
        return {}
    scatter = estimate_scatter(curves, noise)
    found = {one.insertion.id: _find_in_curve(one.insertion, scatter) for one in curves}
    for point, one in _find_uneven(curves, scatter):  # where the needle is bent, it is off across it, too
        name = one.insertion.id
        found[name] = [each for each in found[name] if each.index != point.index] + [point]
    sound = [one for one in curves if not found[one.insertion.id]]
    for point, one in _find_ends(sound, scatter):
        found[one.insertion.id].append(point)
    return {name: points for name, points in found.items() if points}


def _find_in_curve(insertion: Insertion, scatter: Scatter) -> list[OutlyingPoint]:
    """Return the outlying points and steps of one curve, the worst first: without each the next is sought."""
    rest, kept, found = insertion, np.arange(len(insertion.points)), list[OutlyingPoint]()
    while len(kept) >= MIN_CURVE_POINTS:
        sd = scatter.sd_of(rest)
        single, step = (
            (left, np.abs(left).max(axis=1) / (factor * sd[-len(left) :]))
            for left, factor in (
                find(rest.points[:, 0], rest.points[:, 1:]) for find in (leave_one_out, find_steps)
            )
        )
        is_step = bool(step[1].max() > single[1].max())
        left, ratio = step if is_step else single
        worst = int(np.argmax(ratio))
        if ratio[worst] <= OUTLIER_SD:
            return found
        index = worst + is_step
        # of the point as it was read
        found.append(_describe(insertion, int(kept[index]), left[worst], float(ratio[worst]), is_step))
        if len(found) > MAX_OUTLYING_PART * len(insertion.points):
            return []
        if is_step:
            rest = _move_points(rest, index, left[worst])
        else:
            rest, kept = _select_points(rest, np.delete(np.arange(len(kept)), worst)), np.delete(kept, worst)
    return found


def _describe(
    insertion: Insertion, index: int, off: Floats, sds: float, is_step: bool = False
) -> OutlyingPoint:
    """Return a point that is off (2,) across its needle, mm."""
    measured = insertion.centerline[index]
    expected = measured - insertion.frame.rotation[:, 1:] @ off
    return OutlyingPoint(index, float(np.linalg.norm(off)), sds, measured, expected, is_step)


def _find_ends(
    listed: Sequence[ListedInsertion], scatter: Scatter
) -> Iterator[tuple[OutlyingPoint, ListedInsertion]]:
    """Yield first points and tips that continue their curves otherwise than those of like needles do."""
    groups = group_values(
        ((one.insertion.medium, one.insertion.sequence, one.insertion.needle.name), one) for one in listed
    )
    for group in (one for one in groups.values() if len(one) > MIN_OTHERS):
        own = [one.insertion for one in group]
        design = design_lengths([one.depth for one in own])
        bend = float(np.mean([abs(one.deflection) for one in own]))
        natural = math.hypot(NATURAL_END_MM, NATURAL_END_PART * bend)
        for index in (0, -1):
            order = slice(None) if index else slice(None, None, -1)
            pairs = [leave_last_out(one.points[order, 0], one.points[order, 1:]) for one in own]
            sides = np.array([[one.side, 1] for one in own])
            values = sides * np.array([left for left, _ in pairs])  # (n, 2)
            sds = np.array([f * scatter.sd_of(one)[index] for (_, f), one in zip(pairs, own, strict=True)])
            compared = [compare(design, axis, sds**2, natural) for axis in values.T]
            for n, found in enumerate(zip(*compared, strict=True)):
                worst = max(found, key=lambda each: each.sds)
                if worst.chance < MAX_END_CHANCE:
                    off = sides[n] * [each.value for each in found]
                    at = index % len(own[n].points)
                    yield _describe(own[n], at, off, worst.sds), group[n]


def _find_uneven(
    listed: Sequence[ListedInsertion], scatter: Scatter
) -> Iterator[tuple[OutlyingPoint, ListedInsertion]]:
    """Yield points that are off along their needles: between neighbours two of the usual steps apart."""
    for one in listed:
        points, sd = one.insertion.centerline, scatter.sd_of(one.insertion)[1:-1]
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        usual, tolerance = float(np.median(steps)), OUTLIER_SD * math.sqrt(2) * sd
        both, off = steps[:-1] + steps[1:] - 2 * usual, (steps[:-1] - steps[1:]) / 2
        ratio = np.where(np.abs(both) < tolerance, np.abs(off) / (math.sqrt(1.5) * sd), 0.0)
        worst = int(np.argmax(ratio))
        others = np.delete(steps, [worst, worst + 1])
        is_even = np.mean(np.abs(others - usual) < tolerance.min()) >= MIN_EVEN_PART
        if ratio[worst] > OUTLIER_SD and is_even:
            before, measured, after = points[worst : worst + 3]
            expected = measured - off[worst] * (after - before) / np.linalg.norm(after - before)
            yield (
                OutlyingPoint(worst + 1, abs(float(off[worst])), float(ratio[worst]), measured, expected),
                one,
            )


def _select_points(insertion: Insertion, kept: NDArray[np.int64]) -> Insertion:
    """Return the insertion with the points of these indices alone."""
    return replace(
        insertion,
        points=insertion.points[kept],
        centerline=insertion.centerline[kept],
        sd=None if insertion.sd is None else insertion.sd[kept],
    )


def _move_points(insertion: Insertion, first: int, by: Floats) -> Insertion:
    """Return the insertion with its points from one on moved back by (2,) across the needle, mm."""
    points, centerline = insertion.points.copy(), insertion.centerline.copy()
    points[first:, 1:] -= by
    centerline[first:] -= insertion.frame.rotation[:, 1:] @ by
    return replace(insertion, points=points, centerline=centerline)


def drop_outlying_points(listed: ListedInsertion, found: OutlyingPoints) -> ListedInsertion:
    """Return the insertion without its outlying points and steps."""
    off = found.get(listed.insertion.id, ())
    one = listed.insertion
    for step in (point for point in off if point.is_step):
        across = one.frame.rotation[:, 1:].T @ (step.measured - step.expected)
        one = _move_points(one, step.index, across)
    kept = np.delete(np.arange(len(one.points)), [point.index for point in off if not point.is_step])
    return replace(listed, insertion=_select_points(one, kept)) if off else listed


def find_point_warnings(listed: Sequence[ListedInsertion], found: OutlyingPoints) -> Iterator[ResultWarning]:
    """Yield a warning for each outlying point or step, with its row and the coordinate that fits."""
    for one in listed:
        last = len(one.insertion.points) - 1
        for point in found.get(one.insertion.id, ()):
            if point.is_step:
                yield _warn_of_step(one, point)
                continue
            name = {0: "the first point", last: "the tip"}.get(point.index, f"point {point.index + 1}")
            yield ResultWarning(
                kind="point_outlier",
                what=(
                    f"{name} of {one.insertion.id} is {point.distance:.2g} mm off the curve "
                    f"of the others ({point.sds:.0f} SD){_name_cause(point)}"
                ),
                where=one.points.where(point.index),
                fix="compare this row with its source, as the image or the protocol",
            )


def _warn_of_step(one: ListedInsertion, point: OutlyingPoint) -> ResultWarning:
    what = f"{one.insertion.id} has a step of {point.distance:.2g} mm between points {point.index} and "
    what += f"{point.index + 1} ({point.sds:.0f} SD): all later ones are off by as much, along "
    what += ", ".join(
        f"{name} by {off:.2g}"
        for name, off in zip("xyz", point.measured - point.expected, strict=True)
        if abs(off) > STEP_AXIS_PART * point.distance
    )
    rows = ", ".join(dict.fromkeys(one.points.where(n) for n in (point.index - 1, point.index)))
    return ResultWarning(
        kind="point_outlier",
        what=what,
        where=one.points.where(point.index),
        fix=f"find what moved between {rows}",
    )


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
        if len(one.points) < MIN_CURVE_POINTS:
            continue
        left, factor = leave_one_out(one.points[:, 0], one.points[:, 1:])
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
            yield ResultWarning(
                kind="needle_outlier",
                what=(
                    f"{one.insertion.id}: {name} is {value:g} at all points, where that of the others varies"
                ),
                where=one.points.where(),
                fix=f"export its points again: an empty column may have been saved as {value:g}",
            )


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
    yield ResultWarning(
        kind="axis_unit",
        what=(
            f"points scatter by {ratios[axis] * stated:.2g} mm along {name}, and by "
            f"{float(np.mean(ratios[right])) * stated:.2g} mm along the other axes, as "
            f"stated{looks}"
        ),
        where=f"{listed[0].points.where()}",
        fix=f"check the unit of {name}: of the points alone it is {1 / factor:.2g} times too large",
    )
