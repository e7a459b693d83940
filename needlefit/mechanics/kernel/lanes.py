"""Many parameter sets of one insertion at once: a set is a lane of the processor's vectors.

The control flow of an insertion is the same for all parameters, so every loop over lanes is the innermost
one (`passes`). Each lane takes its own decisions and none of them looks at another lane: it freezes at a
stop where it has converged, and leaves for the scalar kernel where its tissue is compressed beyond the
series of its law or the solution is lost.

A stop costs one full Newton pass; the lanes that are not converged then make a second one with the factor
of the first, which costs half; further passes are full ones.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from needlefit.mechanics.kernel.grid import SLACK, Grid
from needlefit.mechanics.kernel.hermite import hermite
from needlefit.mechanics.kernel.insertion import Holds, Insertion, Stops, grid_at
from needlefit.mechanics.kernel.passes import (
    EXCESS,
    LANES,
    NODE,
    POINT,
    SUMS,
    R,
    S,
    back,
    back_tip,
    chord_interval,
    chord_regular,
    chord_sums,
    foresee,
    full_interval,
    full_regular,
    full_sums,
    last_chord,
    last_node,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

W = LANES
ROUNDING = 1e-4  # mm; an increment this small that no longer shrinks is rounding
MOST = 12  # passes at one stop; a lane that needs more leaves
HERE, LEFT = 0, 1  # a lane: under way, gone to the scalar kernel


class LaneInputs(NamedTuple):
    """What differs between lanes."""

    rigidity: Floats  # (W,) EI, N mm^2
    layers: Floats  # (n, LAYER W) series of k in |e|, and the |e| up to which it holds
    curvature: Floats  # (W,) a full pass leaves at most about this times its increment squared, 1 / mm
    base: Floats  # (3, W) y, slope, slope of the stage's axis
    before: Floats  # (F, 3, W) x, y, slope (NaN: free, then in all lanes) of the guides before the tissue
    turn: Floats  # (S, W) of each stop's bevel


class Lanes(NamedTuple):
    """The insertion under way in all lanes; rows of W numbers."""

    y: Floats  # (M + 1, W) of the constraint points
    track: Floats  # (M + 1, 2 W) deflection and slope of the tip as it stood at each
    rays: Floats  # (R, 3 W) y and slope of the tip where each ray begins, and the bevel's turn
    starts: Floats  # (R,) depth where each ray begins, mm
    states: Floats  # (2, N, 2 W) deflection and slope of the nodes in the tissue, now and one cell ago
    nodes: Floats  # (N,) their depth now
    at: Ints  # (W,) HERE or LEFT
    passes: Ints  # (W,) full or half Newton passes
    size: Ints  # (4,) nodes in the tissue now, whether they are the main grid's, nodes one cell ago, and
    # which of the two states is now
    depth: Floats  # (1,) of the tip, mm


class Room(NamedTuple):
    """Where the passes work; what they keep from one to the next."""

    work: Floats  # (N + 2) NODE, what was handed on from before the tissue, then one row of rows per node
    tangents: Floats  # (Q W,) of the points of elements that are not regular
    sums: Floats  # (SUMS,) of one such element
    entry: Floats  # (SUMS,) of element 0


class Tables(NamedTuple):
    """A grid as the loops over lanes read it."""

    points: Floats  # (Q, POINT) N, w N, w N N of every point
    bending: Floats  # (N, 4) 12, 6 l, 4 l^2, 2 l^2 over l^3 of the element that ends at each node
    regular: Floats  # (T, 4 POINT + 4) of the different elements with two intervals
    which: Ints  # (N,) the row of an element in `regular`, -1 for elements of another kind


@njit(cache=True, nogil=True)
def begin_lanes(cells: int, nodes: int, rays: int) -> Lanes:
    """Return lanes before first contact."""
    return Lanes(
        np.zeros((cells + 1, W)), np.full((cells + 1, 2 * W), np.nan), np.zeros((rays, 3 * W)),
        np.zeros(rays), np.zeros((2, nodes, 2 * W)), np.zeros(nodes),
        np.zeros(W, np.int64), np.zeros(W, np.int64), np.zeros(4, np.int64), np.zeros(1),
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def advance_lanes(
    lanes: Lanes, insertion: Insertion, main: Tables, holds: Holds, inputs: LaneInputs, stops: Stops,
    tolerance: float,
) -> None:  # fmt: skip
    """Bring the needles of all lanes from stop to stop; else as `insertion.advance`.

    `insertion` lends its grids, `holds` the places of what holds the needle.
    """
    nodes = lanes.states.shape[1]
    points = len(insertion.main.x) + 8
    room = Room(np.zeros((nodes + 2) * NODE), np.zeros(points * W), np.zeros(SUMS), np.zeros(SUMS))
    for s in range(len(stops.tip)):
        tip, cell = stops.tip[s], stops.cell[s]
        _place(lanes, inputs, stops, s)
        on_main = stops.permanent[s] and cell > 0
        grid, tables = insertion.main, main
        if not on_main:
            grid = grid_at(insertion, holds, tip, cell)
            tables = tabulate(grid)
        last = np.searchsorted(grid.nodes, tip - SLACK)
        _carry(lanes, grid, last, on_main)
        ends = _front(lanes, inputs, grid, tables, tip, insertion.length)
        _equilibrate(lanes, inputs, grid, tables, last, ends, room, tolerance)
        lanes.depth[0] = tip
        for l in range(2 * W):
            lanes.track[cell, l] = lanes.states[lanes.size[3], last, l]
        here = 0
        for l in range(W):
            here += int(lanes.at[l] == HERE)
        if here == 0:
            return


@njit(cache=True, nogil=True)
def tabulate(grid: Grid) -> Tables:
    """Return the tables of a grid; those of element 0 are filled when its length is known."""
    count = len(grid.nodes)
    points, bending = np.zeros((len(grid.x), POINT)), np.zeros((count, 4))
    regular, which, kinds = np.empty((count, 4 * POINT + 4)), np.full(count, -1), 0
    for e in range(1, count):
        length = grid.nodes[e] - grid.nodes[e - 1]
        _stiffness(bending[e], length)
        for q in range(grid.first[e], grid.first[e + 1]):
            _tabulate_point(points[q], grid.shapes[q], grid.weight[q])
        first = grid.first[e]
        if grid.first[e + 1] - first != 4 or grid.constraint[first + 2] != grid.constraint[first] + 1:
            continue
        row = regular[kinds]
        for q in range(4):
            for i in range(POINT):
                row[q * POINT + i] = points[first + q, i]
        for i in range(4):
            row[4 * POINT + i] = bending[e, i]
        which[e] = kinds
        if kinds > 0 and _alike(row, regular[kinds - 1]):
            which[e] -= 1
        else:
            kinds += 1
    return Tables(points, bending, regular[:kinds].copy(), which)


@njit(cache=True, nogil=True)
def _alike(row: Floats, other: Floats) -> bool:
    """Return whether two tables are the same but for rounding; one of them then stays in the cache."""
    different = 0
    for i in range(len(row)):
        different += int(abs(row[i] - other[i]) > 1e-12 * abs(other[i]))
    return different == 0


@njit(cache=True, nogil=True)
def _tabulate_point(row: Floats, shape: Floats, weight: float) -> None:
    at = 8
    for i in range(4):
        row[i], row[4 + i] = shape[i], weight * shape[i]
        for j in range(i, 4):
            row[at] = weight * shape[i] * shape[j]
            at += 1


@njit(cache=True, nogil=True)
def _stiffness(row: Floats, length: float) -> None:
    row[0], row[1], row[2], row[3] = 12.0 / length**3, 6.0 / length**2, 4.0 / length, 2.0 / length


@njit(cache=True, nogil=True)
def _place(lanes: Lanes, inputs: LaneInputs, stops: Stops, s: int) -> None:
    """Put the constraint point under the tip of stop `s` on its ray, in every lane."""
    ray, cell = stops.ray[s], stops.cell[s]
    if stops.opens[s]:
        lanes.starts[ray] = lanes.depth[0]
        tip = lanes.states[lanes.size[3], lanes.size[0] - 1]
        for l in range(W):
            lanes.rays[ray, l], lanes.rays[ray, W + l] = tip[l], tip[W + l]
            lanes.rays[ray, 2 * W + l] = inputs.turn[s, l]
    if cell > 0:
        ahead, row, y = stops.tip[s] - lanes.starts[ray], lanes.rays[ray], lanes.y[cell]
        for l in range(W):
            y[l] = row[l] + ahead * (row[W + l] + row[2 * W + l])


@njit(cache=True, nogil=True)
def _carry(lanes: Lanes, grid: Grid, last: int, on_main: bool) -> None:
    """Guess the next stop from the last two, or, where there are none, from the shape as it is."""
    size, now = last + 1, lanes.size[3]
    old, known = lanes.size[0], lanes.size[2]
    state, other = lanes.states[now], lanes.states[1 - now]
    same = on_main and lanes.size[1] == 1
    grown = size - old
    lanes.size[0], lanes.size[1], lanes.size[2] = size, int(on_main), 0
    nodes = lanes.nodes
    if not same:
        if old > 0:
            _read(state, nodes[:old].copy(), other, grid.nodes[:size])
            lanes.size[3] = 1 - now
    elif grown > 0:
        bold = grown == old - known and known >= grown
        for i in range(size - 1, -1, -1):  # from the tip back: `other` is read behind where it is written
            if i >= old:
                ahead = grid.nodes[i] - nodes[old - 1]
                j, behind = i - grown, grid.nodes[i - grown] - nodes[known - 1]
                for l in range(W):
                    u, slope = state[old - 1, l], state[old - 1, W + l]
                    u += ahead * slope
                    if bold:  # as far beside the tangent as the cell before
                        u += state[j, l] - (other[known - 1, l] + behind * other[known - 1, W + l])
                        slope += state[j, W + l] - other[known - 1, W + l]
                    other[i, l], other[i, W + l] = u, slope
            elif bold:  # every node moves on as it, or the node one cell behind it, moved
                j = i if i < known else i - grown
                foresee(other[i], state[i], state[j], other[j])
            else:
                for l in range(2 * W):
                    other[i, l] = state[i, l]
        lanes.size[2], lanes.size[3] = old, 1 - now
    for i in range(size):
        nodes[i] = grid.nodes[i]


@njit(cache=True, nogil=True)
def _read(state: Floats, nodes: Floats, into: Floats, at: Floats) -> None:
    """Read the shapes `state` (N, 2 W) at other depths; beyond their ends they go straight on."""
    end, n = len(nodes) - 1, np.empty(8)
    for i in range(len(at)):
        if at[i] <= nodes[0] or at[i] >= nodes[end]:
            e = 0 if at[i] <= nodes[0] else end
            for l in range(W):
                into[i, l] = state[e, l] + (at[i] - nodes[e]) * state[e, W + l]
                into[i, W + l] = state[e, W + l]
            continue
        e = np.searchsorted(nodes, at[i]) - 1
        hermite(n, at[i] - nodes[e], nodes[e + 1] - nodes[e])
        for l in range(W):
            a0, a1, b0, b1 = state[e, l], state[e, W + l], state[e + 1, l], state[e + 1, W + l]
            into[i, l] = n[0] * a0 + n[1] * a1 + n[2] * b0 + n[3] * b1
            into[i, W + l] = n[4] * a0 + n[5] * a1 + n[6] * b0 + n[7] * b1


@njit(cache=True, nogil=True, error_model="numpy")
def _front(lanes: Lanes, inputs: LaneInputs, grid: Grid, tables: Tables, tip: float, length: float) -> Floats:
    """Condense base, guides and free spans to the first node in the tissue.

    What lies before the last node whose slope is held does not reach the tissue.

    Returns
    -------
    (7 W,) array
        S (3) and r (2) at the first node, deflection and slope of the last node before it; the tables of
        element 0 are filled where it has tissue.
    """
    last = len(inputs.before)  # the last node that is clamped; node 0 is the base
    while last > 0 and np.isnan(inputs.before[last - 1, 2, 0]):
        last -= 1
    held = tip - length if last == 0 else inputs.before[last - 1, 0, 0]
    for q in range(grid.first[1]):
        hermite(grid.shapes[q], grid.x[q] - held, grid.nodes[0] - held)
        _tabulate_point(tables.points[q], grid.shapes[q], grid.weight[q])
    ends = np.empty(7 * W)
    for l in range(W):
        s00 = s01 = s11 = r0 = r1 = 0.0
        x, y, slope = tip - length, inputs.base[0, l] + inputs.base[2, l] * tip, inputs.base[1, l]
        for i in range(last, len(inputs.before) + 1):
            if i > 0:
                x, y, slope = (
                    inputs.before[i - 1, 0, l],
                    inputs.before[i - 1, 1, l],
                    inputs.before[i - 1, 2, l],
                )
            span = (inputs.before[i, 0, l] if i < len(inputs.before) else grid.nodes[0]) - x
            f = inputs.rigidity[l] / (span * span * span)
            k00, k01, k11, k13 = 12.0 * f, 6.0 * f * span, 4.0 * f * span * span, 2.0 * f * span * span
            if i == last:
                s00, s01, s11, r0, r1 = k00, -k01, k11, k00 * y + k01 * slope, -k01 * y - k13 * slope
                continue
            s = s11 + k11  # of the slope of a guide that is passed freely
            g0, g1, z = -k01 / s, k13 / s, (r1 - (s01 + k01) * y) / s
            s00, s01, s11 = k00 + k01 * g0, -k01 + k01 * g1, k11 - k13 * g1
            r0, r1 = k00 * y + k01 * z, -k01 * y - k13 * z
        ends[l], ends[W + l], ends[2 * W + l], ends[3 * W + l], ends[4 * W + l] = s00, s01, s11, r0, r1
        ends[5 * W + l], ends[6 * W + l] = y, slope
    return ends


@njit(cache=True, nogil=True, error_model="numpy")
def _equilibrate(
    lanes: Lanes, inputs: LaneInputs, grid: Grid, tables: Tables, last: int, ends: Floats, room: Room,
    tolerance: float,
) -> None:  # fmt: skip
    """Newton passes until every lane has converged or left; what one lane does, no other sees."""
    state, y, work = lanes.states[lanes.size[3]].reshape(-1), lanes.y.reshape(-1), room.work
    busy = np.zeros(3 * W)  # whether a lane is at work, its increment, the one before
    for l in range(W):
        busy[l] = 1.0 if lanes.at[l] == HERE else 0.0
    for n in range(MOST):
        full = n != 1
        _enter(grid, tables, inputs, y, state, ends, room, full)
        _eliminate(grid, tables, inputs, y, state, last, room, full)
        back_tip(work[(last + 1) * NODE : (last + 2) * NODE], state[2 * W * last : 2 * W * (last + 1)], busy)
        for i in range(last - 1, -1, -1):
            back(work[(i + 1) * NODE : (i + 2) * NODE], state[2 * W * i : 2 * W * (i + 2)], busy)
        at_work = 0
        for l in range(W):
            if busy[l] == 0.0:
                continue
            lanes.passes[l] += 1
            change, before = busy[W + l], busy[2 * W + l]
            # the next increment: a full pass squares it, a half one multiplies it by the one before
            ahead = inputs.curvature[l] * change * (change if full else 2.0 * before)
            stalled = n > 1 and change < ROUNDING and change > 0.5 * before
            if not (np.isfinite(change) and work[(last + 1) * NODE + EXCESS + l] <= 0.0):
                lanes.at[l], busy[l] = LEFT, 0.0
            elif min(change, ahead) < tolerance or stalled:
                busy[l] = 0.0
            at_work += int(busy[l])
            busy[2 * W + l] = change
        if at_work == 0:
            return
    for l in range(W):
        if busy[l] > 0.0:
            lanes.at[l] = LEFT


@njit(cache=True, nogil=True, error_model="numpy")
def _enter(
    grid: Grid,
    tables: Tables,
    inputs: LaneInputs,
    y: Floats,
    state: Floats,
    ends: Floats,
    room: Room,
    full: bool,
) -> None:
    """Hand on S and r from before the tissue, with what of element 0 lies in it."""
    work, sums = room.work, room.entry
    for l in range(5 * W):
        work[S + l] = ends[l]
    for l in range(W):
        work[EXCESS + l] = -np.inf
    if grid.first[1] == 0:
        return
    span = np.empty(4 * W)
    for l in range(2 * W):
        span[l], span[2 * W + l] = ends[5 * W + l], state[l]
    for l in range(0 if full else 10 * W, SUMS):  # a half pass keeps the stiffness
        sums[l] = 0.0
    for q in range(0, grid.first[1], 2):
        _interval(grid, tables, inputs, y, span, q, room.tangents, sums, full)
    for l in range(W):
        v0, v1 = ends[5 * W + l], ends[6 * W + l]
        for i in range(3):
            work[S + i * W + l] += sums[(7 + i) * W + l]
        work[R + l] += sums[12 * W + l] - sums[2 * W + l] * v0 - sums[5 * W + l] * v1
        work[R + W + l] += sums[13 * W + l] - sums[3 * W + l] * v0 - sums[6 * W + l] * v1
        work[EXCESS + l] = sums[14 * W + l]


@njit(cache=True, nogil=True, error_model="numpy")
def _eliminate(
    grid: Grid,
    tables: Tables,
    inputs: LaneInputs,
    y: Floats,
    state: Floats,
    last: int,
    room: Room,
    full: bool,
) -> None:
    """Go from the first node in the tissue to the tip, element by element."""
    layers, rigidity, sums = inputs.layers, inputs.rigidity, room.sums
    for e in range(1, last + 1):
        ends, work = state[2 * W * (e - 1) : 2 * W * (e + 1)], room.work[(e - 1) * NODE : (e + 1) * NODE]
        q = grid.first[e]
        if tables.which[e] >= 0:
            table, c = tables.regular[tables.which[e]], grid.constraint[q]
            points, first, second = y[c * W : (c + 2) * W], layers[grid.layer[q]], layers[grid.layer[q + 2]]
            if full:
                full_regular(ends, points, first, second, table, rigidity, work)
            else:
                chord_regular(ends, points, first, second, table, work)
            continue
        for l in range(SUMS):
            sums[l] = 0.0
        for p in range(q, grid.first[e + 1], 2):
            _interval(grid, tables, inputs, y, ends, p, room.tangents, sums, full)
        if full:
            full_sums(sums, tables.bending[e], rigidity, work)
        else:
            chord_sums(sums, work)
    work = room.work[last * NODE : (last + 2) * NODE]
    if full:
        last_node(work)
    else:
        last_chord(work)


@njit(cache=True, nogil=True, error_model="numpy")
def _interval(
    grid: Grid, tables: Tables, inputs: LaneInputs, y: Floats, ends: Floats, q: int, tangents: Floats,
    sums: Floats, full: bool,
) -> None:  # fmt: skip
    """Add the interval whose first point is `q` to the sums of its element."""
    c = grid.constraint[q]
    table = tables.points[q : q + 2].reshape(-1)
    point, layer, kept = y[c * W : (c + 1) * W], inputs.layers[grid.layer[q]], tangents[q * W : (q + 2) * W]
    if full:
        full_interval(ends, point, layer, table, kept, sums)
    else:
        chord_interval(ends, point, layer, table, kept, sums)
