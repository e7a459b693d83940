"""What is kept of the derivatives from stop to stop, and how parameters load one stop."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from needlefit.mechanics.kernel.foundation import Foundation
from needlefit.mechanics.kernel.grid import Grid
from needlefit.mechanics.kernel.insertion import Holds, Insertion
from needlefit.mechanics.kernel.scalar import CLAMPED, WIDTH, Chain
from needlefit.mechanics.kernel.sensitivity.perturbation import boundary_load, node_load

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SUMS = 3  # per layer: of the force k e g, and what dk/dalpha and dg/dgamma make of it


class Columns(NamedTuple):
    """Which column belongs to which parameter: the first of its kind, or -1 where it is not asked for."""

    total: int
    mu: int
    alpha: int
    friction: int
    boundary: int
    rigidity: int
    offset: int
    base_y: int
    base_slope: int
    stage_slope: int


class History(NamedTuple):
    """Derivatives of what the stops so far have left behind, with respect to P parameters.

    All are 0 before first contact: no parameter moves a tip that defines the frame.
    """

    constraints: Floats  # (M + 1, P) of the constraint points' y
    rays: Floats  # (R, 2, P) of the deflection and slope with which each ray begins
    tip: Floats  # (2, P) of the tip's deflection and slope now
    y: Floats  # (M + 1,) the constraint points themselves, as they stood then


class Room(NamedTuple):
    """Where a stop does its sums."""

    factor: Floats  # (C, WIDTH)
    points: Floats  # (Q, 4) of each quadrature point e and, by weight, d(k e g)/de, k e g and e dk/dalpha
    rows: Floats  # (C, 4) adjoint of the tip's deflection (two columns) and slope, 0 where prescribed
    held: Floats  # (C, 4) the same where something is prescribed: the answer per unit of that
    by_constraint: Floats  # (M + 1, 2)
    by_layer: Floats  # (n, 2, SUMS)
    load: Floats  # (3, 2) on three nodes
    spots: Ints  # (E, 3) node, component and column of right-hand sides that touch few nodes
    amounts: Floats  # (E,)


@njit(cache=True, nogil=True)
def make_room(insertion: Insertion, layers: int, guides: int) -> Room:
    size = insertion.states.shape[1]
    spots = 3 + 8 * guides + 4 * layers
    return Room(
        np.empty((size, WIDTH)), np.zeros((2 * (size + len(insertion.y) + layers), 4)), np.empty((size, 4)),
        np.empty((size, 4)), np.empty((len(insertion.y), 2)),
        np.empty((layers, 2, SUMS)), np.empty((3, 2)), np.empty((spots, 3), np.int64), np.empty(spots),
    )  # fmt: skip


@njit(cache=True, nogil=True)
def list_spots(
    room: Room, boundaries: Floats, foundation: Foundation, grid: Grid, chain: Chain, state: Floats,
    y: Floats, holds: Holds, guides: Ints, columns: Columns, last: int, depth: float,
) -> int:  # fmt: skip
    """List the right-hand sides of base, guides and boundaries; return how many entries they have."""
    n = 0
    n = _spot(room, n, 0, 0, columns.base_y, 1.0)
    n = _spot(room, n, 0, 0, columns.stage_slope, depth)
    n = _spot(room, n, 0, 1, columns.base_slope, 1.0)
    before = len(chain.front)
    for g in range(len(guides)):
        node = g + 1
        if node >= before:
            x = holds.within[node - before, 0]
            node = before + np.searchsorted(grid.nodes, x)
            if node >= before + last or grid.nodes[node - before] != x:
                continue  # the tip has not passed it yet
        n = _spot(room, n, node, 0, guides[g, 1], 1.0)
        if chain.kind[node] == CLAMPED:
            n = _spot(room, n, node, 1, guides[g, 2], 1.0)
        if guides[g, 0] >= 0:
            node_load(room.load, node, state, chain, foundation, grid, y)
            n = _loads(room, n, chain, node - 1, 3, guides[g, 0])
    if columns.boundary >= 0:
        for b in range(len(boundaries)):
            if 0.0 <= boundaries[b] < depth:
                node = boundary_load(room.load, b, boundaries[b], state, chain, foundation, grid, y)
                n = _loads(room, n, chain, node, 2, columns.boundary + b)
    return n


@njit(cache=True, nogil=True)
def _spot(room: Room, n: int, node: int, component: int, column: int, amount: float) -> int:
    if column < 0:
        return n
    room.spots[n, 0], room.spots[n, 1], room.spots[n, 2] = node, component, column
    room.amounts[n] = amount
    return n + 1


@njit(cache=True, nogil=True)
def _loads(room: Room, n: int, chain: Chain, node: int, nodes: int, column: int) -> int:
    """List a load on the residual; what is prescribed has no equation that it could enter."""
    for i in range(nodes):
        for component in range(2):
            if chain.kind[node + i] <= component:
                n = _spot(room, n, node + i, component, column, -room.load[i, component])
    return n
