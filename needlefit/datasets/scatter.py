"""The scatter of points about their smooth curves: units of axes, stated SDs, interpolated points."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import ndtri

from needlefit.arrays import Floats
from needlefit.datasets.compared import MAX_NAMED_INSERTIONS
from needlefit.datasets.insertion import Insertion, Noise
from needlefit.datasets.layers import SAME_POINT_MM, Checked, ListedInsertion
from needlefit.datasets.outlying_points import MIN_CURVE_POINTS, measure_residuals
from needlefit.datasets.points import find_rounding
from needlefit.project.locate import join_names
from needlefit.project.result_warnings import ResultWarning

#: plausible SDs of points, registration and entry pose, mm: a smaller one was written in another unit (the
#: best instruments resolve micrometres), and with a greater one curves cannot be compared
SD_MM = (5e-4, 5.0)
#: scatter of points about their curves over the stated SD that does not contradict it: smallest and largest
SCATTER_RATIOS = (1 / 3, 2.0)
#: smallest number of points whose scatter along an axis is computed: of fewer it is known to worse than a
#: sixth
MIN_AXIS_POINTS = 20
#: smallest cosine between an axis and the plane across a needle in which points show their scatter
AXIS_COSINE = 0.9


def measure_scatter(insertion: Insertion) -> float:
    """Return the SD of points about the curve of their neighbours across the plane of the needle, mm.

    Points of a plane, and free shapes, are taken to scatter in their plane. NaN of few points.
    """
    if len(insertion.points) < MIN_CURVE_POINTS:
        return math.nan
    is_flat = insertion.pose_source == "none" or float(np.ptp(insertion.points[:, 2])) < SAME_POINT_MM
    return math.sqrt(np.mean(measure_residuals(insertion)[:, 0 if is_flat else 1] ** 2))


def find_scatter_warnings(
    insertions: Sequence[Insertion], noise: Noise, place: str, is_smoothed: bool = False
) -> Iterator[ResultWarning]:
    """Yield a warning if points scatter about smooth curves by more, or less, than their stated errors.

    `is_smoothed`: the measurement smoothed the points, so that they may scatter less.
    """
    scattered = []
    for insertion in insertions:
        point_sd = noise.of(insertion).point_sd
        stated_sd = 0.0 if insertion.sd is None else float(np.sqrt(np.mean(insertion.sd**2)))
        stated = math.hypot(stated_sd, point_sd, noise.correlated_sd)
        if stated >= SD_MM[0] and not math.isnan(scatter := measure_scatter(insertion)):
            scattered.append((scatter, stated, point_sd))
    if not scattered:
        return
    scatter, stated, point_sd = np.sqrt(np.mean(np.square(scattered), axis=0))
    # errors that neighbours share, and those of a column, need not scatter
    too_large = scatter < SCATTER_RATIOS[0] * point_sd and not is_smoothed
    if too_large or scatter > SCATTER_RATIOS[1] * stated:
        problem = f"points scatter by {scatter:.2g} mm about smooth curves, where {stated:.2g} mm is expected"
        fix = "state the noise of repeated measurements" + (
            ", or under [measurement] what smoothed the points" if too_large else ""
        )
        yield ResultWarning("noise", problem, where=place, fix=fix)


def find_axis_warnings(checked: Checked) -> Iterator[ResultWarning]:
    """Yield a warning if points scatter along one axis as in another unit, and along others as stated."""
    listed, stated = checked.curves, math.hypot(checked.noise.point_sd, checked.noise.correlated_sd)
    if not listed or stated == 0:
        return
    rounding = find_rounding([entry.points.values for entry in listed])
    ratios = np.maximum(_measure_axes(listed), rounding / 2) / stated
    ratios[ratios == 0] = math.nan  # points that are exact show none
    off = np.abs(np.log(ratios)) / math.log(SCATTER_RATIOS[1])  # NaN where an axis shows none
    odd, right = np.flatnonzero(off > 2), np.flatnonzero(off < 1)
    if len(odd) == 1 and len(right):
        (axis,) = odd
        problem = f"points scatter by {ratios[axis] * stated:.2g} mm along {'xyz'[axis]}, and by "
        problem += f"{float(np.mean(ratios[right])) * stated:.2g} mm along the other axes, as stated"
        fix = f"check the unit of {'xyz'[axis]}"
        yield ResultWarning("axis_unit", problem, where=listed[0].points.where(), fix=fix)


def _measure_axes(listed: Sequence[ListedInsertion]) -> Floats:
    """Return the SD (3,) of points about their curves along each axis of the world, mm; NaN where none shows.

    An axis shows it across needles, and unless no coordinate of it differs.
    """
    sizes: list[list[Floats]] = [[], [], []]
    for insertion in (entry.insertion for entry in listed):
        if len(insertion.points) >= MIN_CURVE_POINTS:
            residuals = measure_residuals(insertion)
            across = insertion.frame.rotation[:, 1:]  # (3, 2)
            for axis in np.flatnonzero(np.linalg.norm(across, axis=1) > AXIS_COSINE):
                if np.ptp(insertion.centerline[:, axis]) > 0:
                    sizes[axis].append(np.abs(residuals @ across[axis]))
    joined = [np.concatenate([np.empty(0), *some]) for some in sizes]
    medians = [np.median(some) if len(some) >= MIN_AXIS_POINTS else np.nan for some in joined]
    return np.array(medians) / ndtri(0.75)


# ---- points that were interpolated between fewer measured ones, which alone count in fits
#
# Points between measured ones lie on smooth pieces: they scatter less about their neighbours than they err,
# and less than a few of them do. The fewer are left, the more they scatter; where half of the variance
# shows, they are independent.


def count_independent(points: Floats, sd: float) -> int:
    """Return how many points of a curve (N, 3) have errors of their own, of SD `sd` (mm) across it.

    All of few points, of those that scatter by more than a third of it, and of those of which a few scatter
    as much: independent errors do, of whatever size.
    """
    count, scatter = len(points), _measure_scatter_about_cubics(points)
    if count < MIN_AXIS_POINTS or scatter >= SCATTER_RATIOS[0] * sd:
        return count
    few = points[:: -(count // (2 * MIN_CURVE_POINTS))]  # whose scatter is known to a quarter
    if scatter >= 0.5 * _measure_scatter_about_cubics(few):
        return count
    thinned = (points[::-1][::step] for step in range(2, _find_largest_step(count)))  # with the tip
    enough = (len(few) for few in thinned if _measure_scatter_about_cubics(few) >= math.sqrt(0.5) * sd)
    return next(enough, MIN_CURVE_POINTS)


def _find_largest_step(count: int) -> int:
    """Return the step by which fewest of so many points are left that scatter about a cubic."""
    return max(1, (count - 1) // (MIN_CURVE_POINTS - 1))


def _measure_scatter_about_cubics(points: Floats) -> float:
    """Return the SD of points (N, 3) about cubics through their neighbours along the axes that vary, mm.

    Fourth differences of independent errors have 70 times their variance; those of a cubic are 0.
    """
    bent = np.diff(points[:, 1:][:, np.ptp(points[:, 1:], axis=0) > 0], 4, axis=0)
    return math.sqrt(np.mean(bent**2) / 70) if bent.size else 0.0


def mark_interpolated(listed: Sequence[ListedInsertion], noise: Noise) -> list[ListedInsertion]:
    """Return insertions of which each knows how many of its points are independent.

    Where even few points of all needles hardly scatter, the stated SD is too large, and nothing is known.
    """
    curves = [entry.insertion for entry in listed if entry.is_curve]
    few = [curve.points[:: -_find_largest_step(len(curve.points))] for curve in curves]
    least = SCATTER_RATIOS[0] * math.hypot(*(noise.of(curve).point_sd for curve in curves))
    if not noise.point_sd or math.hypot(*map(_measure_scatter_about_cubics, few)) < least:
        return list(listed)
    return [
        replace(entry, insertion=replace(entry.insertion, independent=count))
        if entry.is_curve
        and (count := count_independent(entry.insertion.points, noise.of(entry.insertion).point_sd))
        < len(entry.insertion.points)
        else entry
        for entry in listed
    ]


def find_interpolated_warnings(checked: Checked) -> Iterator[ResultWarning]:
    """Yield a warning that names the curves whose points are not independent, and how many count."""
    interpolated = [entry for entry in checked.curves if entry.insertion.independent]
    if interpolated:
        curves = [entry.insertion for entry in interpolated]
        counts = [f"{curve.id} ({curve.independent} of {len(curve.points)})" for curve in curves]
        named = join_names(counts, MAX_NAMED_INSERTIONS)
        problem = f"points are interpolated between fewer measured ones: {named}"
        place, fix = interpolated[0].points.where(), "export the measured points alone"
        yield ResultWarning("interpolated", problem, place, fix)
