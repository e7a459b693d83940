"""An insertion under way: the needle goes from stop to stop, and what it leaves in the tissue stays."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from needlefit.mechanics.kernel.foundation import Foundation
from needlefit.mechanics.kernel.grid import (
    SLACK,
    Grid,
    build_grid,
    cell_of,
    constraint_depths,
    node_depths,
)
from needlefit.mechanics.kernel.hermite import hermite
from needlefit.mechanics.kernel.scalar import CLAMPED, CONVERGED, FREE, PINNED, Chain, Newton, equilibrate

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


class Stops(NamedTuple):
    """Where the tip halts, in order (S,); `mechanics.plan` says what the fields mean."""

    tip: Floats
    cell: Ints
    permanent: Bools
    ray: Ints
    opens: Bools
    turn: Floats  # s b / C_int of the bevel that cuts the ray: the slope that it adds


class Holds(NamedTuple):
    """What holds the needle, in C; a slope that is left free is NaN."""

    base: Floats  # (3,) y, slope, slope of the stage's axis
    before: Floats  # (G, 3) x, y, slope of the guides before the tissue
    within: Floats  # (H, 3) of those in it
    tip: Floats  # (2,) y, slope; NaN where the tip is not tracked


class Insertion(NamedTuple):
    """The needle, its place in the tissue, and what the stops so far have left behind."""

    rigidity: float  # EI, N mm^2
    length: float  # mm
    first_cell: float  # mm
    spacing: float  # C_int, mm
    element: float  # h, mm
    boundaries: Floats  # (n - 1,) mm
    main: Grid  # of all constraint points that the tip can reach
    y: Floats  # (M + 1,) of the constraint points, mm
    track: Floats  # (M + 1, 2) deflection and slope of the tip as it stood at each
    rays: Floats  # (R, 4) x, y, slope of the tip where each ray begins, and the bevel's turn
    tip: Floats  # (3,) x, y, slope of the tip now
    nodes: Floats  # (C,) depth of the chain's nodes now
    state: Floats  # (C, 2) their deflection and slope
    size: Ints  # (3,) nodes of the chain, those before the tissue, whether the rest are the main grid's


@njit(cache=True, nogil=True)
def begin(
    rigidity: float, length: float, first_cell: float, spacing: float, element: float, boundaries: Floats,
    deepest: float, guides: int, rays: int,
) -> Insertion:  # fmt: skip
    """Return a needle before first contact, with room up to `deepest` (mm) for so many guides and rays."""
    cells = max(cell_of(deepest, first_cell, spacing), 1)
    tip = first_cell + (cells - 1) * spacing
    nodes = node_depths(tip, first_cell, element, np.empty(0))
    main = build_grid(constraint_depths(tip, cells, first_cell, spacing), boundaries, nodes)
    room = len(nodes) + guides + 3  # base, entry, a tip between constraint points
    y = np.full(cells + 1, np.nan)  # what a failed insertion never reached stays NaN
    y[0] = 0.0
    return Insertion(
        rigidity, length, first_cell, spacing, element, boundaries, main, y,
        np.full((cells + 1, 2), np.nan), np.zeros((rays, 4)),
        np.zeros(3), np.zeros(room), np.zeros((room, 2)), np.zeros(3, np.int64),
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def advance(
    insertion: Insertion, foundation: Foundation, holds: Holds, stops: Stops, newton: Newton
) -> tuple[int, int, int]:
    """Bring the needle from stop to stop; return the status, Newton iterations and stops reached.

    Where a stop fails the needle's state is worthless.
    """
    iterations = 0
    for s in range(len(stops.tip)):
        place(insertion, stops, s)
        grid, last = grid_at(insertion, holds, stops, s)
        chain = hold(holds, grid, last, stops.tip[s], insertion.length, insertion.rigidity)
        carry(insertion, chain, grid, last, stops.permanent[s] and len(holds.within) == 0)
        status, used = equilibrate(insertion.state, chain, foundation, grid, insertion.y, last, newton)
        iterations += used
        if status != CONVERGED:
            return status, iterations, s
        settle(insertion, stops, s)
    return CONVERGED, iterations, len(stops.tip)


@njit(cache=True, nogil=True)
def place(insertion: Insertion, stops: Stops, s: int) -> None:
    """Put the constraint point under the tip of stop `s` on its ray."""
    if stops.opens[s]:
        insertion.rays[stops.ray[s], :3] = insertion.tip
        insertion.rays[stops.ray[s], 3] = stops.turn[s]
    if stops.cell[s] > 0:
        x, y, slope, turn = insertion.rays[stops.ray[s]]
        insertion.y[stops.cell[s]] = y + (stops.tip[s] - x) * (slope + turn)


@njit(cache=True, nogil=True)
def grid_at(insertion: Insertion, holds: Holds, stops: Stops, s: int) -> tuple[Grid, int]:
    """Return the grid of stop `s` and the number of the tip's node in it."""
    tip, cell = stops.tip[s], stops.cell[s]
    if stops.permanent[s] and cell > 0 and len(holds.within) == 0:
        return insertion.main, np.searchsorted(insertion.main.nodes, tip - SLACK)
    active = holds.within[:, 0]
    active = active[active <= tip - 0.25 * insertion.element]
    nodes = node_depths(tip, insertion.first_cell, insertion.element, active)
    points = constraint_depths(tip, cell, insertion.first_cell, insertion.spacing)
    return build_grid(points, insertion.boundaries, nodes), len(nodes) - 1


