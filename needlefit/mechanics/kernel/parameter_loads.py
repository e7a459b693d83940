"""The right-hand sides of a stop's derivatives, and the derivatives kept from stop to stop."""

from typing import NamedTuple

import numpy as np
from numba import njit

from needlefit.arrays import Floats, Ints
from needlefit.mechanics.kernel.beam import (
    HERMITE_COLUMNS,
    SLOPES,
    count_below,
    fill_hermite,
    fill_hermite_derivatives,
)
from needlefit.mechanics.kernel.foundation import Foundation, evaluate_stiffness, friction_factor
from needlefit.mechanics.kernel.grid import GAUSS_OFFSET, NodeGrid, find_cut
from needlefit.mechanics.kernel.insertion import (
    GUIDE_X,
    GUIDE_Y,
    BoundaryConditions,
    KernelInsertion,
)
from needlefit.mechanics.kernel.scalar import CLAMPED, FACTOR_COLUMNS, POINT_COLUMNS, Chain


@njit(cache=True, nogil=True)
def compute_tissue_reaction(
    foundation: Foundation, layer: int, away: float, slope: float
) -> tuple[float, float, float]:
    """Return the tissue's reaction k e g at a point, N/mm, and its derivatives with respect to e and u'."""
    k, tangent = evaluate_stiffness(foundation, layer, abs(away) / foundation.thickness[layer])
    g, g_slope = friction_factor(foundation.friction[layer], slope)
    return k * away * g, tangent * g, k * away * g_slope


@njit(cache=True, nogil=True)
def fill_node_load(
    load: Floats, i: int, state: Floats, chain: Chain, foundation: Foundation, grid: NodeGrid, y: Floats
) -> None:
    """Fill `load` (3, 2) with d(residual)/dx of the chain's node `i`, for the nodes i - 1, i and i + 1."""
    _clear_load(load)
    before = len(chain.front)
    for side in range(2):  # the element that ends at the node grows, the one that begins there shrinks
        a = i - 1 + side
        start = chain.front[a] if a < before else grid.nodes[a - before]
        stop = chain.front[a + 1] if a + 1 < before else grid.nodes[a + 1 - before]
        _add_bending(load, side, state, a, chain.rigidity, stop - start, 1.0 - 2.0 * side)
        e = a + 1 - before
        if e < 0:
            continue
        begin, end = grid.first[e], grid.first[e + 1]
        for q in range(begin, end):
            # only the piece of quadrature that touches a node in the tissue moves with it
            second = (q - begin) % 2
            drift = gain = 0.0
            if i >= before and side == 0 and q >= end - 2:
                drift, gain = 0.5 + (2 * second - 1) * GAUSS_OFFSET, 0.5
            elif i >= before and side == 1 and q < begin + 2:
                drift, gain = 0.5 - (2 * second - 1) * GAUSS_OFFSET, -0.5
            c, c_slope = find_cut(grid, y, q)
            _add_point(
                load[side:], state, a, foundation, c, c_slope * drift, grid.layer[q], grid.x[q] - start,
                stop - start, grid.weight[q], drift - side, 1.0 - 2.0 * side, gain,
            )  # fmt: skip


