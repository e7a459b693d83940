"""Find single points that cannot be on a curve, as codes of missing values, or of a lost decimal mark."""

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats

# smallest distance of a stray point from the middle of its curve, as a multiple of the median distance of all
# points; evenly spaced points have at most 2
MIN_DISTANCE_RATIO = 10.0
# smallest distance (mm) of a stray point from that middle: a tip may lie far from all other points
MIN_DISTANCE_MM = 300.0
MIN_DETOUR_RATIO = 5.0  # smallest length of the way over a stray point, as a multiple of the way without it
MIN_DETOUR = 0.5  # smallest difference of these two lengths, as a fraction of the median distance
MAX_STRAY_FRACTION = 0.25  # largest fraction of stray points; more are no mistakes of single points
MIN_REGULAR_POINTS = 4  # largest number of points of a curve at which none counts as stray


def find_stray_points(curve: Floats) -> NDArray[np.int64]:
    """Return the points of a curve (N, 3), mm, that lie far aside from all others; none if they are many."""
    if len(curve) <= MIN_REGULAR_POINTS:
        return np.empty(0, dtype=np.int64)
    distances = np.linalg.norm(curve - np.median(curve, axis=0), axis=1)
    scale = float(np.median(distances))
    is_far = distances > max(MIN_DISTANCE_RATIO * scale, MIN_DISTANCE_MM)
    is_far[1:-1] |= _find_detours(curve, MIN_DETOUR * scale)
    stray = np.flatnonzero(is_far)
    is_few = len(stray) <= max(1.0, MAX_STRAY_FRACTION * len(curve))
    return stray if is_few and len(curve) - len(stray) >= MIN_REGULAR_POINTS else stray[:0]


def _find_detours(curve: Floats, least: float) -> NDArray[np.bool_]:
    """Return which inner points (N - 2,) lead the curve aside and back again by at least a length."""
    steps = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    over, without = steps[:-1] + steps[1:], np.linalg.norm(curve[2:] - curve[:-2], axis=1)
    return (over > MIN_DETOUR_RATIO * without) & (over - without > least)
