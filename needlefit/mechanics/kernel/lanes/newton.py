"""Solve for one equilibrium in all lanes at once, by Newton's method.

Behind the tip little changes from one cell to the next, so the factor of the elements there is kept. A stop
that follows another one cell ahead costs

1. a full pass over the last LIVE_CELLS cells alone, which predicts the shape; what the load at the base
   changes is handed through the kept factor;
2. a chord pass over the whole needle, with the exact residual and the kept factor; every REFACTOR_NODES nodes
   a full pass instead, in all lanes;
3. where its bound asks for it, lane by lane, another chord pass, then full passes.

The first stop on a grid begins with a full pass over the whole needle.

Guides in the tissue and a tracked tip hold a node by a support so stiff that the rest is lost in rounding:
elimination and chord passes are those of a free node. Friction is no part of the tangent: the load that it
takes away is computed before each pass, and the increment alone shows convergence.

The kept factor belongs to an older S of the needle before the tissue. What S has changed by goes to the
right-hand side, times the first node's new state; the compliance of the first node predicts that state.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from needlefit.arrays import Floats, Ints
from needlefit.mechanics.kernel.grid import NodeGrid
from needlefit.mechanics.kernel.lanes.passes import (  # fmt: skip
    add_compliance,
    chord_interval,
    chord_regular,
    chord_sums,
    clear_load,
    friction_point,
    full_interval,
    full_regular,
    full_sums,
    keep_reference,
    shift_load,
    solve_tip,
    start_front,
    substitute_back,
    support_node,
    update_tip,
)
from needlefit.mechanics.kernel.lanes.tables import (  # fmt: skip
    AT_WORK,
    COMPLIANCE_ROWS,
    EXCESS,
    F2,
    F3,
    INCREMENT,
    K22,
    K33,
    LANES,
    LAYER_ROWS,
    NODE,
    NODE_ROWS,
    OVER,
    PRODUCT,
    SUM_ROWS,
    W1,
    W2,
    LaneTables,
    R,
)
from needlefit.mechanics.kernel.scalar import ROUNDING_MM, NewtonOptions

W = LANES
U = np.uint64
NODE_STATE_OFFSET, LAYER_OFFSET = (
    U(2 * LANES),
    U(LAYER_ROWS * LANES),
)  # deflections and slopes of a node; a layer
LIVE_CELLS = 3  # linearised anew at every stop
REFACTOR_NODES = 8
# After a chord pass the tangent is wrong by at most `curvature` times itself times the distance from where it
# was taken; four times that, since the errors of all stops add up.
CHORD_ERROR = 4.0
# N / mm and N mm: so large that an element's stiffness added to it is lost in rounding. What it holds is then
# met as if prescribed, while elimination and chord passes remain those of a free node.
SUPPORT_STIFFNESS = 2.0**100
MAX_PASSES = 12  # at one stop; a lane that needs more goes to the scalar kernel
IN_LANE, LEFT_LANES = 0, 1  # a lane: under way, gone to the scalar kernel


class LaneInputs(NamedTuple):
    """The inputs that differ between lanes: rigidity, layers, base, guides and bevel."""

    rigidity: Floats  # (W,) EI, N mm^2
    layers: Floats  # (n LAYER_ROWS W,) series of k in |e|, the |e| up to which it holds, curvature, friction
    curvature: Floats  # (W,) a full pass leaves at most about this times its increment squared, 1 / mm
    base: Floats  # (3, W) y, slope, slope of the stage's axis
    before: Floats  # (F, 3, W) x, y, slope (NaN: free, then in all lanes) of the guides before the tissue
    turn: Floats  # (S, W) of each stop's bevel
    has_friction: bool  # whether any layer has friction


class HeldNodes(NamedTuple):
    """The nodes in the tissue that guides and a tracked tip hold at one stop, alike in all lanes."""

    number: int  # H
    node: Ints  # (H or more,)
    value: Floats  # (H or more, 2) deflection and slope; a slope that is left free is NaN


class LaneWorkspace(NamedTuple):
    """Working arrays of the passes, and the factor that chord passes keep."""

    work: (
        Floats  # ((N + 2) NODE_ROWS W,) what was handed on from before the tissue, then the rows of each node
    )
    tangents: Floats  # (Q W,) of the points of elements that are not regular
    sums: Floats  # (SUM_ROWS W,) of one such element
    frozen: Floats  # (COMPLIANCE_ROWS W,) compliance of the first node, without the elements near the tip
    compliance: Floats  # (COMPLIANCE_ROWS W,) with them
    rigid: Floats  # (COMPLIANCE_ROWS W,) that of a node which no load moves: zeros
    front: Floats  # (4 W,) the first node as predicted, and what a difference of it is worth
    load: Floats  # (2 W,) a further load, handed from node to node
    friction: Floats  # ((N + 1) 2 W,) force and moment that friction takes from the load on each node; the
    # first two rows are those of the last node before the tissue
    busy: Floats  # (3 W,) whether a lane iterates, its increment, and what a chord pass is wrong by
    counted: Ints  # (1,) elements that `frozen` holds


def make_workspace(nodes: int, points: int) -> LaneWorkspace:
    """Return room for so many nodes and quadrature points."""
    # Not zero: every number is written before it is read, and zeroing costs more than a stop.
    return LaneWorkspace(
        np.empty((nodes + 2) * NODE_ROWS * W), np.empty(points * W), np.empty(SUM_ROWS * W),
        np.empty(COMPLIANCE_ROWS * W), np.empty(COMPLIANCE_ROWS * W), np.zeros(COMPLIANCE_ROWS * W),
        np.empty(4 * W), np.empty(2 * W), np.empty((nodes + 1) * 2 * W), np.empty(3 * W),
        np.zeros(1, np.int64),
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def equilibrate_lanes(
    state: Floats, y: Floats, lane_status: Ints, passes: Ints, inputs: LaneInputs, grid: NodeGrid,
    tables: LaneTables, begin: int, last: int, ends: Floats, held: HeldNodes, workspace: LaneWorkspace,
    newton: NewtonOptions,
) -> None:  # fmt: skip
    """Iterate until every lane has converged or left for the scalar kernel; no lane depends on another.

    Parameters
    ----------
    state : (N 2 W,) array
        Deflection and slope of the nodes in the tissue: a guess, replaced by the answer.
    y : ((M + 1) W,) array
        Constraint points, mm.
    lane_status, passes : (W,) arrays
        IN_LANE or LEFT_LANES; the passes so far.
    begin : int
        First element without a kept factor; 1: none has one.
    last : int
        The tip's node.
    ends : (7 W,) array
        S and r that the needle before the tissue hands on, and its last node.
    """
    work, busy, front, load = workspace.work, workspace.busy, workspace.front, workspace.load
    for l in range(W):
        busy[AT_WORK + U(l)] = 1.0 if lane_status[l] == IN_LANE else 0.0
    tip, counted = U(last + 1) * NODE, workspace.counted[0]
    for n in range(min(MAX_PASSES, newton.max_iterations)):
        whole, full = n > 0 or begin == 1, n != 1
        if begin > 1:
            full = last % REFACTOR_NODES == 0 if n == 1 else n != 2
        # Each loop over lanes is inlined here, so each is called from as few places as possible.
        compliance = workspace.compliance if whole else workspace.rigid
        if whole:
            counted = 0 if full else _sum_compliance(workspace, counted, begin, last)
        for l in range(W1):
            load[l], load[W1 + l] = -work[R + l], -work[R + W1 + l]
        if inputs.has_friction:
            _sum_friction(grid, inputs, y, state, ends, 0 if whole else begin, last, workspace)
        _start_entry(grid, tables, inputs, y, state, ends, held, workspace, compliance, whole and full)
        if not whole:
            _shift_load(workspace, begin)
        _eliminate(grid, tables, inputs, y, state, begin if n == 0 else 1, last, held, workspace, full)
        layer = U(tables.layer[last]) * LAYER_OFFSET
        update_tip(work, tip, state, U(last) * NODE_STATE_OFFSET, inputs.layers, layer, busy)
        for e in range(last, 0, -1):
            node, layer = U(e - 1) * NODE_STATE_OFFSET, U(tables.layer[e]) * LAYER_OFFSET
            substitute_back(work, U(e) * NODE, state, node, inputs.layers, layer, busy)
        if not whole:
            continue
        at_work = 0
        excess = work[tip + EXCESS :]
        blind = n < 2 and held.number > last  # all deflections are prescribed: only slopes change
        for l in range(W):
            if busy[AT_WORK + U(l)] == 0.0:
                continue
            passes[l] += 1
            change = busy[INCREMENT + U(l)]
            # the next increment: a full pass squares it
            ahead = inputs.curvature[l] * change * change
            if not full:
                ahead = CHORD_ERROR * busy[PRODUCT + U(l)]
                ahead += abs(front[2 * W + l] * (state[l] - front[l]))
                ahead += abs(front[3 * W + l] * (state[W + l] - front[W + l]))
            # An increment this small after so many passes is rounding, as in the scalar kernel.
            stalled = n > 2 and change < ROUNDING_MM
            if inputs.has_friction:
                ahead, stalled = change, False
            if not math.isfinite(change):
                # A lost solution must not keep the other lanes iterating; the scalar kernel solves this set
                # again.
                lane_status[l], busy[AT_WORK + U(l)] = LEFT_LANES, 0.0
            elif not blind and (min(change, ahead) < newton.tolerance or stalled):
                # a guess may have left the range of the series on the way; the solution must not
                busy[AT_WORK + U(l)] = 0.0
                lane_status[l] = IN_LANE if excess[l] <= 0.0 else LEFT_LANES
            at_work += int(busy[AT_WORK + U(l)])
        if at_work == 0:
            break
    workspace.counted[0] = counted
    for l in range(W):
        if busy[AT_WORK + U(l)] > 0.0:
            lane_status[l] = LEFT_LANES


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _shift_load(workspace: LaneWorkspace, begin: int) -> None:
    """Hand on what has changed before the tissue since the last stop, up to element `begin`.

    `load` holds minus the r of that stop.
    """
    work, load = workspace.work, workspace.load
    for l in range(W1):
        load[l] += work[R + l]
        load[W1 + l] += work[R + W1 + l]
    for e in range(1, begin):
        shift_load(work, U(e) * NODE, load)
    at = U(begin - 1) * NODE + R
    for l in range(W1):
        work[at + l] += load[l]
        work[at + W1 + l] += load[W1 + l]


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _sum_compliance(workspace: LaneWorkspace, counted: int, begin: int, last: int) -> int:
    """Compute the compliance of the first node; elements before `begin` are counted once."""
    work, frozen, compliance = workspace.work, workspace.frozen, workspace.compliance
    if counted == 0:
        for l in range(COMPLIANCE_ROWS * W):
            frozen[l] = 0.0
        for l in range(W):  # P = 1
            frozen[l] = frozen[3 * W + l] = 1.0
    for e in range(counted + 1, last + 2):
        if e == begin:
            for l in range(COMPLIANCE_ROWS * W):
                compliance[l] = frozen[l]
        add_compliance(work, U(e) * NODE, frozen if e < begin else compliance)
    return begin - 1


@njit(cache=True, nogil=True, forceinline=True)
def _find_support(held: HeldNodes, h: int, node: int) -> tuple[float, float, float, float]:
    """Return stiffness against deflection and rotation, force and moment on a node; 0 if it is not node h."""
    if h >= held.number or held.node[h] != node:
        return 0.0, 0.0, 0.0, 0.0
    y, slope = SUPPORT_STIFFNESS * held.value[h, 0], SUPPORT_STIFFNESS * held.value[h, 1]
    if math.isnan(slope):
        return SUPPORT_STIFFNESS, 0.0, y, 0.0
    return SUPPORT_STIFFNESS, SUPPORT_STIFFNESS, y, slope


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _sum_friction(
    grid: NodeGrid, inputs: LaneInputs, y: Floats, state: Floats, ends: Floats, begin: int, last: int,
    workspace: LaneWorkspace,
) -> None:  # fmt: skip
    """Sum what friction takes from the loads on the nodes of the elements from `begin` on."""
    friction, busy, span = workspace.friction, workspace.busy, np.empty(4 * W)
    for l in range(2 * W):
        span[l], span[2 * W + l] = ends[5 * W + l], state[l]
    for e in range(begin, last + 2):
        clear_load(friction, U(e) * NODE_STATE_OFFSET, busy)
    for e in range(begin, last + 1):
        ends_of = span if e == 0 else state  # the first element begins at the prescribed end of the front
        node = U(max(e - 1, 0)) * NODE_STATE_OFFSET
        for q in range(grid.first[e], grid.first[e + 1]):
            point, other = U(grid.constraint[q]) * W1, U(grid.other[q]) * W1
            friction_point(
                ends_of, node, y, point, other, grid.share[q], inputs.layers, U(grid.layer[q]) * LAYER_OFFSET,
                grid.shapes, U(q), grid.weight[q], friction, U(e) * NODE_STATE_OFFSET, busy,
            )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _start_entry(
    grid: NodeGrid, tables: LaneTables, inputs: LaneInputs, y: Floats, state: Floats, ends: Floats,
    held: HeldNodes, workspace: LaneWorkspace, compliance: Floats, full: bool,
) -> None:  # fmt: skip
    """Hand on S and r from before the tissue, with what of element 0 lies in it."""
    sums, work, busy = workspace.sums, workspace.work, workspace.busy
    for l in range(SUM_ROWS * W):
        sums[l] = 0.0
    if grid.first[1] > 0:
        span = np.empty(4 * W)
        for l in range(2 * W):
            span[l], span[2 * W + l] = ends[5 * W + l], state[l]
        for q in range(0, grid.first[1], 2):
            _add_interval(grid, tables, inputs, y, span, U(0), q, workspace.tangents, sums, busy, True)
    else:
        for l in range(W1):
            sums[OVER + l] = -np.inf
    stiff, turned, force, moment = _find_support(held, 0, 0)
    if stiff > 0.0 or inputs.has_friction:
        extra, at = (workspace.friction, W2) if inputs.has_friction else (workspace.rigid, U(0))
        for l in range(W1):
            sums[K22 + l] += stiff
            sums[K33 + l] += turned
            sums[F2 + l] += force + extra[at + l]
            sums[F3 + l] += moment + extra[at + W1 + l]
    # The first node of element 0 is the prescribed end of the front: its columns go to the right-hand side.
    start_front(sums, ends, state, work, compliance, workspace.front, full, busy)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _eliminate(
    grid: NodeGrid, tables: LaneTables, inputs: LaneInputs, y: Floats, state: Floats, begin: int, last: int,
    held: HeldNodes, workspace: LaneWorkspace, full: bool,
) -> None:  # fmt: skip
    """Go from element `begin` to the tip, element by element."""
    layers, rigidity, sums, work, busy = (
        inputs.layers, inputs.rigidity, workspace.sums, workspace.work, workspace.busy,
    )  # fmt: skip
    firsts, layer, constraint, regular_row, regular = (
        grid.first, grid.layer, grid.constraint, tables.regular_row, tables.regular,
    )  # fmt: skip
    extra = workspace.friction if inputs.has_friction else workspace.rigid  # or zeros
    h = 0
    while h < held.number and held.node[h] < begin:
        h += 1
    for e in range(begin, last + 1):
        node, own, q = U(e - 1) * NODE_STATE_OFFSET, U(e) * NODE, firsts[e]
        if regular_row[e] >= 0:
            point, row = U(constraint[q]) * W1, U(regular_row[e])
            first, second = U(layer[q]) * LAYER_OFFSET, U(layer[q + 2]) * LAYER_OFFSET
            if full:
                full_regular(
                    state, node, y, point, layers, first, second, regular, row, rigidity, work, own, busy
                )
            else:
                chord_regular(state, node, y, point, layers, first, second, regular, row, work, own, busy)
        else:
            for l in range(SUM_ROWS * W):
                sums[l] = 0.0
            for p in range(q, firsts[e + 1], 2):
                _add_interval(grid, tables, inputs, y, state, node, p, workspace.tangents, sums, busy, full)
            if full:
                full_sums(sums, tables.bending, U(e), rigidity, work, own, busy)
            else:
                chord_sums(sums, work, own, busy)
        support = _find_support(held, h, e)
        if support[0] > 0.0 or inputs.has_friction:
            at = U(e + 1) * NODE_STATE_OFFSET if inputs.has_friction else U(0)
            support_node(work, own, extra, at, support, full, busy)
            h += int(support[0] > 0.0)
    if full:
        for e in range(begin, last + 2):
            keep_reference(work, U(e) * NODE, state, U(e - 1) * NODE_STATE_OFFSET, busy)
    solve_tip(work, U(last + 1) * NODE, busy)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _add_interval(
    grid: NodeGrid, tables: LaneTables, inputs: LaneInputs, y: Floats, state: Floats, node: np.uint64, q: int,
    tangents: Floats, sums: Floats, busy: Floats, full: bool,
) -> None:  # fmt: skip
    """Add the interval whose first point is `q` to the sums of its element."""
    point, other = U(grid.constraint[q]) * W1, U(grid.other[q]) * W1
    layer, tangent_row = U(grid.layer[q]) * LAYER_OFFSET, U(q) * W1
    if full:
        full_interval(
            state,
            node,
            y,
            point,
            other,
            inputs.layers,
            layer,
            tables.points,
            U(q),
            tangents,
            tangent_row,
            sums,
            busy,
        )
    else:
        chord_interval(
            state,
            node,
            y,
            point,
            other,
            inputs.layers,
            layer,
            tables.points,
            U(q),
            tangents,
            tangent_row,
            sums,
        )
