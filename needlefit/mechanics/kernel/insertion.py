"""Insert one needle: the tip goes from stop to stop, and each equilibrium leaves a constraint point
behind.
"""

import math
from typing import NamedTuple

import numba
import numpy as np
from numba import njit, types
from numba.experimental import structref

from needlefit.arrays import Bools, Floats, Ints
from needlefit.mechanics.kernel.beam import HERMITE_COLUMNS, count_below, fill_hermite
from needlefit.mechanics.kernel.foundation import Foundation, make_foundation
from needlefit.mechanics.kernel.grid import (
    GUIDE_ENGAGEMENT_MM,
    LINEAR_CUT,
    SAME_DEPTH_MM,
    NodeGrid,
    build_grid,
    find_cell,
    list_constraint_depths,
    list_node_depths,
)
from needlefit.mechanics.kernel.scalar import (
    CLAMPED,
    CONVERGED,
    FACTOR_COLUMNS,
    FREE,
    PINNED,
    Chain,
    NewtonOptions,
    equilibrate,
)

GUIDE_X, GUIDE_Y, GUIDE_SLOPE = 0, 1, 2  # columns of a guide
RAY_X, RAY_Y, RAY_SLOPE, RAY_TURN = 0, 1, 2, 3  # columns of a ray
NOW, ONE_CELL_AGO, TWO_CELLS_AGO = 0, 1, 2  # first index of `KernelInsertion.states`
CHAIN_NODES, FRONT_NODES, ON_MAIN_GRID, PREVIOUS_NODES = 0, 1, 2, 3  # index of `KernelInsertion.size`


class TipStops(NamedTuple):
    """The stops of the tip in order, (S,) arrays; `mechanics.plan.TipStop` describes each field."""

    tip: Floats
    cell: Ints
    permanent: Bools
    ray: Ints
    starts_ray: Bools
    extrapolates: Bools  # whether the ray takes on the tip's slope half a cell ahead
    turn: Floats  # of the bevel that cuts the ray, the slope that it adds: s b / C_int, or s theta


class BoundaryConditions(NamedTuple):
    """Prescribed deflections and slopes of base, guides and tip, in C; a slope that is left free is NaN."""

    base: Floats  # (3,) y, slope, slope of the stage's axis
    before: Floats  # (G, 3) x, y, slope of the guides before the tissue
    within: Floats  # (H, 3) of those in it
    tip: Floats  # (2,) y, slope; NaN where the tip is not tracked


class KernelInsertion(NamedTuple):
    """The state of an insertion: the needle, its position, constraint points and rays of all stops so far."""

    rigidity: float  # EI, N mm^2
    length: float  # mm
    first_cell: float  # mm
    spacing: float  # C_int, mm
    element: float  # h, mm
    switch: float  # where between two constraint points the target changes from one to the other, or
    # LINEAR_CUT, and the needle advances by the path angle
    tangent: float  # part of the tip's slope that a ray takes on
    boundaries: Floats  # (n - 1,) mm
    main: NodeGrid  # of all constraint points that the tip can reach
    y: Floats  # (M + 1,) of the constraint points, mm
    track: Floats  # (M + 1, 2) deflection and slope of the tip as it stood at each
    rays: Floats  # (R, 4) x, y where each ray begins, the slope that it takes on, the bevel's turn
    tip: Floats  # (4,) x, y, slope of the tip now, y of the cut there
    nodes: Floats  # (C,) depth of the chain's nodes now
    states: Floats  # (3, C, 2) their deflection and slope: now, one cell ago, two cells ago
    size: Ints  # (4,) nodes of the chain, those before the tissue, whether the rest are the main grid's,
    # and nodes of the chain one cell ago (0: there was no such stop)
    record: Floats  # (S, C + 2, 2) for derivatives: the state at each stop under way; below it the y of the
    # constraint point there, the depth where its ray begins, and the y of point 0. (0, C + 2, 2): not wanted