@njit(cache=True, nogil=True)
def fill_boundary_load(
    load: Floats, b: int, depth: float, state: Floats, chain: Chain, foundation: Foundation, grid: NodeGrid,
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
    _clear_load(load)
    right = count_below(grid.x, depth)  # pieces end at boundaries: the first point beyond
    e = 0
    while grid.first[e + 1] <= right:
        e += 1
    before = len(chain.front)
    a = e - 1 + before
    start = chain.front[a] if a < before else grid.nodes[a - before]
    length = grid.nodes[e] - start
    c, c_slope = find_cut(grid, y, right)
    c += c_slope * (depth - grid.x[right])  # at the boundary
    left = right - 2
    if (
        left >= grid.first[e]
        and grid.layer[left] == b
        and grid.constraint[left] == grid.constraint[right]
        and grid.x[left] > 0.0
    ):
        for j in range(2):
            drift, (here, slope) = 0.5 + (2 * j - 1) * GAUSS_OFFSET, find_cut(grid, y, left + j)
            _add_point(
                load, state, a, foundation, here, slope * drift, b, grid.x[left + j] - start, length,
                grid.weight[left + j], drift, 0.0, 0.5,
            )  # fmt: skip
    else:
        _add_point(load, state, a, foundation, c, 0.0, b, depth - start, length, 0.0, 0.0, 0.0, 1.0)
    if grid.layer[right] == b + 1:
        for j in range(2):
            drift, (here, slope) = 0.5 - (2 * j - 1) * GAUSS_OFFSET, find_cut(grid, y, right + j)
            _add_point(
                load, state, a, foundation, here, slope * drift, b + 1, grid.x[right + j] - start, length,
                grid.weight[right + j], drift, 0.0, -0.5,
            )  # fmt: skip
    else:  # a layer without extent
        _add_point(load, state, a, foundation, c, 0.0, b + 1, depth - start, length, 0.0, 0.0, 0.0, -1.0)
    return a


@njit(cache=True, nogil=True)
def _clear_load(load: Floats) -> None:
    for i in range(3):
        load[i, 0] = load[i, 1] = 0.0


@njit(cache=True, nogil=True)
def _add_bending(
    load: Floats, at: int, state: Floats, a: int, rigidity: float, length: float, grows: float
) -> None:
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
def _add_point(
    load: Floats, state: Floats, a: int, foundation: Foundation, c: float, c_by: float, layer: int,
    x: float, length: float, weight: float, drift: float, grows: float, gain: float,
) -> None:  # fmt: skip
    """Add d(w k e g N) of a quadrature point `x` mm into the element from node `a` on.

    Per unit of what moves, x grows by `drift`, the element's length by `grows`, the weight by `gain`, and
    the cut's y there, `c`, by `c_by`.
    """
    n, n_by = np.empty(HERMITE_COLUMNS), np.empty(HERMITE_COLUMNS)
    fill_hermite(n, x, length)
    fill_hermite_derivatives(n_by, x, length, drift, grows)
    u = slope = u_by = slope_by = 0.0
    for j in range(4):
        value = state[a + j // 2, j % 2]
        u += n[j] * value
        slope += n[SLOPES + j] * value
        u_by += n_by[j] * value
        slope_by += n_by[SLOPES + j] * value
    force, by_e, by_slope = compute_tissue_reaction(foundation, layer, u - c, slope)
    force_by = by_e * (u_by - c_by) + by_slope * slope_by
    for j in range(4):
        load[j // 2, j % 2] += (gain * force + weight * force_by) * n[j] + weight * force * n_by[j]


# Sums over a layer: of the force k e g, and of its derivatives with respect to alpha and friction.
LAYER_SUMS = 3
LAYER_FORCE, LAYER_ALPHA, LAYER_FRICTION = 0, 1, 2


class DerivativeColumns(NamedTuple):
    """The first column of each kind of parameter in arrays of derivatives, or -1 if not wanted."""

    total: int
    mu: int
    alpha: int
    friction: int
    boundary: int
    rigidity: int
    bevel: int  # its offset, or the angle of its cut
    base_y: int
    base_slope: int
    stage_slope: int


class DerivativeHistory(NamedTuple):
    """Derivatives, with respect to P parameters, of the constraint points, the rays and the tip so far.

    All are 0 before first contact: the tip defines the frame there, so no parameter moves it.
    """

    constraints: Floats  # (M + 1, P) of the constraint points' y
    rays: Floats  # (R, 2, P) of the deflection and slope with which each ray begins
    tip: Floats  # (2, P) of the tip's deflection and slope now
    y: Floats  # (M + 1,) the constraint points themselves, as they stood then
    track: Floats  # (M + 1, 2, P) of the tip's deflection and slope as it last stood in each cell
    cut: Floats  # (P,) of the cut's y at the tip


class AdjointWorkspace(NamedTuple):
    """Working arrays for the derivatives of one stop."""

    factor: Floats  # (C, FACTOR_COLUMNS)
    points: Floats  # (Q, POINT_COLUMNS)
    rows: Floats  # (C, 4) adjoint of the tip's deflection (two columns) and slope, 0 where prescribed
    prescribed_rows: Floats  # (C, 4) the same where something is prescribed: the answer per unit of that
    by_constraint: Floats  # (M + 1, 2)
    by_layer: Floats  # (n, 2, LAYER_SUMS) for the tip's deflection and slope
    load: Floats  # (3, 2) on three nodes
    load_entries: Ints  # (E, 3) node, component and column of right-hand sides that touch few nodes
    amounts: Floats  # (E,)


@njit(cache=True, nogil=True)
def make_workspace(insertion: KernelInsertion, layers: int, guides: int) -> AdjointWorkspace:
    """Return the working arrays for an insertion with so many layers and guides."""
    size = insertion.states.shape[1]
    # The base has 3 entries; a guide 2, and 6 for the three nodes that its x moves; a boundary 4 on two
    # nodes.
    load_entries = 3 + 8 * guides + 4 * layers
    return AdjointWorkspace(
        np.empty((size, FACTOR_COLUMNS)), np.zeros((2 * (size + len(insertion.y) + layers), POINT_COLUMNS)),
        np.empty((size, 4)), np.empty((size, 4)), np.empty((len(insertion.y), 2)),
        np.empty((layers, 2, LAYER_SUMS)), np.empty((3, 2)),
        np.empty((load_entries, 3), np.int64), np.empty(load_entries),
    )  # fmt: skip


@njit(cache=True, nogil=True)
def list_load_entries(
    workspace: AdjointWorkspace, boundaries: Floats, foundation: Foundation, grid: NodeGrid, chain: Chain,
    state: Floats, y: Floats, conditions: BoundaryConditions, guides: Ints, columns: DerivativeColumns,
    last: int, depth: float,
) -> int:  # fmt: skip
    """List the right-hand sides of base, guides and boundaries; return the number of entries."""
    # Loops, not a call for each component: numba compiles a function anew for every literal number.
    entries, amounts, load, kind = workspace.load_entries, workspace.amounts, workspace.load, chain.kind
    base, n = (columns.base_y, columns.stage_slope, columns.base_slope), 0
    for j in range(3):
        n = _list_entry(entries, amounts, n, 0 * j, j // 2, base[j], depth if j == 1 else 1.0)
    before = len(chain.front)
    for g in range(len(guides)):
        node = g + 1
        if node >= before:
            x = conditions.within[node - before, GUIDE_X]
            node = before + count_below(grid.nodes, x)
            if node >= before + last or grid.nodes[node - before] != x:
                continue  # the tip has not passed it yet
        for component in range(2 if kind[node] == CLAMPED else 1):
            n = _list_entry(entries, amounts, n, node, component, guides[g, GUIDE_Y + component], 1.0)
        if guides[g, GUIDE_X] >= 0:
            fill_node_load(load, node, state, chain, foundation, grid, y)
            n = _list_loads(entries, amounts, n, load, kind, node - 1, len(load), guides[g, GUIDE_X])
    if columns.boundary >= 0:
        for b in range(len(boundaries)):
            if 0.0 <= boundaries[b] < depth:
                node = fill_boundary_load(load, b, boundaries[b], state, chain, foundation, grid, y)
                n = _list_loads(entries, amounts, n, load, kind, node, len(load) - 1, columns.boundary + b)
    return n


@njit(cache=True, nogil=True)
def _list_entry(
    entries: Ints, amounts: Floats, n: int, node: int, component: int, column: int, amount: float
) -> int:
    if column < 0:
        return n
    entries[n, 0], entries[n, 1], entries[n, 2] = node, component, column
    amounts[n] = amount
    return n + 1


@njit(cache=True, nogil=True)
def _list_loads(
    entries: Ints, amounts: Floats, n: int, load: Floats, kind: Ints, node: int, nodes: int, column: int
) -> int:
    """List a load on the residual; what is prescribed has no equation that it could enter."""
    for i in range(nodes):
        for component in range(2):
            if kind[node + i] <= component:
                n = _list_entry(entries, amounts, n, node + i, component, column, -load[i, component])
    return n
