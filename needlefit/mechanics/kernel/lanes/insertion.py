"""Insert the needles of many parameter sets of one insertion at once: each set is a lane of vector
instructions.

The stops of an insertion are the same for all parameters, so every loop over lanes is the innermost one
(`passes`). No lane depends on another. A lane stops iterating at a stop where it has converged. It leaves for
the scalar kernel where its tissue is compressed beyond the series of its law, or the solution is lost.

What a stop costs: `newton`.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from needlefit.arrays import Floats, Ints
from needlefit.mechanics.kernel.beam import HERMITE_COLUMNS, count_below, fill_hermite
from needlefit.mechanics.kernel.grid import LINEAR_CUT, SAME_DEPTH_MM, NodeGrid
from needlefit.mechanics.kernel.insertion import (
    GUIDE_SLOPE,
    GUIDE_X,
    GUIDE_Y,
    BoundaryConditions,
    KernelInsertion,
    TipStops,
    build_stop_grid,
)
from needlefit.mechanics.kernel.lanes.newton import (  # fmt: skip
    IN_LANE,
    LIVE_CELLS,
    HeldNodes,
    LaneInputs,
    LaneWorkspace,
    equilibrate_lanes,
)
from needlefit.mechanics.kernel.lanes.passes import extrapolate_node
from needlefit.mechanics.kernel.lanes.tables import (
    LANES,
    LaneTables,
    tabulate,
    tabulate_point,
)
from needlefit.mechanics.kernel.scalar import NewtonOptions

W = LANES
NODES_NOW, ON_MAIN_GRID, PREVIOUS_NODES, CURRENT_STATE = 0, 1, 2, 3  # index of `LaneState.size`
FRONT_ROWS = 7  # of LANES numbers: what `_condense_front` returns


class LaneState(NamedTuple):
    """The state of an insertion in all lanes; rows of W numbers."""

    y: Floats  # (M + 1, W) of the constraint points
    track: Floats  # (M + 1, 2 W) deflection and slope of the tip as it stood at each
    rays: Floats  # (R, 3 W) y where each ray begins, the slope it takes on, the bevel's turn
    cut: Floats  # (W,) y of the cut at the tip
    starts: Floats  # (R,) depth where each ray begins, mm
    states: Floats  # (2, N, 2 W) deflection and slope of the nodes in the tissue, now and one cell ago
    nodes: Floats  # (N,) their depth now
    lane_status: Ints  # (W,) IN_LANE or LEFT_LANES
    passes: Ints  # (W,) full or half Newton passes
    size: Ints  # (4,) nodes in the tissue now, whether they are the main grid's, nodes one cell ago, and
    # which of the two states is now
    depth: Floats  # (1,) of the tip, mm


@njit(cache=True, nogil=True)
def begin_lanes(cells: int, nodes: int, rays: int) -> LaneState:
    """Return the lanes before first contact, with room for so many cells, nodes and rays."""
    return LaneState(
        np.zeros((cells + 1, W)), np.full((cells + 1, 2 * W), np.nan), np.zeros((rays, 3 * W)),
        np.zeros(W), np.zeros(rays), np.zeros((2, nodes, 2 * W)), np.zeros(nodes),
        np.zeros(W, np.int64), np.zeros(W, np.int64), np.zeros(4, np.int64), np.zeros(1),
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def advance_lanes(
    lanes: LaneState, insertion: KernelInsertion, main: LaneTables, conditions: BoundaryConditions,
    inputs: LaneInputs, stops: TipStops, newton: NewtonOptions, workspace: LaneWorkspace,
) -> None:  # fmt: skip
    """Bring the needles of all lanes from stop to stop, as `kernel.insertion.advance_needle` does with one.

    `insertion` provides the grids: its main one has a node at each guide in the tissue that the tip of these
    stops has passed. `conditions` provides the guides and the tracked tip.
    """
    room = len(conditions.within) + 1
    nodes, values = np.empty(room, np.int64), np.empty((room, 2))
    holds = room > 1 or not math.isnan(conditions.tip[0])
    for s in range(len(stops.tip)):
        tip, cell = stops.tip[s], stops.cell[s]
        _place_constraint(lanes, inputs, stops, s, insertion)
        grid, tables = insertion.main, main
        # The main grid reaches to the deepest stop: the tip's node is not its last one. A guide in the tissue
        # just before a constraint point has taken the place of its node.
        last = count_below(grid.nodes, tip - SAME_DEPTH_MM)
        on_main = stops.permanent[s] and cell > 0 and grid.nodes[last] <= tip + SAME_DEPTH_MM
        if not on_main:
            grid = build_stop_grid(insertion, conditions, tip, cell)
            tables = tabulate(grid)
            last = len(grid.nodes) - 1
        # Only where something holds: a call counts the references of all arrays.
        number = _find_held_nodes(nodes, values, conditions, grid, last) if holds else 0
        held = HeldNodes(number, nodes, values)
        begin = _guess_next_state(lanes, grid, last, on_main, s > 0)
        ends = _condense_front(lanes, inputs, grid, tables, tip, insertion.length)
        state = lanes.states[lanes.size[CURRENT_STATE]].reshape(-1)
        if holds:
            _impose_held_nodes(state, held)
        equilibrate_lanes(
            state,
            lanes.y.reshape(-1),
            lanes.lane_status,
            lanes.passes,
            inputs,
            grid,
            tables,
            begin,
            last,
            ends,
            held,
            workspace,
            newton,
        )
        if holds:
            _impose_held_nodes(state, held)  # they are met to rounding; now to the bit
        lanes.depth[0] = tip
        for l in range(2 * W):
            lanes.track[cell, l] = lanes.states[lanes.size[CURRENT_STATE], last, l]
        for l in range(W):
            lanes.cut[l] = lanes.y[cell, l] if cell > 0 else lanes.track[0, l]
        here = 0
        for l in range(W):
            here += int(lanes.lane_status[l] == IN_LANE)
        # The caller solves every set with the scalar kernel then: further stops are of no use.
        if here == 0:
            return


@njit(cache=True, nogil=True)
def _find_held_nodes(
    nodes: Ints, values: Floats, conditions: BoundaryConditions, grid: NodeGrid, last: int
) -> int:
    """Fill in the nodes that guides in the tissue and a tracked tip hold at a stop; return their number."""
    within, count = conditions.within, 0
    for i in range(len(within)):
        node = count_below(grid.nodes, within[i, GUIDE_X])
        if node < last and grid.nodes[node] == within[i, GUIDE_X]:  # none holds the tip itself
            nodes[count], values[count, 0], values[count, 1] = (
                node,
                within[i, GUIDE_Y],
                within[i, GUIDE_SLOPE],
            )
            count += 1
    if not math.isnan(conditions.tip[0]):
        nodes[count], values[count, 0], values[count, 1] = last, conditions.tip[0], conditions.tip[1]
        count += 1
    return count


@njit(cache=True, nogil=True)
def _impose_held_nodes(state: Floats, held: HeldNodes) -> None:
    """Write what is prescribed into the `state` (N 2 W,) of all lanes."""
    for h in range(held.number):
        at = held.node[h] * 2 * W
        for l in range(W):
            state[at + l] = held.value[h, 0]
            if not math.isnan(held.value[h, 1]):
                state[at + W + l] = held.value[h, 1]


@njit(cache=True, nogil=True)
def _place_constraint(
    lanes: LaneState, inputs: LaneInputs, stops: TipStops, s: int, insertion: KernelInsertion
) -> None:
    """Put the constraint point under the tip of stop `s` on its ray, in every lane."""
    ray, cell = stops.ray[s], stops.cell[s]
    if stops.starts_ray[s]:
        lanes.starts[ray] = lanes.depth[0]
        tip = lanes.states[lanes.size[CURRENT_STATE], lanes.size[NODES_NOW] - 1]
        for l in range(W):
            lanes.rays[ray, l], lanes.rays[ray, W + l] = tip[l], insertion.tangent * tip[W + l]
            lanes.rays[ray, 2 * W + l] = inputs.turn[s, l]
        if insertion.switch == LINEAR_CUT:
            for l in range(W):
                lanes.rays[ray, l] = lanes.cut[l]
                if lanes.depth[0] == 0.0:  # the cut begins where the tip is, under the inputs that hold now
                    lanes.y[0, l] = lanes.cut[l]
                if stops.extrapolates[s]:
                    lanes.rays[ray, W + l] += 0.5 * (tip[W + l] - lanes.track[cell - 2, W + l])
    if cell > 0:
        ahead, row, y = stops.tip[s] - lanes.starts[ray], lanes.rays[ray], lanes.y[cell]
        for l in range(W):
            y[l] = row[l] + ahead * (row[W + l] + row[2 * W + l])


@njit(cache=True, nogil=True, forceinline=True)
def _guess_next_state(lanes: LaneState, grid: NodeGrid, last: int, on_main: bool, factored: bool) -> int:
    """Guess the next stop from the last two, or, where there are none, from the shape as it is.

    Returns the first element that has to be linearised; those before it keep the factor of the last stop, if
    that was `factored`, and their nodes are not guessed.
    """
    begin = 1
    size, now = last + 1, lanes.size[CURRENT_STATE]
    old, older_size = lanes.size[NODES_NOW], lanes.size[PREVIOUS_NODES]
    state, other = lanes.states[now], lanes.states[1 - now]
    same = on_main and lanes.size[ON_MAIN_GRID] == 1
    growth = size - old
    lanes.size[NODES_NOW], lanes.size[ON_MAIN_GRID], lanes.size[PREVIOUS_NODES] = size, int(on_main), 0
    nodes = lanes.nodes
    if not same:
        if old > 0:
            _interpolate_state(state, nodes[:old].copy(), other, grid.nodes[:size])
            lanes.size[CURRENT_STATE] = 1 - now
    elif growth > 0:
        extrapolated = growth == old - older_size and older_size >= growth
        if extrapolated and factored:
            begin = max(1, size - LIVE_CELLS * growth)
        # From the tip back: `other` is read behind where it is written. The load at the first node depends on
        # that node, so it is guessed too.
        for n in range(size - begin + 1 + int(begin > 1)):
            i = size - 1 - n if n <= size - begin else 0
            if i >= old:
                ahead = grid.nodes[i] - nodes[old - 1]
                j, behind = i - growth, grid.nodes[i - growth] - nodes[older_size - 1]
                for l in range(W):
                    u, slope = state[old - 1, l], state[old - 1, W + l]
                    u += ahead * slope
                    if extrapolated:  # as far beside the tangent as the cell before
                        u += state[j, l] - (other[older_size - 1, l] + behind * other[older_size - 1, W + l])
                        slope += state[j, W + l] - other[older_size - 1, W + l]
                    other[i, l], other[i, W + l] = u, slope
            elif extrapolated:  # every node moves on as it, or the node one cell behind it, moved
                j = i if i < older_size else i - growth
                extrapolate_node(other[i], state[i], state[j], other[j])
            else:
                for l in range(2 * W):
                    other[i, l] = state[i, l]
        lanes.size[PREVIOUS_NODES], lanes.size[CURRENT_STATE] = old, 1 - now
    for i in range(size):
        nodes[i] = grid.nodes[i]
    return begin


@njit(cache=True, nogil=True)
def _interpolate_state(state: Floats, nodes: Floats, into: Floats, at: Floats) -> None:
    """Read the shapes `state` (N, 2 W) at other depths; beyond their ends they go straight on."""
    end, n = len(nodes) - 1, np.empty(HERMITE_COLUMNS)
    for i in range(len(at)):
        if at[i] <= nodes[0] or at[i] >= nodes[end]:
            e = 0 if at[i] <= nodes[0] else end
            for l in range(W):
                into[i, l] = state[e, l] + (at[i] - nodes[e]) * state[e, W + l]
                into[i, W + l] = state[e, W + l]
            continue
        e = count_below(nodes, at[i]) - 1
        fill_hermite(n, at[i] - nodes[e], nodes[e + 1] - nodes[e])
        for l in range(W):
            a0, a1, b0, b1 = state[e, l], state[e, W + l], state[e + 1, l], state[e + 1, W + l]
            into[i, l] = n[0] * a0 + n[1] * a1 + n[2] * b0 + n[3] * b1
            into[i, W + l] = n[4] * a0 + n[5] * a1 + n[6] * b0 + n[7] * b1


@njit(cache=True, nogil=True, error_model="numpy")
def _condense_front(
    lanes: LaneState, inputs: LaneInputs, grid: NodeGrid, tables: LaneTables, tip: float, length: float
) -> Floats:
    """Condense base, guides and free spans to the first node in the tissue.

    What lies before the last node whose slope is held does not reach the tissue.

    Returns
    -------
    (7 W,) array
        S (3) and r (2) at the first node, deflection and slope of the last node before it; the tables of
        element 0 are filled where it has tissue.
    """
    last = len(inputs.before)  # the last node that is clamped; node 0 is the base
    while last > 0 and math.isnan(inputs.before[last - 1, GUIDE_SLOPE, 0]):
        last -= 1
    span_start = tip - length if last == 0 else inputs.before[last - 1, GUIDE_X, 0]
    for q in range(grid.first[1]):
        fill_hermite(grid.shapes[q], grid.x[q] - span_start, grid.nodes[0] - span_start)
        tabulate_point(tables.points[q], grid.shapes[q], grid.weight[q], grid.share[q])
    ends = np.empty(FRONT_ROWS * W)
    for l in range(W):
        s00 = s01 = s11 = r0 = r1 = 0.0
        x, y, slope = tip - length, inputs.base[0, l] + inputs.base[2, l] * tip, inputs.base[1, l]
        for i in range(last, len(inputs.before) + 1):
            if i > 0:
                x, y, slope = (
                    inputs.before[i - 1, GUIDE_X, l],
                    inputs.before[i - 1, GUIDE_Y, l],
                    inputs.before[i - 1, GUIDE_SLOPE, l],
                )
            span = (inputs.before[i, GUIDE_X, l] if i < len(inputs.before) else grid.nodes[0]) - x
            f = inputs.rigidity[l] / (span * span * span)
            k00, k01, k11, k13 = 12.0 * f, 6.0 * f * span, 4.0 * f * span * span, 2.0 * f * span * span
            if i == last:
                s00, s01, s11, r0, r1 = k00, -k01, k11, k00 * y + k01 * slope, -k01 * y - k13 * slope
                continue
            # The deflection of a guide is prescribed, so only its slope is eliminated.
            s = s11 + k11  # of the slope of a guide that is passed freely
            g0, g1, z = -k01 / s, k13 / s, (r1 - (s01 + k01) * y) / s
            s00, s01, s11 = k00 + k01 * g0, -k01 + k01 * g1, k11 - k13 * g1
            r0, r1 = k00 * y + k01 * z, -k01 * y - k13 * z
        ends[l], ends[W + l], ends[2 * W + l], ends[3 * W + l], ends[4 * W + l] = s00, s01, s11, r0, r1
        ends[5 * W + l], ends[6 * W + l] = y, slope
    return ends
