"""Predict points of a curve from their neighbours: what a point adds is left over."""

from functools import lru_cache

import numpy as np

from needlefit.arrays import Floats, Ints

MIN_NEIGHBOURS = 4  #: smallest number of neighbours on either side of a point
MAX_NEIGHBOURS = 20  #: largest number of neighbours on either side of a point
REACH_MM = 8.0  #: distance (mm) within which points are neighbours, between these two numbers of them
MAX_ORDER = 3  #: largest order of the polynomial through neighbours


def leave_one_out(x: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return how far each point (N, k) is from a cubic through its neighbours, and a factor (N,).

    The factor is that by which the standard deviation of this distance is larger than that of a point, of
    independent errors. At the ends all neighbours lie on one side. `x` (N,) increases; N is at least 4.
    """
    others, weights, factor = _weigh_others(x.tobytes())
    return values - np.einsum("ij,ijk->ik", weights, values[others]), factor


@lru_cache(maxsize=256)  # several checks of a dataset ask for the points of the same needles
def _weigh_others(places: bytes) -> tuple[Ints, Floats, Floats]:
    """Return the neighbours (N, n) of each point of a curve, their weights (N, n), and the factor (N,)."""
    x = np.frombuffer(places)
    count = len(x)
    near = _count_neighbours(x)
    order = min(MAX_ORDER, near - 2)
    first = np.clip(np.arange(count) - near // 2, 0, count - near - 1)
    window = first[:, None] + np.arange(near + 1)  # (N, near + 1), with the point itself
    others = window[window != np.arange(count)[:, None]].reshape(count, near)
    away = x[others] - x[:, None]
    scale = np.abs(away).max(axis=1, keepdims=True)
    powers = (away / scale)[..., None] ** np.arange(order + 1)
    weights = np.linalg.pinv(powers)[:, 0, :]  # (N, near): of the polynomial's value at the point
    return others, weights, np.sqrt(1.0 + np.sum(weights**2, axis=1))


def _count_neighbours(x: Floats) -> int:
    """Return how many neighbours predict a point."""
    step = float(np.median(np.diff(x)))
    side = int(np.clip(REACH_MM / max(step, 1e-9), MIN_NEIGHBOURS, MAX_NEIGHBOURS))
    return min(2 * side, len(x) - 1)
