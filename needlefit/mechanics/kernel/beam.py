"""Cubic beam elements: Hermite functions, the needle's points in the plane, and derivatives of both.

The needle does not stretch: x(s) = integral of cos(atan u').
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Columns of a Hermite row: the functions of deflection and slope at the element's first node (0, 1) and at
# its second node (2, 3), then the slopes of these four functions in the same order (from SLOPES on).
HERMITE_COLUMNS = 8
SLOPES = 4


@njit(cache=True, nogil=True)
def fill_hermite(row: Floats, x: float, length: float) -> None:
    """Fill a Hermite row (HERMITE_COLUMNS,) at `x` mm into an element of this length."""
    s = x / length
    row[0] = 1.0 - s * s * (3.0 - 2.0 * s)
    row[1] = x * (1.0 - s) * (1.0 - s)
    row[2] = s * s * (3.0 - 2.0 * s)
    row[3] = x * s * (s - 1.0)
    row[4] = -6.0 * s * (1.0 - s) / length
    row[5] = (1.0 - s) * (1.0 - 3.0 * s)
    row[6] = -row[4]
    row[7] = s * (3.0 * s - 2.0)


@njit(cache=True, nogil=True)
def fill_hermite_derivatives(row: Floats, x: float, length: float, drift: float, grows: float) -> None:
    """Fill `row` with the change of a Hermite row when x changes by `drift` and the length by `grows`, per
    unit.
    """
    s = x / length
    row[0] = drift * -6.0 * s * (1.0 - s) / length + grows * 6.0 * s * s * (1.0 - s) / length
    row[1] = drift * (1.0 - s) * (1.0 - 3.0 * s) + grows * 2.0 * s * s * (1.0 - s)
    row[2] = -row[0]
    row[3] = drift * s * (3.0 * s - 2.0) + grows * s * s * (1.0 - 2.0 * s)
    row[4] = drift * (12.0 * s - 6.0) / length**2 + grows * 6.0 * s * (2.0 - 3.0 * s) / length**2
    row[5] = (drift * (6.0 * s - 4.0) + grows * s * (4.0 - 6.0 * s)) / length
    row[6] = -row[4]
    row[7] = (drift * (6.0 * s - 2.0) + grows * s * (2.0 - 6.0 * s)) / length


# cos(atan u') of a cubic is no polynomial: more points than the two of the stiffness.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)
_NODES, _WEIGHTS = 0.5 * (_NODES + 1.0), 0.5 * _WEIGHTS


@njit(cache=True, nogil=True)
def compute_positions(x: Floats, u: Floats, slope: Floats, s: Floats) -> Floats:
    """Return the needle's points (K, 2) in C at beam coordinates `s` (K,), from nodes x, u, slope (N,)."""
    reached = np.empty(len(x))  # the x coordinate in space of each node
    reached[0] = x[0]
    ends = np.empty(4)
    for e in range(len(x) - 1):
        fill_element_ends(ends, u, slope, e)
        reached[e + 1] = reached[e] + _integrate_x(ends, x[e + 1] - x[e], x[e + 1] - x[e])
    points = np.empty((len(s), 2))
    row = np.empty(HERMITE_COLUMNS)
    for i in range(len(s)):
        e = find_element(x, s[i])
        fill_element_ends(ends, u, slope, e)
        length = x[e + 1] - x[e]
        points[i, 0] = reached[e] + _integrate_x(ends, length, s[i] - x[e])
        fill_hermite(row, s[i] - x[e], length)
        points[i, 1] = row[0] * ends[0] + row[1] * ends[1] + row[2] * ends[2] + row[3] * ends[3]
    return points


@njit(cache=True, nogil=True)
def compute_batch_positions(x: Floats, u: Floats, slope: Floats, s: Floats) -> Floats:
    """Return the points (B, K, 2) of B needles with nodes (B, N) at the same beam coordinates."""
    points = np.empty((len(x), len(s), 2))
    for b in range(len(x)):
        one = compute_positions(x[b], u[b], slope[b], s)
        for i in range(len(s)):
            points[b, i, 0], points[b, i, 1] = one[i, 0], one[i, 1]
    return points


@njit(cache=True, nogil=True)
def compute_batch_deflections(x: Floats, u: Floats, slope: Floats, s: Floats) -> Floats:
    """Return the deflections (B, K) of B needles at beam coordinates: `compute_batch_positions` without x,
    which takes most of the time.
    """
    found = np.empty((len(x), len(s)))
    ends, row = np.empty(4), np.empty(HERMITE_COLUMNS)
    for b in range(len(x)):
        for i in range(len(s)):
            e = find_element(x[b], s[i])
            fill_element_ends(ends, u[b], slope[b], e)
            fill_hermite(row, s[i] - x[b, e], x[b, e + 1] - x[b, e])
            found[b, i] = row[0] * ends[0] + row[1] * ends[1] + row[2] * ends[2] + row[3] * ends[3]
    return found


