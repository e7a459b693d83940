"""The derivatives of the tip at one stop, by two adjoint rows."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from needlefit.mechanics.kernel.derivatives import Columns, Here, History, Room
from needlefit.mechanics.kernel.foundation import TERMS, Foundation, Trend, power
from needlefit.mechanics.kernel.scalar import CLAMPED, FREE, Chain

Floats = NDArray[np.float64]


@njit(cache=True, nogil=True, error_model="numpy")
def differentiate_tip(
    room: Room, spots: int, foundation: Foundation, trend: Trend, here: Here, columns: Columns,
    history: History,
) -> None:  # fmt: skip
    """Put the derivatives of the tip's deflection and slope into `history.tip`."""
    rows, tip, by_layer = room.rows, history.tip, room.by_layer
    end = len(here.chain.front) + here.last
    _rows(here.chain, end, room.factor, rows)
    tip[:] = 0.0
    for n in range(spots):
        node, component, column = room.spots[n]
        tip[0, column] += room.amounts[n] * rows[node, component]
        tip[1, column] += room.amounts[n] * rows[node, 2 + component]
    _release(here.chain, end, rows)
    _gather(room, foundation, trend, here, foundation.rough or columns.friction >= 0)
    _carry_over(tip, room.by_constraint, history.constraints, here.cell, columns.count)
    for i in range(len(foundation.mu)):
        for r in range(2):
            force = by_layer[i, r, 0]
            if columns.mu >= 0:
                tip[r, columns.mu + i] -= force / foundation.mu[i]
            if columns.rigidity >= 0:  # in equilibrium the beam's own load is minus the tissue's
                tip[r, columns.rigidity] += force / here.chain.rigidity
            if columns.alpha >= 0:
                tip[r, columns.alpha + i] -= by_layer[i, r, 1]
            if columns.friction >= 0:
                tip[r, columns.friction + i] -= by_layer[i, r, 2]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _rows(chain: Chain, end: int, factor: Floats, rows: Floats) -> None:
    """Solve K^T lam = load from tip to base, for a load on the tip's deflection and one on its slope.

    K is not symmetric where something is prescribed, or with friction. Where something is prescribed lam
    is what the answer gains per unit of the prescribed value.
    """
    kind = chain.kind
    a0, a1, b0, b1 = 1.0, 0.0, 0.0, 1.0  # what arrives at a node
    for i in range(end, -1, -1):
        i00, i01, i10, i11 = factor[i, 6], factor[i, 7], factor[i, 8], factor[i, 9]
        u0, u1 = i00 * a0 + i10 * a1, i01 * a0 + i11 * a1
        v0, v1 = i00 * b0 + i10 * b1, i01 * b0 + i11 * b1
        rows[i, 0], rows[i, 1], rows[i, 2], rows[i, 3] = u0, u1, v0, v1
        if i > 0:
            if kind[i] != FREE:  # its equation does not know the node before
                u0 = v0 = 0.0
                if kind[i] == CLAMPED:
                    u1 = v1 = 0.0
            k20, k21, k30, k31 = factor[i - 1, 10], factor[i - 1, 11], factor[i - 1, 12], factor[i - 1, 13]
            a0, a1 = -(k20 * u0 + k30 * u1), -(k21 * u0 + k31 * u1)
            b0, b1 = -(k20 * v0 + k30 * v1), -(k21 * v0 + k31 * v1)