class InsertionRun(structref.StructRefProxy):
    """All that the kernel needs to insert a needle, in one object that it unpacks by itself.

    Python hands a compiled function one array after the other: some forty here, in twice the time of a step.
    The arrays are shared with Python, which may write into them.
    """

    insertion: KernelInsertion
    before: KernelInsertion  # what the last stops have changed, as it was before them
    foundation: Foundation
    conditions: BoundaryConditions
    stops: TipStops
    newton: NewtonOptions


@structref.register
class InsertionRunType(types.StructRef):
    """The type of an `InsertionRun` in compiled functions."""


structref.define_proxy(  # type: ignore[no-untyped-call]
    InsertionRun, InsertionRunType, list(InsertionRun.__annotations__)
)


@njit(cache=True, nogil=True)
def begin_insertion(
    rigidity: float, length: float, first_cell: float, spacing: float, element: float, switch: float,
    tangent: float, boundaries: Floats, deepest: float, guides: int, rays: int, recorded: int,
) -> KernelInsertion:  # fmt: skip
    """Return a needle before first contact, arrays reaching to `deepest` (mm), so many guides and rays, and
    recorded stops.
    """
    cells = max(find_cell(deepest, first_cell, spacing), 1)
    tip = first_cell + (cells - 1) * spacing
    nodes = list_node_depths(tip, first_cell, spacing, element, np.empty(0))
    main = build_grid(list_constraint_depths(tip, cells, first_cell, spacing), boundaries, nodes, switch)
    capacity = len(nodes) + guides + 3  # base, entry, a tip between constraint points
    y = np.full(cells + 1, np.nan)  # what a failed insertion never reached stays NaN
    y[0] = 0.0
    return KernelInsertion(
        rigidity, length, first_cell, spacing, element, switch, tangent, boundaries, main, y,
        np.full((cells + 1, 2), np.nan), np.zeros((rays, 4)),
        np.zeros(4), np.zeros(capacity), np.zeros((3, capacity, 2)), np.zeros(4, np.int64),
        np.zeros((recorded, capacity + 2, 2)),
    )  # fmt: skip


@njit(cache=True, nogil=True)
def begin_run(
    rigidity: float, length: float, first_cell: float, spacing: float, element: float, switch: float,
    tangent: float, boundaries: Floats, deepest: float, guides: int, rays: int, recorded: int,
    mu: Floats, coefficients: Floats, exponents: Floats, thickness: Floats, friction: Floats,
    newton: NewtonOptions,
) -> InsertionRun:  # fmt: skip
    """Return the needle of `begin_insertion` in the tissue of `make_foundation`, without inputs or stops."""
    now = begin_insertion(
        rigidity, length, first_cell, spacing, element, switch, tangent, boundaries, deepest, guides, rays,
        recorded,
    )  # fmt: skip
    before = KernelInsertion(
        rigidity, length, first_cell, spacing, element, switch, tangent, boundaries, now.main,
        np.empty_like(now.y), np.empty_like(now.track), np.empty_like(now.rays), np.empty_like(now.tip),
        np.empty_like(now.nodes), np.empty_like(now.states), np.empty_like(now.size), now.record,
    )  # fmt: skip
    foundation = make_foundation(mu, coefficients, exponents, thickness, friction)
    no_guides, numbers, flags = np.empty((0, 3)), np.empty(0, np.int64), np.empty(0, np.bool_)
    conditions = BoundaryConditions(np.empty(3), no_guides, no_guides, np.empty(2))
    stops = TipStops(np.empty(0), numbers, flags, numbers, flags, flags, np.empty(0))
    return InsertionRun(  # type: ignore[no-untyped-call]
        now, before, foundation, conditions, stops, newton
    )


@njit(cache=True, nogil=True)
def set_inputs(run: InsertionRun, conditions: BoundaryConditions, stops: TipStops) -> None:
    """Let the next `advance_needle` hold the needle by those conditions, and read those stops."""
    run.conditions, run.stops = conditions, stops