@njit(cache=True, nogil=True)
def hold(holds: Holds, grid: Grid, last: int, tip: float, length: float, rigidity: float) -> Chain:
    """Return the chain of a tip at `tip`, with what is prescribed on it."""
    before = 1 + len(holds.before)
    front = np.empty(before)
    front[0] = tip - length
    front[1:] = holds.before[:, 0]
    kind = np.zeros(before + last + 1, np.int64)
    value = np.zeros((before + last + 1, 2))
    kind[0] = CLAMPED
    value[0, 0] = holds.base[0] + holds.base[2] * tip
    value[0, 1] = holds.base[1]
    for i in range(1, before):
        _prescribe(kind, value, i, holds.before[i - 1, 1], holds.before[i - 1, 2])
    for i in range(len(holds.within)):
        node = before + np.searchsorted(grid.nodes, holds.within[i, 0])
        if node <= before + last and grid.nodes[node - before] == holds.within[i, 0]:
            _prescribe(kind, value, node, holds.within[i, 1], holds.within[i, 2])
    if not np.isnan(holds.tip[0]):
        _prescribe(kind, value, before + last, holds.tip[0], holds.tip[1])
    return Chain(rigidity, front, kind, value)


@njit(cache=True, nogil=True)
def _prescribe(kind: Ints, value: Floats, node: int, y: float, slope: float) -> None:
    value[node, 0] = y
    kind[node] = PINNED
    if not np.isnan(slope):
        value[node, 1] = slope
        kind[node] = CLAMPED


@njit(cache=True, nogil=True)
def carry(insertion: Insertion, chain: Chain, grid: Grid, last: int, on_main: bool) -> None:
    """Guess the next stop: the shape as it is, straight on where the needle did not reach before."""
    before, size = len(chain.front), len(chain.front) + last + 1
    state = insertion.state
    old_size, old_before = insertion.size[0], insertion.size[1]
    if on_main and insertion.size[2] == 1 and before == old_before:
        for i in range(old_size, size):  # the nodes behind have not moved
            ahead = grid.nodes[i - before] - insertion.tip[0]
            state[i, 0] = insertion.tip[1] + ahead * insertion.tip[2]
            state[i, 1] = insertion.tip[2]
    elif old_size > 0:
        old_nodes, old_state = insertion.nodes[:old_size].copy(), state[:old_size].copy()
        for i in range(size):
            x = chain.front[i] if i < before else grid.nodes[i - before]
            _read(old_nodes, old_state, x, state[i])
    for i in range(before):
        insertion.nodes[i] = chain.front[i]
    for i in range(last + 1):
        insertion.nodes[before + i] = grid.nodes[i]
    for i in range(size):
        if chain.kind[i] != FREE:
            state[i, 0] = chain.value[i, 0]
            if chain.kind[i] == CLAMPED:
                state[i, 1] = chain.value[i, 1]
    insertion.size[0], insertion.size[1], insertion.size[2] = size, before, int(on_main)


@njit(cache=True, nogil=True)
def _read(nodes: Floats, state: Floats, x: float, into: Floats) -> None:
    """Read deflection and slope of a chain at `x`; beyond its ends it goes straight on."""
    end = len(nodes) - 1
    if x <= nodes[0] or x >= nodes[end]:
        at = 0 if x <= nodes[0] else end
        into[0], into[1] = state[at, 0] + (x - nodes[at]) * state[at, 1], state[at, 1]
        return
    e = np.searchsorted(nodes, x) - 1
    n = np.empty(8)
    hermite(n, x - nodes[e], nodes[e + 1] - nodes[e])
    a0, a1, b0, b1 = state[e, 0], state[e, 1], state[e + 1, 0], state[e + 1, 1]
    into[0] = n[0] * a0 + n[1] * a1 + n[2] * b0 + n[3] * b1
    into[1] = n[4] * a0 + n[5] * a1 + n[6] * b0 + n[7] * b1


@njit(cache=True, nogil=True)
def settle(insertion: Insertion, stops: Stops, s: int) -> None:
    """Remember where the tip stands."""
    end = insertion.size[0] - 1
    insertion.tip[0] = stops.tip[s]
    insertion.tip[1], insertion.tip[2] = insertion.state[end, 0], insertion.state[end, 1]
    insertion.track[stops.cell[s]] = insertion.state[end]
