"""One equilibrium in all lanes.

A full Newton pass; for the lanes that are not converged then a second one with the factor of the first,
which costs half; further passes are full ones.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from needlefit.mechanics.kernel.grid import Grid
from needlefit.mechanics.kernel.lanes.passes import (
    EXCESS,
    LANES,
    LAYER,
    NODE,
    SUMS,
    W1,
    W5,
    S,
    back,
    back_tip,
    chord_interval,
    chord_regular,
    chord_sums,
    full_interval,
    full_regular,
    full_sums,
    last_chord,
    last_node,
)  # fmt: skip
from needlefit.mechanics.kernel.lanes.tables import Tables
from needlefit.mechanics.kernel.scalar import ROUNDING, Newton

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

W = LANES
U = np.uint64
PAIR, LAYER_ROWS = U(2 * LANES), U(LAYER * LANES)  # deflections and slopes of a node; a layer
MOST = 12  # passes at one stop; a lane that needs more leaves
HERE, LEFT = 0, 1  # a lane: under way, gone to the scalar kernel


class LaneInputs(NamedTuple):
    """What differs between lanes."""

    rigidity: Floats  # (W,) EI, N mm^2
    layers: Floats  # (n LAYER W,) series of k in |e|, and the |e| up to which it holds
    curvature: Floats  # (W,) a full pass leaves at most about this times its increment squared, 1 / mm
    base: Floats  # (3, W) y, slope, slope of the stage's axis
    before: Floats  # (F, 3, W) x, y, slope (NaN: free, then in all lanes) of the guides before the tissue
    turn: Floats  # (S, W) of each stop's bevel


class Room(NamedTuple):
    """Where the passes work; what they keep from one to the next."""

    work: Floats  # ((N + 2) ROWS W,) what was handed on from before the tissue, then the rows of each node
    tangents: Floats  # (Q W,) of the points of elements that are not regular
    sums: Floats  # (SUMS W,) of one such element
    entry: Floats  # (SUMS W,) of element 0


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def equilibrate_lanes(
    state: Floats, y: Floats, at: Ints, passes: Ints, inputs: LaneInputs, grid: Grid, tables: Tables,
    last: int, ends: Floats, room: Room, newton: Newton,
) -> None:  # fmt: skip
    """Make Newton passes until every lane has converged or left; what one lane does, no other sees.

    Parameters
    ----------
    state : (N 2 W,) array
        Deflection and slope of the nodes in the tissue: a guess, replaced by the answer.
    y : ((M + 1) W,) array
        Constraint points, mm.
    at, passes : (W,) arrays
        HERE or LEFT; the passes so far.
    last : int
        The tip's node.
    ends : (7 W,) array
        S and r that the needle before the tissue hands on, and its last node.
    """
    work = room.work
    busy = np.zeros(3 * W)  # whether a lane is at work, its increment, the one before
    for l in range(W):
        busy[l] = 1.0 if at[l] == HERE else 0.0
    for n in range(min(MOST, newton.max_iterations)):
        full = n != 1
        _enter(grid, tables, inputs, y, state, ends, room, full)
        _eliminate(grid, tables, inputs, y, state, last, room, full)
        back_tip(work, U(last + 1) * NODE, state, U(last) * PAIR, busy)
        for i in range(last - 1, -1, -1):
            back(work, U(i + 1) * NODE, state, U(i) * PAIR, busy)
        at_work = 0
        excess = work[U(last + 1) * NODE + EXCESS :]
        for l in range(W):
            if busy[l] == 0.0:
                continue
            passes[l] += 1
            change, before = busy[W + l], busy[2 * W + l]
            # the next increment: a full pass squares it, a half one multiplies it by the one before
            ahead = inputs.curvature[l] * change * (change if full else 2.0 * before)
            stalled = n > 1 and change < ROUNDING and change > 0.5 * before
            if not np.isfinite(change):
                at[l], busy[l] = LEFT, 0.0
            elif min(change, ahead) < newton.tolerance or stalled:
                busy[l] = 0.0  # on the way there a guess may have left the series, the answer may not
                at[l] = HERE if excess[l] <= 0.0 else LEFT
            at_work += int(busy[l])
            busy[2 * W + l] = change
        if at_work == 0:
            return
    for l in range(W):
        if busy[l] > 0.0:
            at[l] = LEFT


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _enter(
    grid: Grid, tables: Tables, inputs: LaneInputs, y: Floats, state: Floats, ends: Floats, room: Room,
    full: bool,
) -> None:  # fmt: skip
    """Hand on S and r from before the tissue, with what of element 0 lies in it."""
    sums, handed, excess = room.entry, room.work[S : S + W5], room.work[EXCESS : EXCESS + W1]
    for l in range(5 * W):
        handed[l] = ends[l]
    for l in range(W):
        excess[l] = -np.inf
    if grid.first[1] == 0:
        return
    span = np.empty(4 * W)
    for l in range(2 * W):
        span[l], span[2 * W + l] = ends[5 * W + l], state[l]
    for l in range(0 if full else 10 * W, SUMS * W):  # a half pass keeps the stiffness
        sums[l] = 0.0
    for q in range(0, grid.first[1], 2):
        _interval(grid, tables, inputs, y, span, U(0), q, room.tangents, sums, full)
    for l in range(W):
        v0, v1 = ends[5 * W + l], ends[6 * W + l]
        for i in range(3):
            handed[i * W + l] += sums[(7 + i) * W + l]
        handed[3 * W + l] += sums[12 * W + l] - sums[2 * W + l] * v0 - sums[5 * W + l] * v1
        handed[4 * W + l] += sums[13 * W + l] - sums[3 * W + l] * v0 - sums[6 * W + l] * v1
        excess[l] = sums[14 * W + l]


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _eliminate(
    grid: Grid, tables: Tables, inputs: LaneInputs, y: Floats, state: Floats, last: int, room: Room,
    full: bool,
) -> None:  # fmt: skip
    """Go from the first node in the tissue to the tip, element by element."""
    layers, rigidity, sums, work = inputs.layers, inputs.rigidity, room.sums, room.work
    firsts, layer, constraint, which, regular = (
        grid.first, grid.layer, grid.constraint, tables.which, tables.regular,
    )  # fmt: skip
    for e in range(1, last + 1):
        node, own, q = U(e - 1) * PAIR, U(e) * NODE, firsts[e]
        if which[e] >= 0:
            point, row = U(constraint[q]) * W1, U(which[e])
            first, second = U(layer[q]) * LAYER_ROWS, U(layer[q + 2]) * LAYER_ROWS
            if full:
                full_regular(state, node, y, point, layers, first, second, regular, row, rigidity, work, own)
            else:
                chord_regular(state, node, y, point, layers, first, second, regular, row, work, own)
            continue
        for l in range(SUMS * W):
            sums[l] = 0.0
        for p in range(q, firsts[e + 1], 2):
            _interval(grid, tables, inputs, y, state, node, p, room.tangents, sums, full)
        if full:
            full_sums(sums, tables.bending, U(e), rigidity, work, own)
        else:
            chord_sums(sums, work, own)
    if full:
        last_node(work, U(last + 1) * NODE)
    else:
        last_chord(work, U(last + 1) * NODE)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _interval(
    grid: Grid, tables: Tables, inputs: LaneInputs, y: Floats, state: Floats, node: np.uint64, q: int,
    tangents: Floats, sums: Floats, full: bool,
) -> None:  # fmt: skip
    """Add the interval whose first point is `q` to the sums of its element."""
    point, layer, kept = U(grid.constraint[q]) * W1, U(grid.layer[q]) * LAYER_ROWS, U(q) * W1
    if full:
        full_interval(state, node, y, point, inputs.layers, layer, tables.points, U(q), tangents, kept, sums)
    else:
        chord_interval(state, node, y, point, inputs.layers, layer, tables.points, U(q), tangents, kept, sums)