@njit(cache=True, nogil=True)
def get_insertion(run: InsertionRun) -> KernelInsertion:
    """Return the arrays of a run to Python, which shares them."""
    return run.insertion


def make_run_type(
    insertion: KernelInsertion, foundation: Foundation, conditions: BoundaryConditions, stops: TipStops,
    newton: NewtonOptions,
) -> InsertionRunType:  # fmt: skip
    """Return the type of a run of such parts."""
    parts = insertion, insertion, foundation, conditions, stops, newton
    found = [numba.typeof(part) for part in parts]  # type: ignore[no-untyped-call]
    fields = zip(InsertionRun.__annotations__, found, strict=True)
    return InsertionRunType(list(fields))  # type: ignore[no-untyped-call]


@njit(cache=True, nogil=True)
def return_needle(run: InsertionRun, count: int) -> None:
    """Return the needle to where it stood before the last `advance_needle`, of so many stops."""
    _copy_changed(run.insertion, run.before, run.stops, count)


@njit(cache=True, nogil=True)
def _copy_changed(into: KernelInsertion, source: KernelInsertion, stops: TipStops, count: int) -> None:
    """Copy what the first `count` stops may change."""
    into.y[0] = source.y[0]  # set by a cut that begins at the entry
    for s in range(count):
        cell, ray = stops.cell[s], stops.ray[s]
        into.y[cell] = source.y[cell]
        for j in range(2):
            into.track[cell, j] = source.track[cell, j]
        if ray >= 0:
            for j in range(4):
                into.rays[ray, j] = source.rays[ray, j]
    for j in range(4):
        into.tip[j], into.size[j] = source.tip[j], source.size[j]
    for i in range(source.size[CHAIN_NODES]):
        into.nodes[i] = source.nodes[i]
        for k in range(3):
            for j in range(2):
                into.states[k, i, j] = source.states[k, i, j]


@njit(cache=True, nogil=True, error_model="numpy")
def advance_needle(run: InsertionRun, count: int) -> tuple[int, int, Floats, Floats]:
    """Bring the needle to the first `count` stops of the run.

    Returns
    -------
    status, iterations : int
        Where a stop fails the needle's state must not be used before `return_needle`.
    shape : (3, N) array
        Depth, deflection and slope of the nodes at the last stop; empty where one fails.
    points : (2, M + 1, 2) array
        The constraint points there, and the tip's track.
    """
    insertion, foundation, conditions = run.insertion, run.foundation, run.conditions
    stops, newton = run.stops, run.newton
    _copy_changed(run.before, insertion, stops, count)
    iterations = 0
    rays, y, tip, states, size = insertion.rays, insertion.y, insertion.tip, insertion.states, insertion.size
    record, capacity = insertion.record, insertion.states.shape[1]
    chain = begin_chain(conditions, insertion.rigidity, capacity)
    trial, factor = np.empty((capacity, 2)), np.empty((capacity, FACTOR_COLUMNS))
    for s in range(count):
        depth, cell, ray = stops.tip[s], stops.cell[s], stops.ray[s]
        if stops.starts_ray[s]:
            rays[ray, RAY_X], rays[ray, RAY_Y], rays[ray, RAY_TURN] = tip[0], tip[1], stops.turn[s]
            rays[ray, RAY_SLOPE] = insertion.tangent * tip[2]
            if insertion.switch == LINEAR_CUT:
                rays[ray, RAY_Y] = tip[3]
                if tip[0] == 0.0:  # the cut begins where the tip is, under the inputs that hold now
                    y[0] = tip[3]
                if stops.extrapolates[s]:
                    rays[ray, RAY_SLOPE] += 0.5 * (tip[2] - insertion.track[cell - 2, 1])
        # At the entry (cell 0) there is no cut yet: c_0 = 0 defines the frame.
        if cell > 0:
            ahead, direction = depth - rays[ray, RAY_X], rays[ray, RAY_SLOPE] + rays[ray, RAY_TURN]
            y[cell] = rays[ray, RAY_Y] + ahead * direction
        # Nodes of the main grid lie at fixed depths, so every prefix of it is the grid of a stop at a
        # constraint point. Guides in the tissue have nodes of their own.
        on_main = stops.permanent[s] and cell > 0 and len(conditions.within) == 0
        if on_main:
            grid = insertion.main
            last = count_below(grid.nodes, depth - SAME_DEPTH_MM)
        else:
            grid = build_stop_grid(insertion, conditions, depth, cell)
            last = len(grid.nodes) - 1
        prescribe_stop(chain, conditions, grid, last, depth, insertion.length)
        extrapolated = guess_next_state(insertion, chain, grid, last, on_main)
        status, used = equilibrate(states[NOW], chain, foundation, grid, y, last, newton, trial, factor)
        iterations += used
        # The extrapolated guess may lie outside the range from which Newton's method converges. A loop would
        # compile `equilibrate` once, and run 2 % slower.
        if status != CONVERGED and extrapolated:
            extend_straight(insertion, chain, grid)
            status, used = equilibrate(states[NOW], chain, foundation, grid, y, last, newton, trial, factor)
            iterations += used
        if status != CONVERGED:
            return status, iterations, np.empty((3, 0)), np.empty((2, 0, 2))
        end = size[CHAIN_NODES] - 1
        tip[0], tip[1], tip[2] = depth, states[NOW, end, 0], states[NOW, end, 1]
        tip[3] = y[cell] if cell > 0 else tip[1]
        insertion.track[cell, 0], insertion.track[cell, 1] = tip[1], tip[2]
        if len(record) > 0:
            for i in range(size[CHAIN_NODES]):
                record[s, i, 0], record[s, i, 1] = states[NOW, i, 0], states[NOW, i, 1]
            record[s, capacity, 0], record[s, capacity, 1] = y[cell], rays[ray, RAY_X]
            record[s, capacity + 1, 0] = y[0]
    shape, points = _copy_shape(insertion, stops.cell[count - 1], stops.tip[count - 1])
    return CONVERGED, iterations, shape, points


