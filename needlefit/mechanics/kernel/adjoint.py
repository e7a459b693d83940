"""Solve for the derivatives of one stop: of the tip by two adjoint rows, of the whole shape by tangent
systems.

At all stops but the last only the tip's derivatives are needed: two adjoint solves serve any number of
parameters.
"""

from numba import njit

from needlefit.arrays import Floats, Ints
from needlefit.mechanics.kernel.foundation import (
    SERIES_TERMS,
    AlphaDerivative,
    Foundation,
    stiffness_alpha_derivative,
)
from needlefit.mechanics.kernel.grid import NodeGrid
from needlefit.mechanics.kernel.parameter_loads import (
    LAYER_ALPHA,
    LAYER_FORCE,
    LAYER_FRICTION,
    LAYER_SUMS,
    AdjointWorkspace,
    DerivativeColumns,
)
from needlefit.mechanics.kernel.scalar import (
    CLAMPED,
    FREE,
    G00,
    G01,
    G10,
    G11,
    INV00,
    INV01,
    INV10,
    INV11,
    K20,
    K21,
    K30,
    K31,
    POINT_ALPHA,
    POINT_E,
    POINT_FORCE,
    POINT_TANGENT,
    Chain,
)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, forceinline=True)
def solve_adjoint(kind: Ints, end: int, factor: Floats, rows: Floats, prescribed_rows: Floats) -> None:
    """Solve K^T lam = load from tip to base, for a load on the tip's deflection and one on its slope.

    K is not symmetric where something is prescribed, or with friction. At a prescribed value, lam is the
    derivative of the tip with respect to that value; it multiplies no load.
    """
    a0, a1, b0, b1 = 1.0, 0.0, 0.0, 1.0  # what arrives at a node
    for i in range(end, -1, -1):
        i00, i01, i10, i11 = factor[i, INV00], factor[i, INV01], factor[i, INV10], factor[i, INV11]
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
            k20, k21 = factor[i - 1, K20], factor[i - 1, K21]
            k30, k31 = factor[i - 1, K30], factor[i - 1, K31]
            a0, a1 = -(k20 * u0 + k30 * u1), -(k21 * u0 + k31 * u1)
            b0, b1 = -(k20 * v0 + k30 * v1), -(k21 * v0 + k31 * v1)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, forceinline=True)
def fill_alpha_loads(
    points: Floats, foundation: Foundation, alpha_derivative: AlphaDerivative, grid: NodeGrid, last: int
) -> None:
    """Fill column POINT_ALPHA of `points` with weight times dk/dalpha e of each quadrature point."""
    weight, layer, limit, series = grid.weight, grid.layer, alpha_derivative.limit, alpha_derivative.series
    for q in range(grid.first[last + 1]):
        here, away = layer[q], points[q, POINT_E]
        size = abs(away)
        slope = 0.0
        if size <= limit[here]:
            for j in range(SERIES_TERMS - 1, -1, -1):
                slope = slope * size + series[here, j]
        else:
            slope = stiffness_alpha_derivative(foundation, alpha_derivative, here, size)
        points[q, POINT_ALPHA] = weight[q] * slope * away


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, forceinline=True)
def sum_adjoint_loads(
    rows: Floats, points: Floats, by_constraint: Floats, by_layer: Floats, foundation: Foundation,
    grid: NodeGrid, state: Floats, before: int, last: int, cell: int, has_friction: bool,
) -> None:  # fmt: skip
    """Sum adjoint rows times loads over the quadrature points, by constraint point and by layer.

    Scalars and plain loops, as in `scalar.sweep_forward`, for the same reason.
    """
    first, layer, nearest, shapes = grid.first, grid.layer, grid.constraint, grid.shapes
    other, share, friction = grid.other, grid.share, foundation.friction
    linear = len(grid.rate) > 0 and grid.rate[0] != 0.0
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
            pull_u = pull_v = force_u = force_v = bend_u = bend_v = rub_u = rub_v = far_u = far_v = 0.0
            for q in range(pair, pair + 2):
                n0, n1, n2, n3 = shapes[q, 0], shapes[q, 1], shapes[q, 2], shapes[q, 3]
                pull, force = points[q, POINT_TANGENT], points[q, POINT_FORCE]
                at_u = n0 * u0 + n1 * u1 + n2 * u2 + n3 * u3
                at_v = n0 * v0 + n1 * v1 + n2 * v2 + n3 * v3
                pull_u += at_u * pull
                pull_v += at_v * pull
                if linear:
                    far_u += at_u * pull * share[q]
                    far_v += at_v * pull * share[q]
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
                bend = points[q, POINT_ALPHA] * g
                bend_u += at_u * bend
                bend_v += at_v * bend
            by_constraint[behind, 0] += pull_u - far_u
            by_constraint[behind, 1] += pull_v - far_v
            if linear:
                by_constraint[other[pair], 0] += far_u
                by_constraint[other[pair], 1] += far_v
            by_layer[here, 0, LAYER_FORCE] += force_u
            by_layer[here, 1, LAYER_FORCE] += force_v
            by_layer[here, 0, LAYER_ALPHA] += bend_u
            by_layer[here, 1, LAYER_ALPHA] += bend_v
            by_layer[here, 0, LAYER_FRICTION] += rub_u
            by_layer[here, 1, LAYER_FRICTION] += rub_v


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, forceinline=True)
def start_from_constraints(tip: Floats, pull: Floats, constraints: Floats, cell: int, columns: int) -> None:
    """Set `tip` (2, P) to the contribution of the constraint points' own derivatives."""
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
    """Add to `tip` the derivatives with respect to the layers' parameters and the needle's rigidity.

    `at_mu` and the others are the first column of each kind; -1: not wanted.
    """
    for i in range(len(mu)):
        for r in range(2):
            force = by_layer[i, r, LAYER_FORCE]
            if at_mu >= 0:
                tip[r, at_mu + i] -= force / mu[i]
            if at_rigidity >= 0:  # in equilibrium the beam's own load is minus the tissue's
                tip[r, at_rigidity] += force / rigidity
            if at_alpha >= 0:
                tip[r, at_alpha + i] -= by_layer[i, r, LAYER_ALPHA]
            if at_friction >= 0:
                tip[r, at_friction + i] -= by_layer[i, r, LAYER_FRICTION]


