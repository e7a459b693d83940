"""Name the types of arrays that stand in signatures, and check numbers from outside before they are used."""

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