@njit(cache=True, nogil=True)
def _copy_shape(insertion: KernelInsertion, cell: int, tip: float) -> tuple[Floats, Floats]:
    """Return depth, deflection and slope of the nodes (3, N), and the constraint points and the tip's track
    (2, cell + 1, 2), of a needle with its tip in `cell`.
    """
    y, track, nodes, states = insertion.y, insertion.track, insertion.nodes, insertion.states
    shape, points = np.empty((3, insertion.size[CHAIN_NODES])), np.empty((2, cell + 1, 2))
    for i in range(shape.shape[1]):
        shape[0, i], shape[1, i], shape[2, i] = nodes[i], states[NOW, i, 0], states[NOW, i, 1]
    depths = list_constraint_depths(tip, cell, insertion.first_cell, insertion.spacing)
    for m in range(cell + 1):
        points[0, m, 0], points[0, m, 1] = depths[m], y[m]
        points[1, m, 0], points[1, m, 1] = track[m, 0], track[m, 1]
    return shape, points


@njit(cache=True, nogil=True)
def build_stop_grid(
    insertion: KernelInsertion, conditions: BoundaryConditions, tip: float, cell: int
) -> NodeGrid:
    """Return the grid of one stop that the main grid does not serve: the tip between constraint points, or
    guides in the tissue.
    """
    count = 0  # guides are sorted by depth
    while count < len(conditions.within) and conditions.within[count, GUIDE_X] <= tip - GUIDE_ENGAGEMENT_MM:
        count += 1
    active = np.empty(count)
    for i in range(count):
        active[i] = conditions.within[i, GUIDE_X]
    nodes = list_node_depths(tip, insertion.first_cell, insertion.spacing, insertion.element, active)
    points = list_constraint_depths(tip, cell, insertion.first_cell, insertion.spacing)
    return build_grid(points, insertion.boundaries, nodes, insertion.switch)


