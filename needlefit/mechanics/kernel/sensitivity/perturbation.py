"""How the residual of one stop changes when a layer boundary or a guide moves along the needle.

Both move quadrature points and weights, and a guide also its node and so the two elements beside it. What is
differentiated is the discrete residual itself, quadrature and all, so that the derivative belongs exactly to
the shape that the kernel computes.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from needlefit.mechanics.kernel.foundation import Foundation, drag, power
from needlefit.mechanics.kernel.grid import GAUSS, Grid
from needlefit.mechanics.kernel.hermite import hermite
from needlefit.mechanics.kernel.scalar import Chain

Floats = NDArray[np.float64]


@njit(cache=True, nogil=True)
def reaction(foundation: Foundation, layer: int, away: float, slope: float) -> tuple[float, float, float]:
    """Return the force k e g per length at a point, and its derivatives with respect to e and u'."""
    d = abs(away) / foundation.thickness[layer]
    k = tangent = 0.0
    for p in range(foundation.exponents.shape[1]):
        part, tangent_part = power(foundation.exponents[layer, p], d)
        k += foundation.mu[layer] * foundation.coefficients[layer, p] * part
        tangent += foundation.mu[layer] * foundation.coefficients[layer, p] * tangent_part
    g, g_slope = drag(foundation.friction[layer], slope)
    return k * away * g, tangent * g, k * away * g_slope


@njit(cache=True, nogil=True)
def node_load(
    load: Floats, i: int, state: Floats, chain: Chain, foundation: Foundation, grid: Grid, y: Floats
) -> None:
    """Fill `load` (3, 2) with d(residual)/dx of the chain's node `i`, for the nodes i - 1, i and i + 1."""
    _empty(load)
    before = len(chain.front)
    for side in range(2):  # the element that ends at the node grows, the one that begins there shrinks
        a = i - 1 + side
        start = chain.front[a] if a < before else grid.nodes[a - before]
        stop = chain.front[a + 1] if a + 1 < before else grid.nodes[a + 1 - before]
        _bend(load, side, state, a, chain.rigidity, stop - start, 1.0 - 2.0 * side)
        e = a + 1 - before
        if e < 0:
            continue
        begin, end = grid.first[e], grid.first[e + 1]
        for q in range(begin, end):
            # only the piece of quadrature that touches a node in the tissue moves with it
            second = (q - begin) % 2
            drift = gain = 0.0
            if i >= before and side == 0 and q >= end - 2:
                drift, gain = 0.5 + (2 * second - 1) * GAUSS, 0.5
            elif i >= before and side == 1 and q < begin + 2:
                drift, gain = 0.5 - (2 * second - 1) * GAUSS, -0.5
            _point(
                load, side, state, a, foundation, y[grid.constraint[q]], grid.layer[q], grid.x[q] - start,
                stop - start, grid.weight[q], drift - side, 1.0 - 2.0 * side, gain,
            )  # fmt: skip


@njit(cache=True, nogil=True)
def boundary_load(
    load: Floats, b: int, depth: float, state: Floats, chain: Chain, foundation: Foundation, grid: Grid,
    y: Floats,
) -> int:  # fmt: skip
    """Fill `load` (3, 2) with d(residual)/d(depth) of boundary `b` between layers b and b + 1.

    Where the boundary lies on a node or on a change of constraint the derivative is that toward greater
    depth.

    Returns
    -------
    int
        The chain's node to which the first row of `load` belongs.
    """
    _empty(load)
    right = int(np.searchsorted(grid.x, depth))  # pieces end at boundaries: the first point beyond
    e = int(np.searchsorted(grid.first, right, side="right")) - 1
    before = len(chain.front)
    a = e - 1 + before
    start = chain.front[a] if a < before else grid.nodes[a - before]
    length = grid.nodes[e] - start
    c = y[grid.constraint[right]]
    left = right - 2
    if (
        left >= grid.first[e]
        and grid.layer[left] == b
        and grid.constraint[left] == grid.constraint[right]
        and grid.x[left] > 0.0
    ):
        for j in range(2):
            _point(
                load, 0, state, a, foundation, c, b, grid.x[left + j] - start, length, grid.weight[left + j],
                0.5 + (2 * j - 1) * GAUSS, 0.0, 0.5,
            )  # fmt: skip
    else:
        _point(load, 0, state, a, foundation, c, b, depth - start, length, 0.0, 0.0, 0.0, 1.0)
    if grid.layer[right] == b + 1:
        for j in range(2):
            _point(
                load, 0, state, a, foundation, c, b + 1, grid.x[right + j] - start, length,
                grid.weight[right + j], 0.5 - (2 * j - 1) * GAUSS, 0.0, -0.5,
            )  # fmt: skip
    else:  # a layer without extent
        _point(load, 0, state, a, foundation, c, b + 1, depth - start, length, 0.0, 0.0, 0.0, -1.0)
    return a