@njit(cache=True, nogil=True)
def _release(chain: Chain, end: int, rows: Floats) -> None:
    """Let rows weigh loads: what is prescribed takes none."""
    for i in range(end + 1):
        if chain.kind[i] != FREE:
            rows[i, 0] = rows[i, 2] = 0.0
            if chain.kind[i] == CLAMPED:
                rows[i, 1] = rows[i, 3] = 0.0


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _gather(room: Room, foundation: Foundation, trend: Trend, here: Here, rough: bool) -> None:
    """Sum rows times loads over the quadrature, by constraint point and by layer.

    Scalars and plain loops, as in `scalar.sweep`, for the same reason.
    """
    grid, state, y = here.grid, here.state, here.y
    first, weight, layer, nearest, shapes = grid.first, grid.weight, grid.layer, grid.constraint, grid.shapes
    mu, coefficients, exponents = foundation.mu, foundation.coefficients, foundation.exponents
    thickness, friction = foundation.thickness, foundation.friction
    series, limit = foundation.series, foundation.limit
    by_alpha, by_coefficient, by_exponent = trend.series, trend.coefficients, trend.exponents
    rows, by_constraint, by_layer = room.rows, room.by_constraint, room.by_layer
    by_constraint[: here.cell + 1] = 0.0
    by_layer[:] = 0.0
    before = len(here.chain.front)
    for e in range(here.last + 1):
        i = e + before - 1
        a0, a1, b0, b1 = state[i, 0], state[i, 1], state[i + 1, 0], state[i + 1, 1]
        u0, u1, u2, u3 = rows[i, 0], rows[i, 1], rows[i + 1, 0], rows[i + 1, 1]
        v0, v1, v2, v3 = rows[i, 2], rows[i, 3], rows[i + 1, 2], rows[i + 1, 3]
        for pair in range(first[e], first[e + 1], 2):  # both points of a piece lie in the same layer and cell
            behind, lies = nearest[pair], layer[pair]
            c = y[behind]
            pull_u = pull_v = force_u = force_v = bend_u = bend_v = rub_u = rub_v = 0.0
            for q in range(pair, pair + 2):
                n0, n1, n2, n3 = shapes[q, 0], shapes[q, 1], shapes[q, 2], shapes[q, 3]
                away = n0 * a0 + n1 * a1 + n2 * b0 + n3 * b1 - c
                w = weight[q]
                in_u = w * (n0 * u0 + n1 * u1 + n2 * u2 + n3 * u3)
                in_v = w * (n0 * v0 + n1 * v1 + n2 * v2 + n3 * v3)
                size = abs(away)
                k = tangent = bend = 0.0
                if size <= limit[lies]:
                    for j in range(TERMS - 1, -1, -1):
                        k = k * size + series[lies, j]
                        tangent = tangent * size + (j + 1) * series[lies, j]
                        bend = bend * size + by_alpha[lies, j]
                else:
                    d = size / thickness[lies]
                    stretch = np.log1p(-d)
                    for p in range(exponents.shape[1]):
                        part, tangent_part = power(exponents[lies, p], d)
                        k += mu[lies] * coefficients[lies, p] * part
                        tangent += mu[lies] * coefficients[lies, p] * tangent_part
                        grows = by_coefficient[p] + coefficients[lies, p] * by_exponent[p] * stretch
                        bend += mu[lies] * grows * part
                if rough:
                    m0, m1, m2, m3 = shapes[q, 4], shapes[q, 5], shapes[q, 6], shapes[q, 7]
                    slope = m0 * a0 + m1 * a1 + m2 * b0 + m3 * b1
                    square = slope * slope / (1.0 + slope * slope)
                    rub_u -= in_u * k * away * square
                    rub_v -= in_v * k * away * square
                    g = 1.0 - friction[lies] * square
                    in_u *= g
                    in_v *= g
                pull_u += in_u * tangent
                pull_v += in_v * tangent
                force_u += in_u * k * away
                force_v += in_v * k * away
                bend_u += in_u * bend * away
                bend_v += in_v * bend * away
            by_constraint[behind, 0] += pull_u
            by_constraint[behind, 1] += pull_v
            by_layer[lies, 0, 0] += force_u
            by_layer[lies, 1, 0] += force_v
            by_layer[lies, 0, 1] += bend_u
            by_layer[lies, 1, 1] += bend_v
            by_layer[lies, 0, 2] += rub_u
            by_layer[lies, 1, 2] += rub_v


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _carry_over(tip: Floats, pull: Floats, constraints: Floats, cell: int, columns: int) -> None:
    """Add what the constraint points' own derivatives do to the tip."""
    for m in range(cell + 1):
        u, v = pull[m, 0], pull[m, 1]
        for p in range(columns):
            tip[0, p] += u * constraints[m, p]
            tip[1, p] += v * constraints[m, p]