@njit(cache=True, nogil=True)
def list_chain_nodes(
    insertion: KernelInsertion, conditions: BoundaryConditions, tip: float, cell: int
) -> Floats:
    """Return the depths of all nodes of a tip at `tip`, base first."""
    before, nodes = conditions.before[:, GUIDE_X], build_stop_grid(insertion, conditions, tip, cell).nodes
    depths = np.empty(1 + len(before) + len(nodes))
    depths[0] = tip - insertion.length
    for i in range(len(before)):
        depths[1 + i] = before[i]
    for i in range(len(nodes)):
        depths[1 + len(before) + i] = nodes[i]
    return depths


@njit(cache=True, nogil=True)
def begin_chain(conditions: BoundaryConditions, rigidity: float, capacity: int) -> Chain:
    """Return a chain with room for `capacity` nodes, with base and guides before the tissue prescribed."""
    before = 1 + len(conditions.before)
    front, kind, value = np.zeros(before), np.zeros(capacity, np.int64), np.zeros((capacity, 2))
    kind[0] = CLAMPED
    value[0, 1] = conditions.base[1]
    for i in range(1, before):
        front[i] = conditions.before[i - 1, GUIDE_X]
        _prescribe(kind, value, i, conditions.before[i - 1, GUIDE_Y], conditions.before[i - 1, GUIDE_SLOPE])
    return Chain(rigidity, front, kind, value)


@njit(cache=True, nogil=True, inline="always")
def prescribe_stop(
    chain: Chain, conditions: BoundaryConditions, grid: NodeGrid, last: int, tip: float, length: float
) -> None:
    """Prescribe what depends on the depth of the tip: the base, the guides in the tissue, a tracked tip."""
    before = len(chain.front)
    chain.front[0] = tip - length
    # The base moves with the stage: its axis may lie at an angle to the insertion axis.
    chain.value[0, 0] = conditions.base[0] + conditions.base[2] * tip
    for i in range(before, before + last + 1):
        chain.kind[i] = FREE
    for i in range(len(conditions.within)):
        node = count_below(grid.nodes, conditions.within[i, GUIDE_X])
        if node < last and grid.nodes[node] == conditions.within[i, GUIDE_X]:  # none holds the tip itself
            y, slope = conditions.within[i, GUIDE_Y], conditions.within[i, GUIDE_SLOPE]
            _prescribe(chain.kind, chain.value, before + node, y, slope)
    if not math.isnan(conditions.tip[0]):
        _prescribe(chain.kind, chain.value, before + last, conditions.tip[0], conditions.tip[1])


@njit(cache=True, nogil=True)
def _prescribe(kind: Ints, value: Floats, node: int, y: float, slope: float) -> None:
    value[node, 0] = y
    kind[node] = PINNED
    if not math.isnan(slope):
        value[node, 1] = slope
        kind[node] = CLAMPED