@njit(cache=True, nogil=True)
def _empty(load: Floats) -> None:
    for i in range(3):
        load[i, 0] = load[i, 1] = 0.0


@njit(cache=True, nogil=True)
def _bend(load: Floats, at: int, state: Floats, a: int, rigidity: float, length: float, grows: float) -> None:
    """Add d(K_b u) of the element from node `a` on, whose length grows so."""
    u0, t0, u1, t1 = state[a, 0], state[a, 1], state[a + 1, 0], state[a + 1, 1]
    f = -grows * rigidity / length**2
    shear = f * (36.0 * (u0 - u1) / length**2 + 12.0 * (t0 + t1) / length)
    load[at, 0] += shear
    load[at + 1, 0] -= shear
    turn = f * 12.0 * (u0 - u1) / length
    load[at, 1] += turn + f * (4.0 * t0 + 2.0 * t1)
    load[at + 1, 1] += turn + f * (2.0 * t0 + 4.0 * t1)


@njit(cache=True, nogil=True)
def _point(
    load: Floats, at: int, state: Floats, a: int, foundation: Foundation, c: float, layer: int,
    x: float, length: float, weight: float, drift: float, grows: float, gain: float,
) -> None:  # fmt: skip
    """Add d(w k e g N) of a quadrature point `x` mm into the element from node `a` on.

    Per unit of what moves, x grows by `drift`, the element's length by `grows`, the weight by `gain`.
    """
    n, n_by = np.empty(8), np.empty(8)
    hermite(n, x, length)
    hermite_slopes(n_by, x, length, drift, grows)
    u = slope = u_by = slope_by = 0.0
    for j in range(4):
        value = state[a + j // 2, j % 2]
        u += n[j] * value
        slope += n[4 + j] * value
        u_by += n_by[j] * value
        slope_by += n_by[4 + j] * value
    force, by_e, by_slope = reaction(foundation, layer, u - c, slope)
    force_by = by_e * u_by + by_slope * slope_by
    for j in range(4):
        load[at + j // 2, j % 2] += (gain * force + weight * force_by) * n[j] + weight * force * n_by[j]


@njit(cache=True, nogil=True)
def hermite_slopes(row: Floats, x: float, length: float, drift: float, grows: float) -> None:
    """Fill `row` (8,) with the change of what `hermite` gives as x and length change at these rates."""
    s = x / length
    row[0] = drift * -6.0 * s * (1.0 - s) / length + grows * 6.0 * s * s * (1.0 - s) / length
    row[1] = drift * (1.0 - s) * (1.0 - 3.0 * s) + grows * 2.0 * s * s * (1.0 - s)
    row[2] = -row[0]
    row[3] = drift * s * (3.0 * s - 2.0) + grows * s * s * (1.0 - 2.0 * s)
    row[4] = drift * (12.0 * s - 6.0) / length**2 + grows * 6.0 * s * (2.0 - 3.0 * s) / length**2
    row[5] = (drift * (6.0 * s - 4.0) + grows * s * (4.0 - 6.0 * s)) / length
    row[6] = -row[4]
    row[7] = (drift * (6.0 * s - 2.0) + grows * s * (2.0 - 6.0 * s)) / length
