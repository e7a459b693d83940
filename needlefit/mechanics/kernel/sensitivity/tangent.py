"""The derivatives of the whole shape at one stop, by one tangent system per parameter."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from needlefit.mechanics.kernel.foundation import Foundation
from needlefit.mechanics.kernel.grid import Grid
from needlefit.mechanics.kernel.scalar import CLAMPED, FREE, Chain
from needlefit.mechanics.kernel.sensitivity.derivatives import Columns, Room

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def differentiate_all(
    whole: Floats, room: Room, spots: int, foundation: Foundation, grid: Grid, chain: Chain, state: Floats,
    constraints: Floats, columns: Columns, last: int,
) -> None:  # fmt: skip
    """Fill `whole` (C, 2, P) with the derivatives of every node's deflection and slope."""
    kind, entries, amounts = chain.kind, room.spots, room.amounts
    end = len(chain.front) + last
    for i in range(end + 1):
        for p in range(columns.total):
            whole[i, 0, p] = whole[i, 1, p] = 0.0
    _load(whole, room.points, foundation, grid, chain, state, constraints, columns, last)
    for i in range(end + 1):  # what is prescribed has no equation that could be loaded
        for component in range(kind[i]):  # PINNED: the deflection, CLAMPED: the slope too
            for p in range(columns.total):
                whole[i, component, p] = 0.0
    for n in range(spots):
        whole[entries[n, 0], entries[n, 1], entries[n, 2]] += amounts[n]
    _solve(whole, room.factor, kind, end + 1, columns.total)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, forceinline=True)
def _load(
    whole: Floats, points: Floats, foundation: Foundation, grid: Grid, chain: Chain, state: Floats,
    constraints: Floats, columns: Columns, last: int,
) -> None:  # fmt: skip
    """Put minus the residual's derivatives at a fixed shape into `whole`."""
    first, layer, nearest, shapes = grid.first, grid.layer, grid.constraint, grid.shapes
    mu, friction, rigidity, before = foundation.mu, foundation.friction, chain.rigidity, len(chain.front)
    at_mu, at_alpha, at_friction, at_rigidity = columns.mu, columns.alpha, columns.friction, columns.rigidity
    total, rough = columns.total, foundation.rough or columns.friction >= 0
    for e in range(last + 1):
        a = e + before - 1
        for pair in range(first[e], first[e + 1], 2):  # both points of a piece lie in one layer and cell
            behind, here = nearest[pair], layer[pair]
            for j in range(4):
                at, component = a + j // 2, j % 2
                pull = force = bend = rub = 0.0
                for q in range(pair, pair + 2):
                    n, g = shapes[q, j], 1.0
                    pull += n * points[q, 1]
                    force += n * points[q, 2]
                    if rough:
                        slope = shapes[q, 4] * state[a, 0] + shapes[q, 5] * state[a, 1]
                        slope += shapes[q, 6] * state[a + 1, 0] + shapes[q, 7] * state[a + 1, 1]
                        square = slope * slope / (1.0 + slope * slope)
                        g = 1.0 - friction[here] * square
                        rub -= n * points[q, 2] * square / g
                    bend += n * points[q, 3] * g
                for p in range(total):
                    whole[at, component, p] += pull * constraints[behind, p]
                if at_mu >= 0:
                    whole[at, component, at_mu + here] -= force / mu[here]
                if at_rigidity >= 0:  # in equilibrium the beam's own load is minus the tissue's
                    whole[at, component, at_rigidity] += force / rigidity
                if at_alpha >= 0:
                    whole[at, component, at_alpha + here] -= bend
                if at_friction >= 0:
                    whole[at, component, at_friction + here] -= rub


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, forceinline=True)
def _solve(whole: Floats, factor: Floats, kind: Ints, size: int, columns: int) -> None:
    """Solve K du = load in place, forward and back with the blocks that `scalar.sweep` left."""
    for i in range(size):
        i00, i01, i10, i11 = factor[i, 6], factor[i, 7], factor[i, 8], factor[i, 9]
        k20, k21, k30, k31 = factor[i, 10], factor[i, 11], factor[i, 12], factor[i, 13]
        if i + 1 < size and kind[i + 1] != FREE:  # its equation does not know this node
            k20 = k21 = 0.0
            if kind[i + 1] == CLAMPED:
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