@njit(cache=True, nogil=True, inline="always")
def guess_next_state(
    insertion: KernelInsertion, chain: Chain, grid: NodeGrid, last: int, on_main: bool
) -> bool:
    """Fill in a guess for the next stop; return whether it was extrapolated from two earlier stops."""
    states, nodes, now = insertion.states, insertion.nodes, insertion.size
    before, size = len(chain.front), len(chain.front) + last + 1
    old_size, older_size = now[CHAIN_NODES], now[PREVIOUS_NODES]
    # the nodes behind the tip have not moved if both stops use the main grid
    same = on_main and now[ON_MAIN_GRID] == 1 and before == now[FRONT_NODES]
    growth = size - old_size
    if not same and old_size > 0:
        old_nodes, old_state = nodes[:old_size].copy(), states[NOW, :old_size].copy()
        for i in range(size):
            _interpolate_state(
                old_nodes, old_state, chain.front[i] if i < before else grid.nodes[i - before], states[NOW, i]
            )
    now[CHAIN_NODES], now[FRONT_NODES], now[ON_MAIN_GRID], now[PREVIOUS_NODES] = size, before, int(on_main), 0
    nodes[0] = chain.front[0]
    for i in range(max(old_size, 1) if same else 1, size):
        nodes[i] = chain.front[i] if i < before else grid.nodes[i - before]
    if not same or growth <= 0:
        apply_prescribed(states[NOW], chain, size)
        return False
    now[PREVIOUS_NODES] = old_size
    for i in range(old_size):
        for j in range(2):
            # Element by element: assigning whole arrays takes numba seconds to compile.
            states[TWO_CELLS_AGO, i, j] = states[ONE_CELL_AGO, i, j]
            states[ONE_CELL_AGO, i, j] = states[NOW, i, j]
    extend_straight(insertion, chain, grid)
    # Extrapolation needs two cells with the same number of new nodes, and one whole cell of history.
    if growth != old_size - older_size or older_size < before + growth:
        return False
    # every node moves on as it moved, or as the node one cell behind it did, in the cell before
    u, slope = states[TWO_CELLS_AGO, older_size - 1, 0], states[TWO_CELLS_AGO, older_size - 1, 1]
    for i in range(before, size):
        j = i if i < older_size else i - growth
        if i < old_size:
            states[NOW, i, 0] += states[ONE_CELL_AGO, j, 0] - states[TWO_CELLS_AGO, j, 0]
            states[NOW, i, 1] += states[ONE_CELL_AGO, j, 1] - states[TWO_CELLS_AGO, j, 1]
        else:
            ahead = nodes[j] - nodes[older_size - 1]
            states[NOW, i, 0] += states[ONE_CELL_AGO, j, 0] - (u + ahead * slope)
            states[NOW, i, 1] += states[ONE_CELL_AGO, j, 1] - slope
    apply_prescribed(states[NOW], chain, size)
    return True


@njit(cache=True, nogil=True)
def extend_straight(insertion: KernelInsertion, chain: Chain, grid: NodeGrid) -> None:
    """Guess that the shape stays as it is and continues along the tip's tangent in its new cell."""
    states, tip = insertion.states, insertion.tip
    old_size, before = insertion.size[PREVIOUS_NODES], insertion.size[FRONT_NODES]
    for i in range(insertion.size[CHAIN_NODES]):
        if i < old_size:
            states[NOW, i, 0], states[NOW, i, 1] = states[ONE_CELL_AGO, i, 0], states[ONE_CELL_AGO, i, 1]
        else:
            states[NOW, i, 0] = tip[1] + (grid.nodes[i - before] - tip[0]) * tip[2]
            states[NOW, i, 1] = tip[2]
    apply_prescribed(states[NOW], chain, insertion.size[CHAIN_NODES])


@njit(cache=True, nogil=True)
def apply_prescribed(state: Floats, chain: Chain, size: int) -> None:
    """Overwrite a guess with the prescribed deflections and slopes."""
    for i in range(size):
        if chain.kind[i] != FREE:
            state[i, 0] = chain.value[i, 0]
            if chain.kind[i] == CLAMPED:
                state[i, 1] = chain.value[i, 1]


@njit(cache=True, nogil=True)
def _interpolate_state(nodes: Floats, state: Floats, x: float, into: Floats) -> None:
    """Read deflection and slope of a chain at `x`; beyond its ends it goes straight on."""
    end = len(nodes) - 1
    if x <= nodes[0] or x >= nodes[end]:
        at = 0 if x <= nodes[0] else end
        into[0], into[1] = state[at, 0] + (x - nodes[at]) * state[at, 1], state[at, 1]
        return
    e = count_below(nodes, x) - 1
    n = np.empty(HERMITE_COLUMNS)
    fill_hermite(n, x - nodes[e], nodes[e + 1] - nodes[e])
    a0, a1, b0, b1 = state[e, 0], state[e, 1], state[e + 1, 0], state[e + 1, 1]
    into[0] = n[0] * a0 + n[1] * a1 + n[2] * b0 + n[3] * b1
    into[1] = n[4] * a0 + n[5] * a1 + n[6] * b0 + n[7] * b1
