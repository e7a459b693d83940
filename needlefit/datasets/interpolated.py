"""Find curves most of whose points were interpolated between fewer measured ones, which alone count in fits.

Points between measured ones lie on smooth pieces: they scatter less about their neighbours than they err, and
less than a few of them do. The fewer of them are left, the more they scatter; where half of the
variance shows, they are independent.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.compared import MAX_NAMED_INSERTIONS
from needlefit.datasets.insertion import Noise
from needlefit.datasets.layers import Checked, ListedInsertion
from needlefit.datasets.outlying_points import MIN_CURVE_POINTS
from needlefit.datasets.scatter import MIN_AXIS_POINTS, SCATTER_RATIOS
from needlefit.project.locate import join_names
from needlefit.project.result_warnings import ResultWarning


def count_independent(points: Floats, sd: float) -> int:
    """Return how many points of a curve (N, 3) have errors of their own, of SD `sd` (mm) across it.

    All of few points, of those that scatter by more than a third of it, and of those of which a few scatter
    as much: independent errors do, of whatever size.
    """
    count, scatter = len(points), _measure_scatter(points)
    if count < MIN_AXIS_POINTS or scatter >= SCATTER_RATIOS[0] * sd:
        return count
    few = points[:: -(count // (2 * MIN_CURVE_POINTS))]  # whose scatter is known to a quarter
    if scatter >= 0.5 * _measure_scatter(few):
        return count
    thinned = (points[::-1][::step] for step in range(2, _find_largest_step(count)))  # with the tip
    enough = (len(few) for few in thinned if _measure_scatter(few) >= math.sqrt(0.5) * sd)
    return next(enough, MIN_CURVE_POINTS)


def _find_largest_step(count: int) -> int:
    """Return the step by which fewest of so many points are left that scatter about a cubic."""
    return max(1, (count - 1) // (MIN_CURVE_POINTS - 1))


def _measure_scatter(points: Floats) -> float:
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
    reversed_points = [curve.points[::-1] for curve in curves]
    few = [_measure_scatter(points[:: _find_largest_step(len(points))]) for points in reversed_points]
    least = SCATTER_RATIOS[0] * math.hypot(*(noise.of(curve).point_sd for curve in curves))
    if not noise.point_sd or math.hypot(*few) < least:
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
