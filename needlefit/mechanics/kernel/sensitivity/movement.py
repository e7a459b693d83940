"""How the points of the plane move with the nodes: the derivative of `positions`."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from needlefit.mechanics.kernel.hermite import hermite
from needlefit.mechanics.kernel.sensitivity.perturbation import hermite_slopes

Floats = NDArray[np.float64]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)
_NODES, _WEIGHTS = 0.5 * (_NODES + 1.0), 0.5 * _WEIGHTS


@njit(cache=True, nogil=True)
def movement(
    x: Floats, u: Floats, slope: Floats, s: Floats, x_by: Floats, u_by: Floats, slope_by: Floats
) -> Floats:
    """Return the derivatives (K, 2, P) of the points at beam coordinates `s` (K,).

    `x_by`, `u_by` and `slope_by` (N, P) are those of the nodes x, u, slope (N,).
    """
    columns = u_by.shape[1]
    reached = np.zeros((len(x), columns))  # of the x coordinate in space of each node
    for e in range(len(x) - 1):
        reached[e + 1] = reached[e]
        _lag(reached[e + 1], e, x[e + 1] - x[e], x, u, slope, x_by, u_by, slope_by)
    moves = np.zeros((len(s), 2, columns))
    n, n_by = np.empty(8), np.empty(8)
    for i in range(len(s)):
        e = min(max(np.searchsorted(x, s[i]) - 1, 0), len(x) - 2)
        moves[i, 0] = reached[e]
        _lag(moves[i, 0], e, s[i] - x[e], x, u, slope, x_by, u_by, slope_by)
        hermite(n, s[i] - x[e], x[e + 1] - x[e])
        for p in range(columns):
            moves[i, 1, p] = (
                n[0] * u_by[e, p] + n[1] * slope_by[e, p] + n[2] * u_by[e + 1, p] + n[3] * slope_by[e + 1, p]
            )
            if x_by[e, p] != 0.0 or x_by[e + 1, p] != 0.0:
                hermite_slopes(n_by, s[i] - x[e], x[e + 1] - x[e], -x_by[e, p], x_by[e + 1, p] - x_by[e, p])
                moves[i, 1, p] += (
                    n_by[0] * u[e] + n_by[1] * slope[e] + n_by[2] * u[e + 1] + n_by[3] * slope[e + 1]
                )
    return moves


@njit(cache=True, nogil=True)
def _lag(
    into: Floats, e: int, upto: float, x: Floats, u: Floats, slope: Floats, x_by: Floats, u_by: Floats,
    slope_by: Floats,
) -> None:  # fmt: skip
    """Add the derivative of the integral of cos(atan u') over the first `upto` mm of an element."""
    n, n_by = np.empty(8), np.empty(8)
    length = x[e + 1] - x[e]
    for i in range(len(_NODES)):
        hermite(n, _NODES[i] * upto, length)
        at = n[4] * u[e] + n[5] * slope[e] + n[6] * u[e + 1] + n[7] * slope[e + 1]
        f = -_WEIGHTS[i] * upto * at / (1.0 + at * at) ** 1.5
        for p in range(len(into)):
            change = (
                n[4] * u_by[e, p] + n[5] * slope_by[e, p] + n[6] * u_by[e + 1, p] + n[7] * slope_by[e + 1, p]
            )
            if x_by[e, p] != 0.0 or x_by[e + 1, p] != 0.0:
                hermite_slopes(n_by, _NODES[i] * upto, length, -x_by[e, p], x_by[e + 1, p] - x_by[e, p])
                change += n_by[4] * u[e] + n_by[5] * slope[e] + n_by[6] * u[e + 1] + n_by[7] * slope[e + 1]
            into[p] += f * change
