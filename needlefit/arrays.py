"""Types of arrays that stand in signatures, checks of numbers from outside, and axes filled up with zeros."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from needlefit.schemas.limits import MAX_NUMBER

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def are_bounded(values: ArrayLike, most: float = MAX_NUMBER) -> bool:
    """Return whether all values are finite and at most `most` in size.

    To be checked before linear algebra: an SVD of numbers whose squares overflow may not return.
    """
    # NaN compares as false
    return bool(np.all(np.abs(np.asarray(values, dtype=np.float64)) <= most))


def pad_axis(array: Floats, size: int, axis: int = -1) -> Floats:
    """Return an array with zeros behind the values of an axis, up to `size`: in space, one of a plane."""
    if array.shape[axis] == size:
        return array
    shape, filled = list(array.shape), [slice(None)] * array.ndim
    filled[axis], shape[axis] = slice(shape[axis]), size
    padded = np.zeros(shape)
    padded[tuple(filled)] = array
    return padded
