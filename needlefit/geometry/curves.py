"""Polylines by arc length."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


def arc_length(points: ArrayLike) -> Floats:
    """Return the length along the polyline `points` (N, d) up to each point, 0 at the first: (N,), mm."""
    steps = np.linalg.norm(np.diff(np.asarray(points, dtype=np.float64), axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def at_arc(points: ArrayLike, s: ArrayLike) -> Floats:
    """Return the points (K, d) at arc lengths `s` (K,) along `points` (N, d); beyond an end, that end."""
    array = np.asarray(points, dtype=np.float64)
    along = arc_length(array)
    return np.column_stack([np.interp(np.asarray(s, dtype=np.float64), along, axis) for axis in array.T])


def resample(points: ArrayLike, fractions: ArrayLike) -> Floats:
    """Return the points (K, d) at `fractions` (K,) in [0, 1] of the arc length of `points` (N, d)."""
    array = np.asarray(points, dtype=np.float64)
    return at_arc(array, np.asarray(fractions, dtype=np.float64) * arc_length(array)[-1])
