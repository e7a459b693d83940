"""The layout of the arrays that the loops over lanes share, and the tables computed from a grid before them.

Columns of tables are counted in numbers, rows of flat arrays in steps of LANES numbers. In the tables every
product of weight and shape functions is computed beforehand.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from needlefit.arrays import Floats, Ints
from needlefit.mechanics.kernel.grid import NodeGrid

LANES = 32  # at least 16: the compiler checks at run time whether rows overlap only where that pays

# Columns of a quadrature point's table; N: shape functions of (u, u') at the element's two ends, w: weight,
# SHARE: how much of the way from one constraint point to the other the cut has gone there.
POINT_COLUMNS = 19
N0, N1, N2, N3 = 0, 1, 2, 3
WN0, WN1, WN2, WN3 = 4, 5, 6, 7  # w N
WN00, WN01, WN02, WN03, WN11, WN12, WN13, WN22, WN23, WN33 = 8, 9, 10, 11, 12, 13, 14, 15, 16, 17  # w N_i N_j
SHARE = 18

# Columns of a regular element's table: those of its four points one after the other (Q1: the first column of
# the second point), then its bending stiffness over EI: 12 / l^3, 6 / l^2, 4 / l, 2 / l.
Q1, Q2, Q3 = 19, 38, 57
B12, B6, B4, B2 = 76, 77, 78, 79
REGULAR_COLUMNS = 80

# Rows of LANES numbers. Of a layer: the series of k (6), the |e| up to which it holds, curvature, friction.
# Of a node: G = S^-1 K_ab, S^-1, z = S^-1 r, tangents at its element's points, S, r, excess, and u where its
# factor was made. Of an element's sums: K (10), f (4), excess.
LAYER_ROWS, NODE_ROWS, SUM_ROWS = 9, 20, 15
COMPLIANCE_ROWS = 7  # P (4) and the compliance (3): `passes.add_compliance`

# Offsets of rows in flat arrays. All are unsigned: an unsigned number and a signed one would make a float.
ONE = np.uint64(1)
W1, W2, W3, W4, W5, W6, W7, W8, W9, W10, W11, W12, W13, W14 = (
    np.uint64(i * LANES) for i in range(1, SUM_ROWS)
)
LIMIT, CURVATURE, FRICTION = W6, W7, W8  # of a layer
INVERSE, Z, TANGENT, S, R, EXCESS, REFERENCE, NODE = (
    np.uint64(i * LANES) for i in (4, 7, 9, 13, 16, 18, 19, NODE_ROWS)
)
# Of what a lane is about: whether it iterates, its greatest increment, and the greatest product of increment
# and distance from `REFERENCE`.
AT_WORK, INCREMENT, PRODUCT = np.uint64(0), W1, W2
K01, K02, K03, K11, K12, K13, K22, K23, K33 = W1, W2, W3, W4, W5, W6, W7, W8, W9  # of the sums; K00 is row 0
F0, F1, F2, F3, OVER = W10, W11, W12, W13, W14


class LaneTables(NamedTuple):
    """The quadrature of a grid, as the loops over lanes read it."""

    points: Floats  # (Q, POINT_COLUMNS) of every point
    bending: Floats  # (N, 4) 12, 6 l, 4 l^2, 2 l^2 over l^3 of the element that ends at each node
    regular: Floats  # (T, REGULAR_COLUMNS) of the different elements with two intervals
    regular_row: Ints  # (N,) the row of an element in `regular`, -1 for elements of another kind
    layer: Ints  # (N,) layer where an element begins; 0 where it has no tissue


@njit(cache=True, nogil=True)
def tabulate(grid: NodeGrid) -> LaneTables:
    """Return the tables of a grid; those of element 0 are filled at each stop, when its length is known."""
    count = len(grid.nodes)
    points, bending = np.zeros((len(grid.x), POINT_COLUMNS)), np.zeros((count, 4))
    regular, regular_row, regular_count = np.empty((count, REGULAR_COLUMNS)), np.full(count, -1), 0
    layer = np.zeros(count, np.int64)
    for e in range(count):
        if grid.first[e] < len(grid.layer):
            layer[e] = grid.layer[grid.first[e]]
    for e in range(1, count):
        length = grid.nodes[e] - grid.nodes[e - 1]
        _fill_bending(bending[e], length)
        for q in range(grid.first[e], grid.first[e + 1]):
            tabulate_point(points[q], grid.shapes[q], grid.weight[q], grid.share[q])
        first = grid.first[e]
        # Regular: four points, and the third is the first one of the next constraint point.
        if grid.first[e + 1] - first != 4 or grid.constraint[first + 2] != grid.constraint[first] + 1:
            continue
        near, far = grid.constraint[first], grid.constraint[first + 2]
        if grid.other[first] not in (near, far) or grid.other[first + 2] not in (near, far):
            continue
        row = regular[regular_count]
        for q in range(4):
            for i in range(POINT_COLUMNS):
                row[q * POINT_COLUMNS + i] = points[first + q, i]
            if q >= 2:  # nearest to the second of the element's constraint points
                row[q * POINT_COLUMNS + SHARE] = 1.0 - points[first + q, SHARE]
        for i in range(4):
            row[B12 + i] = bending[e, i]
        regular_row[e] = regular_count
        # Most regular elements equal the one before; a shared row stays in the processor's cache.
        if regular_count > 0 and _are_equal(row, regular[regular_count - 1]):
            regular_row[e] -= 1
        else:
            regular_count += 1
    return LaneTables(points, bending, regular[:regular_count].copy(), regular_row, layer)


@njit(cache=True, nogil=True)
def _are_equal(row: Floats, other: Floats) -> bool:
    """Return whether two tables are the same but for rounding; one of them then stays in the cache."""
    different = 0
    for i in range(len(row)):
        different += int(abs(row[i] - other[i]) > 1e-12 * abs(other[i]))
    return different == 0


@njit(cache=True, nogil=True)
def tabulate_point(row: Floats, shape: Floats, weight: float, share: float) -> None:
    """Fill the table row (POINT_COLUMNS,) of one quadrature point, given its shape functions and the share of
    the way that the cut has gone from its nearest constraint point to the other one.
    """
    row[SHARE] = share
    at = WN00
    for i in range(4):
        row[N0 + i], row[WN0 + i] = shape[i], weight * shape[i]
        for j in range(i, 4):
            row[at] = weight * shape[i] * shape[j]
            at += 1


@njit(cache=True, nogil=True)
def _fill_bending(row: Floats, length: float) -> None:
    row[0], row[1], row[2], row[3] = 12.0 / length**3, 6.0 / length**2, 4.0 / length, 2.0 / length
