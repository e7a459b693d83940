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


def log_sum_exp(logs: Floats, axis: int = 0) -> Floats:
    """Return the logarithm of the sum of exponentials along an axis: SciPy's, in a third of its time."""
    top = logs.max(axis=axis, keepdims=True)
    is_top = logs == top
    # the largest are counted apart, for the digits of the rest
    rest = np.where(is_top, 0.0, np.exp(logs - np.where(np.isfinite(top), top, 0.0)))
    count = is_top.sum(axis=axis)
    return np.log1p(rest.sum(axis=axis) / count) + np.log(count) + top.squeeze(axis)