@njit(cache=True, nogil=True, error_model="numpy")
def add_entry_derivatives(tip: Floats, workspace: AdjointWorkspace, load_entries: int, kind: Ints) -> None:
    """Add to `tip` the contribution of the listed right-hand sides."""
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
    other, share = grid.other, grid.share
    mu, friction, rigidity, before = foundation.mu, foundation.friction, chain.rigidity, len(chain.front)
    at_mu, at_alpha, at_friction, at_rigidity = columns.mu, columns.alpha, columns.friction, columns.rigidity
    total, has_friction = columns.total, foundation.has_friction or columns.friction >= 0
    for e in range(last + 1):
        a = e + before - 1
        for pair in range(first[e], first[e + 1], 2):  # both points of a piece lie in one layer and cell
            behind, here = nearest[pair], layer[pair]
            for j in range(4):
                at, component = a + j // 2, j % 2
                pull = far = force = bend = rub = 0.0
                for q in range(pair, pair + 2):
                    n, g = shapes[q, j], 1.0
                    pull += n * points[q, POINT_TANGENT]
                    far += n * points[q, POINT_TANGENT] * share[q]
                    force += n * points[q, POINT_FORCE]
                    if has_friction:
                        slope = shapes[q, 4] * state[a, 0] + shapes[q, 5] * state[a, 1]
                        slope += shapes[q, 6] * state[a + 1, 0] + shapes[q, 7] * state[a + 1, 1]
                        square = slope * slope / (1.0 + slope * slope)
                        g = 1.0 - friction[here] * square
                        rub -= n * points[q, POINT_FORCE] * square / g
                    bend += n * points[q, POINT_ALPHA] * g
                for p in range(total):
                    whole[at, component, p] += (pull - far) * constraints[behind, p]
                if far != 0.0:
                    for p in range(total):
                        whole[at, component, p] += far * constraints[other[pair], p]
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
    """Solve K du = load in place, forward and back with the blocks that `scalar.sweep_forward` left."""
    for i in range(size):
        i00, i01, i10, i11 = factor[i, INV00], factor[i, INV01], factor[i, INV10], factor[i, INV11]
        k20, k21, k30, k31 = factor[i, K20], factor[i, K21], factor[i, K30], factor[i, K31]
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
        g00, g01, g10, g11 = factor[i, G00], factor[i, G01], factor[i, G10], factor[i, G11]
        for p in range(columns):
            u, slope = whole[i + 1, 0, p], whole[i + 1, 1, p]
            whole[i, 0, p] -= g00 * u + g01 * slope
            whole[i, 1, p] -= g10 * u + g11 * slope