@njit(cache=True, nogil=True)
def find_element(x: Floats, s: float) -> int:
    """Return the element of nodes `x` (N,) that contains a beam coordinate; outside, the nearest one."""
    return min(max(int(np.searchsorted(x, s)) - 1, 0), len(x) - 2)


@njit(cache=True, nogil=True, inline="always")
def fill_element_ends(ends: Floats, u: Floats, slope: Floats, e: int) -> None:
    """Fill `ends` (4,) with deflection and slope at both ends of element `e`."""
    ends[0], ends[1], ends[2], ends[3] = u[e], slope[e], u[e + 1], slope[e + 1]


@njit(cache=True, nogil=True)
def _integrate_x(ends: Floats, length: float, upto: float) -> float:
    """Return the integral of cos(atan u') over the first `upto` mm of an element."""
    row = np.empty(HERMITE_COLUMNS)
    total = 0.0
    for i in range(len(_NODES)):
        fill_hermite(row, _NODES[i] * upto, length)
        slope = row[4] * ends[0] + row[5] * ends[1] + row[6] * ends[2] + row[7] * ends[3]
        total += _WEIGHTS[i] * upto / np.sqrt(1.0 + slope * slope)
    return total


@njit(cache=True, nogil=True)
def compute_position_derivatives(
    x: Floats, u: Floats, slope: Floats, s: Floats, x_by: Floats, u_by: Floats, slope_by: Floats
) -> Floats:
    """Return the derivatives (K, 2, P) of the needle's points at beam coordinates `s` (K,).

    `x_by`, `u_by` and `slope_by` (N, P) are those of the nodes x, u, slope (N,).
    """
    columns = u_by.shape[1]
    reached = np.zeros((len(x), columns))  # of the x coordinate in space of each node
    for e in range(len(x) - 1):
        reached[e + 1] = reached[e]
        _add_x_derivatives(reached[e + 1], e, x[e + 1] - x[e], x, u, slope, x_by, u_by, slope_by)
    moves = np.zeros((len(s), 2, columns))
    n, n_by = np.empty(HERMITE_COLUMNS), np.empty(HERMITE_COLUMNS)
    for i in range(len(s)):
        e = min(max(np.searchsorted(x, s[i]) - 1, 0), len(x) - 2)
        moves[i, 0] = reached[e]
        _add_x_derivatives(moves[i, 0], e, s[i] - x[e], x, u, slope, x_by, u_by, slope_by)
        fill_hermite(n, s[i] - x[e], x[e + 1] - x[e])
        for p in range(columns):
            moves[i, 1, p] = (
                n[0] * u_by[e, p] + n[1] * slope_by[e, p] + n[2] * u_by[e + 1, p] + n[3] * slope_by[e + 1, p]
            )
            if x_by[e, p] != 0.0 or x_by[e + 1, p] != 0.0:
                fill_hermite_derivatives(
                    n_by, s[i] - x[e], x[e + 1] - x[e], -x_by[e, p], x_by[e + 1, p] - x_by[e, p]
                )
                moves[i, 1, p] += (
                    n_by[0] * u[e] + n_by[1] * slope[e] + n_by[2] * u[e + 1] + n_by[3] * slope[e + 1]
                )
    return moves


@njit(cache=True, nogil=True)
def _add_x_derivatives(
    into: Floats, e: int, upto: float, x: Floats, u: Floats, slope: Floats, x_by: Floats, u_by: Floats,
    slope_by: Floats,
) -> None:  # fmt: skip
    """Add the derivative of the integral of cos(atan u') over the first `upto` mm of an element."""
    n, n_by = np.empty(HERMITE_COLUMNS), np.empty(HERMITE_COLUMNS)
    length = x[e + 1] - x[e]
    for i in range(len(_NODES)):
        fill_hermite(n, _NODES[i] * upto, length)
        at = n[4] * u[e] + n[5] * slope[e] + n[6] * u[e + 1] + n[7] * slope[e + 1]
        f = -_WEIGHTS[i] * upto * at / (1.0 + at * at) ** 1.5
        for p in range(len(into)):
            change = (
                n[4] * u_by[e, p] + n[5] * slope_by[e, p] + n[6] * u_by[e + 1, p] + n[7] * slope_by[e + 1, p]
            )
            if x_by[e, p] != 0.0 or x_by[e + 1, p] != 0.0:
                fill_hermite_derivatives(
                    n_by, _NODES[i] * upto, length, -x_by[e, p], x_by[e + 1, p] - x_by[e, p]
                )
                change += n_by[4] * u[e] + n_by[5] * slope[e] + n_by[6] * u[e + 1] + n_by[7] * slope[e + 1]
            into[p] += f * change
