"""Solve for one equilibrium in all lanes at once, by Newton's method.

The first pass is a full Newton pass. Lanes that have not converged then make a chord pass with the factor of
the first, at half the cost; further passes are full ones.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from needlefit.arrays import Floats, Ints
from needlefit.mechanics.kernel.grid import NodeGrid
from needlefit.mechanics.kernel.lanes.passes import (  # fmt: skip
    chord_interval,
    chord_regular,
    chord_sums,
    full_interval,
    full_regular,
    full_sums,
    solve_tip,
    solve_tip_chord,
    substitute_back,
    update_tip,
)
from needlefit.mechanics.kernel.lanes.tables import (  # fmt: skip
    EXCESS,
    F2,
    F3,
    K02,
    K03,
    K12,
    K13,
    K22,
    K23,
    K33,
    LANES,
    LAYER_ROWS,
    NODE,
    OVER,
    STIFFNESS_ROWS,
    SUM_ROWS,
    W1,
    W2,
    W3,
    W4,
    W5,
    W6,
    LaneTables,
    S,
)
from needlefit.mechanics.kernel.scalar import ROUNDING_MM, NewtonOptions

W = LANES
U = np.uint64
NODE_STATE_OFFSET, LAYER_OFFSET = (
    U(2 * LANES),
    U(LAYER_ROWS * LANES),
)  # deflections and slopes of a node; a layer
AT_WORK, INCREMENT, LAST_INCREMENT = 0, LANES, 2 * LANES  # offsets of the rows of `busy`, one number a lane
MAX_PASSES = 12  # at one stop; a lane that needs more goes to the scalar kernel
IN_LANE, LEFT_LANES = 0, 1  # a lane: under way, gone to the scalar kernel


class LaneInputs(NamedTuple):
    """The inputs that differ between lanes: rigidity, layers, base, guides and bevel."""

    rigidity: Floats  # (W,) EI, N mm^2
    layers: Floats  # (n LAYER_ROWS W,) series of k in |e|, and the |e| up to which it holds
    curvature: Floats  # (W,) a full pass leaves at most about this times its increment squared, 1 / mm
    base: Floats  # (3, W) y, slope, slope of the stage's axis
    before: Floats  # (F, 3, W) x, y, slope (NaN: free, then in all lanes) of the guides before the tissue
    turn: Floats  # (S, W) of each stop's bevel


class LaneWorkspace(NamedTuple):
    """Working arrays of the passes, and what a chord pass reads from the full pass before it."""

    work: (
        Floats  # ((N + 2) NODE_ROWS W,) what was handed on from before the tissue, then the rows of each node
    )
    tangents: Floats  # (Q W,) of the points of elements that are not regular
    sums: Floats  # (SUM_ROWS W,) of one such element
    entry: Floats  # (SUM_ROWS W,) of element 0


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def equilibrate_lanes(
    state: Floats, y: Floats, lane_status: Ints, passes: Ints, inputs: LaneInputs, grid: NodeGrid,
    tables: LaneTables, last: int, ends: Floats, workspace: LaneWorkspace, newton: NewtonOptions,
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
    last : int
        The tip's node.
    ends : (7 W,) array
        S and r that the needle before the tissue hands on, and its last node.
    """
    work = workspace.work
    busy = np.zeros(3 * W)
    for l in range(W):
        busy[AT_WORK + l] = 1.0 if lane_status[l] == IN_LANE else 0.0
    for n in range(min(MAX_PASSES, newton.max_iterations)):
        full = n != 1
        _start_entry(grid, tables, inputs, y, state, ends, workspace, full)
        _eliminate(grid, tables, inputs, y, state, last, workspace, full)
        update_tip(work, U(last + 1) * NODE, state, U(last) * NODE_STATE_OFFSET, busy)
        for i in range(last - 1, -1, -1):
            substitute_back(work, U(i + 1) * NODE, state, U(i) * NODE_STATE_OFFSET, busy)
        at_work = 0
        excess = work[U(last + 1) * NODE + EXCESS :]
        for l in range(W):
            if busy[AT_WORK + l] == 0.0:
                continue
            passes[l] += 1
            change, before = busy[INCREMENT + l], busy[LAST_INCREMENT + l]
            # the next increment: a full pass squares it, a half one multiplies it by the one before
            ahead = inputs.curvature[l] * change * (change if full else 2.0 * before)
            # An increment this small that no longer shrinks is rounding, as in the scalar kernel.
            stalled = n > 1 and change < ROUNDING_MM and change > 0.5 * before
            if not math.isfinite(change):
                # A lost solution must not keep the other lanes iterating; the scalar kernel solves this set
                # again.
                lane_status[l], busy[AT_WORK + l] = LEFT_LANES, 0.0
            elif min(change, ahead) < newton.tolerance or stalled:
                # a guess may have left the range of the series on the way; the solution must not
                busy[AT_WORK + l] = 0.0
                lane_status[l] = IN_LANE if excess[l] <= 0.0 else LEFT_LANES
            at_work += int(busy[AT_WORK + l])
            busy[LAST_INCREMENT + l] = change
        if at_work == 0:
            return
    for l in range(W):
        if busy[AT_WORK + l] > 0.0:
            lane_status[l] = LEFT_LANES


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _start_entry(
    grid: NodeGrid, tables: LaneTables, inputs: LaneInputs, y: Floats, state: Floats, ends: Floats,
    workspace: LaneWorkspace, full: bool,
) -> None:  # fmt: skip
    """Hand on S and r from before the tissue, with what of element 0 lies in it."""
    sums, handed, excess = workspace.entry, workspace.work[S : S + W5], workspace.work[EXCESS : EXCESS + W1]
    for l in range(5 * W):
        handed[l] = ends[l]
    for l in range(W):
        excess[l] = -np.inf
    if grid.first[1] == 0:
        return
    span = np.empty(4 * W)
    for l in range(2 * W):
        span[l], span[2 * W + l] = ends[5 * W + l], state[l]
    for l in range(0 if full else STIFFNESS_ROWS * W, SUM_ROWS * W):  # a chord pass keeps K
        sums[l] = 0.0
    for q in range(0, grid.first[1], 2):
        _add_interval(grid, tables, inputs, y, span, U(0), q, workspace.tangents, sums, full)
    # The first node of element 0 is the prescribed end of the front: its columns go to the right-hand side.
    for l in range(W1):
        v0, v1 = ends[W5 + l], ends[W6 + l]
        handed[l] += sums[K22 + l]
        handed[W1 + l] += sums[K23 + l]
        handed[W2 + l] += sums[K33 + l]
        handed[W3 + l] += sums[F2 + l] - sums[K02 + l] * v0 - sums[K12 + l] * v1
        handed[W4 + l] += sums[F3 + l] - sums[K03 + l] * v0 - sums[K13 + l] * v1
        excess[l] = sums[OVER + l]


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _eliminate(
    grid: NodeGrid, tables: LaneTables, inputs: LaneInputs, y: Floats, state: Floats, last: int,
    workspace: LaneWorkspace, full: bool,
) -> None:  # fmt: skip
    """Go from the first node in the tissue to the tip, element by element."""
    layers, rigidity, sums, work = inputs.layers, inputs.rigidity, workspace.sums, workspace.work
    firsts, layer, constraint, regular_row, regular = (
        grid.first, grid.layer, grid.constraint, tables.regular_row, tables.regular,
    )  # fmt: skip
    for e in range(1, last + 1):
        node, own, q = U(e - 1) * NODE_STATE_OFFSET, U(e) * NODE, firsts[e]
        if regular_row[e] >= 0:
            point, row = U(constraint[q]) * W1, U(regular_row[e])
            first, second = U(layer[q]) * LAYER_OFFSET, U(layer[q + 2]) * LAYER_OFFSET
            if full:
                full_regular(state, node, y, point, layers, first, second, regular, row, rigidity, work, own)
            else:
                chord_regular(state, node, y, point, layers, first, second, regular, row, work, own)
            continue
        for l in range(SUM_ROWS * W):
            sums[l] = 0.0
        for p in range(q, firsts[e + 1], 2):
            _add_interval(grid, tables, inputs, y, state, node, p, workspace.tangents, sums, full)
        if full:
            full_sums(sums, tables.bending, U(e), rigidity, work, own)
        else:
            chord_sums(sums, work, own)
    if full:
        solve_tip(work, U(last + 1) * NODE)
    else:
        solve_tip_chord(work, U(last + 1) * NODE)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _add_interval(
    grid: NodeGrid, tables: LaneTables, inputs: LaneInputs, y: Floats, state: Floats, node: np.uint64, q: int,
    tangents: Floats, sums: Floats, full: bool,
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
