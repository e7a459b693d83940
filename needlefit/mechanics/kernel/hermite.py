"""Cubic Hermite functions of one beam element."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@njit(cache=True, nogil=True)
def hermite(row: Floats, x: float, length: float) -> None:
    """Fill `row` (8,) with the four functions of (u, u') at the two ends, then their slopes, `x` mm in."""
    s = x / length
    row[0] = 1.0 - s * s * (3.0 - 2.0 * s)
    row[1] = x * (1.0 - s) * (1.0 - s)
    row[2] = s * s * (3.0 - 2.0 * s)
    row[3] = x * s * (s - 1.0)
    row[4] = -6.0 * s * (1.0 - s) / length
    row[5] = (1.0 - s) * (1.0 - 3.0 * s)
    row[6] = -row[4]
    row[7] = s * (3.0 * s - 2.0)
