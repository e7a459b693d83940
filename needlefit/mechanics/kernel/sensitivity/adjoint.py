"""The derivatives of the tip at one stop, by two adjoint rows."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from needlefit.mechanics.kernel.foundation import TERMS, Foundation, Trend, steepen
from needlefit.mechanics.kernel.grid import Grid
from needlefit.mechanics.kernel.scalar import CLAMPED, FREE
from needlefit.mechanics.kernel.sensitivity.derivatives import SUMS, Room

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, forceinline=True)
def solve_rows(kind: Ints, end: int, factor: Floats, rows: Floats, held: Floats) -> None:
    """Solve K^T lam = load from tip to base, for a load on the tip's deflection and one on its slope.

    K is not symmetric where something is prescribed, or with friction. Where something is prescribed lam is
    what the answer gains per unit of it, and weighs no load.
    """
    a0, a1, b0, b1 = 1.0, 0.0, 0.0, 1.0  # what arrives at a node
    for i in range(end, -1, -1):
        i00, i01, i10, i11 = factor[i, 6], factor[i, 7], factor[i, 8], factor[i, 9]
        u0, u1 = i00 * a0 + i10 * a1, i01 * a0 + i11 * a1
        v0, v1 = i00 * b0 + i10 * b1, i01 * b0 + i11 * b1
        if kind[i] != FREE:
            held[i, 0], held[i, 1], held[i, 2], held[i, 3] = u0, u1, v0, v1
            u0 = v0 = 0.0
            if kind[i] == CLAMPED:
                u1 = v1 = 0.0
        rows[i, 0], rows[i, 1], rows[i, 2], rows[i, 3] = u0, u1, v0, v1
        if i > 0:
            k20, k21, k30, k31 = factor[i - 1, 10], factor[i - 1, 11], factor[i - 1, 12], factor[i - 1, 13]
            a0, a1 = -(k20 * u0 + k30 * u1), -(k21 * u0 + k31 * u1)
            b0, b1 = -(k20 * v0 + k30 * v1), -(k21 * v0 + k31 * v1)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, forceinline=True)
def bend(points: Floats, foundation: Foundation, trend: Trend, grid: Grid, last: int) -> None:
    """Put weight times dk/dalpha e of each quadrature point into the last column of `points`."""
    weight, layer, limit, series = grid.weight, grid.layer, trend.limit, trend.series
    for q in range(grid.first[last + 1]):
        here, away = layer[q], points[q, 0]
        size = abs(away)
        slope = 0.0
        if size <= limit[here]:
            for j in range(TERMS - 1, -1, -1):
                slope = slope * size + series[here, j]
        else:
            slope = steepen(foundation, trend, here, size)
        points[q, 3] = weight[q] * slope * away


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, forceinline=True)
def gather(
    rows: Floats, points: Floats, by_constraint: Floats, by_layer: Floats, foundation: Foundation,
    grid: Grid, state: Floats, before: int, last: int, cell: int, rough: bool,
) -> None:  # fmt: skip
    """Sum rows times loads over the quadrature, by constraint point and by layer.

    Scalars and plain loops, as in `scalar.sweep`, for the same reason.
    """
    first, layer, nearest, shapes = grid.first, grid.layer, grid.constraint, grid.shapes
    friction = foundation.friction
    for m in range(cell + 1):
        by_constraint[m, 0] = by_constraint[m, 1] = 0.0
    for m in range(len(friction)):
        for j in range(SUMS):
            by_layer[m, 0, j] = by_layer[m, 1, j] = 0.0
    for e in range(last + 1):
        i = e + before - 1
        u0, u1, u2, u3 = rows[i, 0], rows[i, 1], rows[i + 1, 0], rows[i + 1, 1]
        v0, v1, v2, v3 = rows[i, 2], rows[i, 3], rows[i + 1, 2], rows[i + 1, 3]
        for pair in range(first[e], first[e + 1], 2):  # both points of a piece lie in one layer and cell
            behind, here = nearest[pair], layer[pair]
            pull_u = pull_v = force_u = force_v = bend_u = bend_v = rub_u = rub_v = 0.0
            for q in range(pair, pair + 2):
                n0, n1, n2, n3 = shapes[q, 0], shapes[q, 1], shapes[q, 2], shapes[q, 3]
                pull, force = points[q, 1], points[q, 2]
                at_u = n0 * u0 + n1 * u1 + n2 * u2 + n3 * u3
                at_v = n0 * v0 + n1 * v1 + n2 * v2 + n3 * v3
                pull_u += at_u * pull
                pull_v += at_v * pull
                force_u += at_u * force
                force_v += at_v * force
                g = 1.0
                if rough:
                    m0, m1, m2, m3 = shapes[q, 4], shapes[q, 5], shapes[q, 6], shapes[q, 7]
                    slope = m0 * state[i, 0] + m1 * state[i, 1] + m2 * state[i + 1, 0] + m3 * state[i + 1, 1]
                    square = slope * slope / (1.0 + slope * slope)
                    g = 1.0 - friction[here] * square
                    rub_u -= at_u * force * square / g
                    rub_v -= at_v * force * square / g
                bend = points[q, 3] * g
                bend_u += at_u * bend
                bend_v += at_v * bend
            by_constraint[behind, 0] += pull_u
            by_constraint[behind, 1] += pull_v
            by_layer[here, 0, 0] += force_u
            by_layer[here, 1, 0] += force_v
            by_layer[here, 0, 1] += bend_u
            by_layer[here, 1, 1] += bend_v
            by_layer[here, 0, 2] += rub_u
            by_layer[here, 1, 2] += rub_v


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, forceinline=True)
def carry_over(tip: Floats, pull: Floats, constraints: Floats, cell: int, columns: int) -> None:
    """Put what the constraint points' own derivatives do to the tip into `tip` (2, P)."""
    for p in range(columns):
        tip[0, p] = tip[1, p] = 0.0
    for m in range(cell + 1):
        u, v = pull[m, 0], pull[m, 1]
        for p in range(columns):
            tip[0, p] += u * constraints[m, p]
            tip[1, p] += v * constraints[m, p]


@njit(cache=True, nogil=True, error_model="numpy")
def add_layers(
    tip: Floats, by_layer: Floats, mu: Floats, rigidity: float, at_mu: int, at_alpha: int, at_friction: int,
    at_rigidity: int,
) -> None:  # fmt: skip
    """Add to `tip` what the layers' own numbers and the needle's do, given the columns where each begins."""
    for i in range(len(mu)):
        for r in range(2):
            force = by_layer[i, r, 0]
            if at_mu >= 0:
                tip[r, at_mu + i] -= force / mu[i]
            if at_rigidity >= 0:  # in equilibrium the beam's own load is minus the tissue's
                tip[r, at_rigidity] += force / rigidity
            if at_alpha >= 0:
                tip[r, at_alpha + i] -= by_layer[i, r, 1]
            if at_friction >= 0:
                tip[r, at_friction + i] -= by_layer[i, r, 2]


@njit(cache=True, nogil=True, error_model="numpy")
def add_spots(tip: Floats, room: Room, spots: int, kind: Ints) -> None:
    """Add to `tip` what the listed right-hand sides do."""
    for n in range(spots):
        node, component, column = room.spots[n, 0], room.spots[n, 1], room.spots[n, 2]
        weigh = room.held if kind[node] > component else room.rows
        tip[0, column] += room.amounts[n] * weigh[node, component]
        tip[1, column] += room.amounts[n] * weigh[node, 2 + component]
