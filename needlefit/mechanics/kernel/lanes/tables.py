"""A grid as the loops over lanes read it: every weight and shape function multiplied out beforehand."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from needlefit.mechanics.kernel.grid import Grid
from needlefit.mechanics.kernel.lanes.passes import POINT

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Tables(NamedTuple):
    """A grid as the loops over lanes read it."""

    points: Floats  # (Q, POINT) N, w N, w N N of every point
    bending: Floats  # (N, 4) 12, 6 l, 4 l^2, 2 l^2 over l^3 of the element that ends at each node
    regular: Floats  # (T, 4 POINT + 4) of the different elements with two intervals
    which: Ints  # (N,) the row of an element in `regular`, -1 for elements of another kind


@njit(cache=True, nogil=True)
def tabulate(grid: Grid) -> Tables:
    """Return the tables of a grid; those of element 0 are filled when its length is known."""
    count = len(grid.nodes)
    points, bending = np.zeros((len(grid.x), POINT)), np.zeros((count, 4))
    regular, which, kinds = np.empty((count, 4 * POINT + 4)), np.full(count, -1), 0
    for e in range(1, count):
        length = grid.nodes[e] - grid.nodes[e - 1]
        _stiffness(bending[e], length)
        for q in range(grid.first[e], grid.first[e + 1]):
            tabulate_point(points[q], grid.shapes[q], grid.weight[q])
        first = grid.first[e]
        if grid.first[e + 1] - first != 4 or grid.constraint[first + 2] != grid.constraint[first] + 1:
            continue
        row = regular[kinds]
        for q in range(4):
            for i in range(POINT):
                row[q * POINT + i] = points[first + q, i]
        for i in range(4):
            row[4 * POINT + i] = bending[e, i]
        which[e] = kinds
        if kinds > 0 and _alike(row, regular[kinds - 1]):
            which[e] -= 1
        else:
            kinds += 1
    return Tables(points, bending, regular[:kinds].copy(), which)


@njit(cache=True, nogil=True)
def _alike(row: Floats, other: Floats) -> bool:
    """Return whether two tables are the same but for rounding; one of them then stays in the cache."""
    different = 0
    for i in range(len(row)):
        different += int(abs(row[i] - other[i]) > 1e-12 * abs(other[i]))
    return different == 0


@njit(cache=True, nogil=True)
def tabulate_point(row: Floats, shape: Floats, weight: float) -> None:
    at = 8
    for i in range(4):
        row[i], row[4 + i] = shape[i], weight * shape[i]
        for j in range(i, 4):
            row[at] = weight * shape[i] * shape[j]
            at += 1


@njit(cache=True, nogil=True)
def _stiffness(row: Floats, length: float) -> None:
    row[0], row[1], row[2], row[3] = 12.0 / length**3, 6.0 / length**2, 4.0 / length, 2.0 / length
