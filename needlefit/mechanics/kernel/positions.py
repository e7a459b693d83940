"""From the beam to the plane: the needle does not stretch, x(s) = integral of cos(atan u')."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from needlefit.mechanics.kernel.hermite import hermite

Floats = NDArray[np.float64]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)
_NODES, _WEIGHTS = 0.5 * (_NODES + 1.0), 0.5 * _WEIGHTS


@njit(cache=True, nogil=True)
def positions(x: Floats, u: Floats, slope: Floats, s: Floats) -> Floats:
    """Return points (K, 2) in C at beam coordinates `s` (K,), for nodes x, u, slope (N,)."""
    reached = np.empty(len(x))  # the x coordinate in space of each node
    reached[0] = x[0]
    ends = np.empty(4)
    for e in range(len(x) - 1):
        ends_of(ends, u, slope, e)
        reached[e + 1] = reached[e] + _advance(ends, x[e + 1] - x[e], x[e + 1] - x[e])
    points = np.empty((len(s), 2))
    row = np.empty(8)
    for i in range(len(s)):
        e = element_at(x, s[i])
        ends_of(ends, u, slope, e)
        length = x[e + 1] - x[e]
        points[i, 0] = reached[e] + _advance(ends, length, s[i] - x[e])
        hermite(row, s[i] - x[e], length)
        points[i, 1] = row[0] * ends[0] + row[1] * ends[1] + row[2] * ends[2] + row[3] * ends[3]
    return points


@njit(cache=True, nogil=True)
def positions_each(x: Floats, u: Floats, slope: Floats, s: Floats) -> Floats:
    """Return points (B, K, 2) of B needles, their nodes (B, N), at the same beam coordinates."""
    points = np.empty((len(x), len(s), 2))
    for b in range(len(x)):
        one = positions(x[b], u[b], slope[b], s)
        for i in range(len(s)):
            points[b, i, 0], points[b, i, 1] = one[i, 0], one[i, 1]
    return points


@njit(cache=True, nogil=True)
def deflections_each(x: Floats, u: Floats, slope: Floats, s: Floats) -> Floats:
    """Return what `positions_each` says of deflection alone, (B, K): the way along C takes most time."""
    found = np.empty((len(x), len(s)))
    ends, row = np.empty(4), np.empty(8)
    for b in range(len(x)):
        for i in range(len(s)):
            e = element_at(x[b], s[i])
            ends_of(ends, u[b], slope[b], e)
            hermite(row, s[i] - x[b, e], x[b, e + 1] - x[b, e])
            found[b, i] = row[0] * ends[0] + row[1] * ends[1] + row[2] * ends[2] + row[3] * ends[3]
    return found


@njit(cache=True, nogil=True)
def element_at(x: Floats, s: float) -> int:
    """Return the element of nodes `x` (N,) in which a beam coordinate lies; the nearest one outside."""
    return min(max(int(np.searchsorted(x, s)) - 1, 0), len(x) - 2)


@njit(cache=True, nogil=True, inline="always")
def ends_of(ends: Floats, u: Floats, slope: Floats, e: int) -> None:
    """Fill `ends` (4,) with deflection and slope at both ends of element `e`."""
    ends[0], ends[1], ends[2], ends[3] = u[e], slope[e], u[e + 1], slope[e + 1]


@njit(cache=True, nogil=True)
def _advance(ends: Floats, length: float, upto: float) -> float:
    """Return the integral of cos(atan u') over the first `upto` mm of an element."""
    row = np.empty(8)
    total = 0.0
    for i in range(len(_NODES)):
        hermite(row, _NODES[i] * upto, length)
        slope = row[4] * ends[0] + row[5] * ends[1] + row[6] * ends[2] + row[7] * ends[3]
        total += _WEIGHTS[i] * upto / np.sqrt(1.0 + slope * slope)
    return total
