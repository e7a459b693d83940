"""Solve for the derivatives of one stop: of the tip by two adjoint rows, of the whole shape by tangent
systems.

At all stops but the last only the tip's derivatives are needed: two adjoint solves, however many
parameters.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from needlefit.mechanics.kernel.foundation import (
    SERIES_TERMS,
    AlphaDerivative,
    Foundation,
    stiffness_alpha_derivative,
)
from needlefit.mechanics.kernel.grid import NodeGrid
from needlefit.mechanics.kernel.parameter_loads import LAYER_SUMS, AdjointWorkspace, DerivativeColumns
from needlefit.mechanics.kernel.scalar import CLAMPED, FREE, Chain

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, forceinline=True)
def solve_adjoint(kind: Ints, end: int, factor: Floats, rows: Floats, prescribed_rows: Floats) -> None:
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
            prescribed_rows[i, 0], prescribed_rows[i, 1], prescribed_rows[i, 2], prescribed_rows[i, 3] = (
                u0,
                u1,
                v0,
                v1,
            )
            u0 = v0 = 0.0
            if kind[i] == CLAMPED:
                u1 = v1 = 0.0
        rows[i, 0], rows[i, 1], rows[i, 2], rows[i, 3] = u0, u1, v0, v1
        if i > 0:
            k20, k21, k30, k31 = factor[i - 1, 10], factor[i - 1, 11], factor[i - 1, 12], factor[i - 1, 13]
            a0, a1 = -(k20 * u0 + k30 * u1), -(k21 * u0 + k31 * u1)
            b0, b1 = -(k20 * v0 + k30 * v1), -(k21 * v0 + k31 * v1)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, forceinline=True)
def fill_alpha_loads(
    points: Floats, foundation: Foundation, alpha_derivative: AlphaDerivative, grid: NodeGrid, last: int
) -> None:
    """Put weight times dk/dalpha e of each quadrature point into the last column of `points`."""
    weight, layer, limit, series = grid.weight, grid.layer, alpha_derivative.limit, alpha_derivative.series
    for q in range(grid.first[last + 1]):
        here, away = layer[q], points[q, 0]
        size = abs(away)
        slope = 0.0
        if size <= limit[here]:
            for j in range(SERIES_TERMS - 1, -1, -1):
                slope = slope * size + series[here, j]
        else:
            slope = stiffness_alpha_derivative(foundation, alpha_derivative, here, size)
        points[q, 3] = weight[q] * slope * away


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, forceinline=True)
def sum_adjoint_loads(
    rows: Floats, points: Floats, by_constraint: Floats, by_layer: Floats, foundation: Foundation,
    grid: NodeGrid, state: Floats, before: int, last: int, cell: int, has_friction: bool,
) -> None:  # fmt: skip
    """Sum rows times loads over the quadrature, by constraint point and by layer.

    Scalars and plain loops, as in `scalar.sweep`, for the same reason.
    """
    first, layer, nearest, shapes = grid.first, grid.layer, grid.constraint, grid.shapes
    friction = foundation.friction
    for m in range(cell + 1):
        by_constraint[m, 0] = by_constraint[m, 1] = 0.0
    for m in range(len(friction)):
        for j in range(LAYER_SUMS):
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
                if has_friction:
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
def start_from_constraints(tip: Floats, pull: Floats, constraints: Floats, cell: int, columns: int) -> None:
    """Put what the constraint points' own derivatives do to the tip into `tip` (2, P)."""
    for p in range(columns):
        tip[0, p] = tip[1, p] = 0.0
    for m in range(cell + 1):
        u, v = pull[m, 0], pull[m, 1]
        for p in range(columns):
            tip[0, p] += u * constraints[m, p]
            tip[1, p] += v * constraints[m, p]


@njit(cache=True, nogil=True, error_model="numpy")
def add_layer_derivatives(
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
def add_entry_derivatives(tip: Floats, workspace: AdjointWorkspace, load_entries: int, kind: Ints) -> None:
    """Add to `tip` what the listed right-hand sides do."""
    for n in range(load_entries):
        node, component, column = (
            workspace.load_entries[n, 0],
            workspace.load_entries[n, 1],
            workspace.load_entries[n, 2],
        )
        weigh = workspace.prescribed_rows if kind[node] > component else workspace.rows
        tip[0, column] += workspace.amounts[n] * weigh[node, component]
        tip[1, column] += workspace.amounts[n] * weigh[node, 2 + component]


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def differentiate_shape(
    whole: Floats, workspace: AdjointWorkspace, load_entries: int, foundation: Foundation, grid: NodeGrid,
    chain: Chain, state: Floats, constraints: Floats, columns: DerivativeColumns, last: int,
) -> None:  # fmt: skip
    """Fill `whole` (C, 2, P) with the derivatives of every node's deflection and slope."""
    kind, entries, amounts = chain.kind, workspace.load_entries, workspace.amounts
    end = len(chain.front) + last
    for i in range(end + 1):
        for p in range(columns.total):
            whole[i, 0, p] = whole[i, 1, p] = 0.0
    _fill_loads(whole, workspace.points, foundation, grid, chain, state, constraints, columns, last)
    for i in range(end + 1):  # what is prescribed has no equation that could be loaded
        for component in range(kind[i]):  # PINNED: the deflection, CLAMPED: the slope too
            for p in range(columns.total):
                whole[i, component, p] = 0.0
    for n in range(load_entries):
        whole[entries[n, 0], entries[n, 1], entries[n, 2]] += amounts[n]
    _solve_tangents(whole, workspace.factor, kind, end + 1, columns.total)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, forceinline=True)
def _fill_loads(
    whole: Floats, points: Floats, foundation: Foundation, grid: NodeGrid, chain: Chain, state: Floats,
    constraints: Floats, columns: DerivativeColumns, last: int,
) -> None:  # fmt: skip
    """Put minus the residual's derivatives at a fixed shape into `whole`."""
    first, layer, nearest, shapes = grid.first, grid.layer, grid.constraint, grid.shapes
    mu, friction, rigidity, before = foundation.mu, foundation.friction, chain.rigidity, len(chain.front)
    at_mu, at_alpha, at_friction, at_rigidity = columns.mu, columns.alpha, columns.friction, columns.rigidity
    total, has_friction = columns.total, foundation.has_friction or columns.friction >= 0
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
                    if has_friction:
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
def _solve_tangents(whole: Floats, factor: Floats, kind: Ints, size: int, columns: int) -> None:
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
