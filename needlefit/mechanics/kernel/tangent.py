"""The derivatives of the whole shape at one stop, by one tangent system per parameter."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from needlefit.mechanics.kernel.derivatives import Columns, Here, History, Room
from needlefit.mechanics.kernel.foundation import Foundation, Trend, power
from needlefit.mechanics.kernel.scalar import CLAMPED, FREE, Chain

Floats = NDArray[np.float64]


@njit(cache=True, nogil=True, error_model="numpy")
def differentiate_all(
    whole: Floats, room: Room, spots: int, foundation: Foundation, trend: Trend, here: Here,
    columns: Columns, history: History,
) -> None:  # fmt: skip
    """Fill `whole` (C, 2, P) with the derivatives of every node's deflection and slope."""
    end = len(here.chain.front) + here.last
    whole[: end + 1] = 0.0
    _load(whole, foundation, trend, here, columns, history.constraints)
    for i in range(end + 1):  # what is prescribed has no equation that could be loaded
        if here.chain.kind[i] != FREE:
            whole[i, 0] = 0.0
            if here.chain.kind[i] == CLAMPED:
                whole[i, 1] = 0.0
    for n in range(spots):
        node, component, column = room.spots[n]
        whole[node, component, column] += room.amounts[n]
    _solve(whole, room.factor, here.chain, end + 1, columns.count)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _load(
    whole: Floats, foundation: Foundation, trend: Trend, here: Here, columns: Columns, constraints: Floats
) -> None:
    """Put minus the residual's derivatives at a fixed shape into `whole`."""
    grid, state, y, shapes = here.grid, here.state, here.y, here.grid.shapes
    mu, exponents, coefficients = foundation.mu, foundation.exponents, foundation.coefficients
    before = len(here.chain.front)
    for e in range(here.last + 1):
        a = e + before - 1
        for q in range(grid.first[e], grid.first[e + 1]):
            lies, behind = grid.layer[q], grid.constraint[q]
            u = slope = 0.0
            for j in range(4):
                u += shapes[q, j] * state[a + j // 2, j % 2]
                slope += shapes[q, 4 + j] * state[a + j // 2, j % 2]
            away = u - y[behind]
            d = abs(away) / foundation.thickness[lies]
            stretch = np.log1p(-d)
            k = tangent = bend = 0.0
            for p in range(exponents.shape[1]):
                part, tangent_part = power(exponents[lies, p], d)
                k += mu[lies] * coefficients[lies, p] * part
                tangent += mu[lies] * coefficients[lies, p] * tangent_part
                grows = trend.coefficients[p] + coefficients[lies, p] * trend.exponents[p] * stretch
                bend += mu[lies] * grows * part
            square = slope * slope / (1.0 + slope * slope)
            g = 1.0 - foundation.friction[lies] * square
            w = grid.weight[q]
            for j in range(4):
                at, component = a + j // 2, j % 2
                n = w * shapes[q, j]
                force = n * k * away
                for p in range(columns.count):
                    whole[at, component, p] += n * tangent * g * constraints[behind, p]
                if columns.mu >= 0:
                    whole[at, component, columns.mu + lies] -= force * g / mu[lies]
                if columns.rigidity >= 0:  # in equilibrium the beam's own load is minus the tissue's
                    whole[at, component, columns.rigidity] += force * g / here.chain.rigidity
                if columns.alpha >= 0:
                    whole[at, component, columns.alpha + lies] -= n * bend * away * g
                if columns.friction >= 0:
                    whole[at, component, columns.friction + lies] += force * square


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _solve(whole: Floats, factor: Floats, chain: Chain, size: int, columns: int) -> None:
    """Solve K du = load in place, forward and back with the blocks that `scalar.sweep` left."""
    for i in range(size):
        i00, i01, i10, i11 = factor[i, 6], factor[i, 7], factor[i, 8], factor[i, 9]
        k20, k21, k30, k31 = factor[i, 10], factor[i, 11], factor[i, 12], factor[i, 13]
        if i + 1 < size and chain.kind[i + 1] != FREE:  # its equation does not know this node
            k20 = k21 = 0.0
            if chain.kind[i + 1] == CLAMPED:
                k30 = k31 = 0.0
        for p in range(columns):
            r0, r1 = whole[i, 0, p], whole[i, 1, p]
            z0, z1 = i00 * r0 + i01 * r1, i10 * r0 + i11 * r1
            whole[i, 0, p], whole[i, 1, p] = z0, z1
            if i + 1 < size:
                whole[i + 1, 0, p] -= k20 * z0 + k21 * z1
                whole[i + 1, 1, p] -= k30 * z0 + k31 * z1
    for i in range(size - 2, -1, -1):
        g00, g01, g10, g11 = factor[i, 0], factor[i, 1], factor[i, 2], factor[i, 3]
        for p in range(columns):
            u, slope = whole[i + 1, 0, p], whole[i + 1, 1, p]
            whole[i, 0, p] -= g00 * u + g01 * slope
            whole[i, 1, p] -= g10 * u + g11 * slope
