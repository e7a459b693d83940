"""Place nodes, constraint depths and quadrature points for one stop of the tip."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from needlefit.arrays import Floats, Ints
from needlefit.mechanics.kernel.beam import HERMITE_COLUMNS, fill_hermite

GAUSS_OFFSET = 0.5 / np.sqrt(3.0)  # two Gauss points stand at 1/2 -+ this, in fractions of an interval
SAME_DEPTH_MM = 1e-9  # mm; depths nearer than this are the same
# a guide in the tissue holds the needle once the tip is this far past it: a length of the model, not of the
# mesh
GUIDE_ENGAGEMENT_MM = 0.05

LINEAR_CUT = -1.0  # in place of a `switch`: the cut is linear between its constraint points


class NodeGrid(NamedTuple):
    """The mesh of one stop: element e ends at node e; element 0 reaches from the last node before the tissue
    to node 0.

    Quadrature points are sorted by depth; those of element e are `first[e]` to `first[e + 1]`.
    """

    nodes: Floats  # (N,) depth of the nodes, tip last
    first: Ints  # (N + 1,) first quadrature point of each element
    x: Floats  # (Q,) depth of the quadrature points
    weight: Floats  # (Q,)
    layer: Ints  # (Q,)
    constraint: Ints  # (Q,) index of the constraint point that it belongs to
    other: Ints  # (Q,) index of the one at the other end of its cell, of a linear cut
    share: Floats  # (Q,) how much of the way the cut has gone there; 0: the cut is that of its own point
    rate: Floats  # (Q,) d share / dx, 1 / mm
    shapes: Floats  # (Q, HERMITE_COLUMNS) cubic functions and their slopes; the solver fills element 0's rows


@njit(cache=True, nogil=True)
def find_cell(depth: float, first_cell: float, spacing: float) -> int:
    """Return the number of the constraint point at `depth`, or of the next deeper one."""
    if depth <= SAME_DEPTH_MM:
        return 0
    return 1 + max(0, math.ceil((depth - first_cell - SAME_DEPTH_MM) / spacing))


@njit(cache=True, nogil=True)
def list_constraint_depths(tip: float, cell: int, first_cell: float, spacing: float) -> Floats:
    """Return the depths (cell + 1,) of the constraint points behind the tip and of the one under it."""
    x = np.empty(cell + 1)
    x[0] = 0.0
    for m in range(1, cell):
        x[m] = first_cell + (m - 1) * spacing
    x[cell] = tip
    return x


@njit(cache=True, nogil=True)
def list_node_depths(tip: float, first_cell: float, spacing: float, element: float, within: Floats) -> Floats:
    """Return the depths of the nodes in the tissue for a tip at `tip`; `within` (G,) are the guides engaged
    there.

    Nodes stand every `element` before and after x_1. Short elements ruin the conditioning. A node is
    therefore left out if it is nearer than half an element to the tip or a quarter to a guide. The entry gets
    no node if the first node after it is nearer than half an element.
    """
    per_cell = round(spacing / element)
    i = 1 - math.ceil((first_cell - SAME_DEPTH_MM) / element)  # counted from x_1; the first after the entry
    nodes = np.empty(math.ceil(tip / element) + 4 + len(within))
    count = 1  # room for the entry
    guide = 0
    while True:
        cell = max(i, 0) // per_cell
        x = first_cell + cell * spacing + (i - cell * per_cell) * element  # to the bit, wherever the tip is
        if x > tip - 0.5 * element + SAME_DEPTH_MM:
            break
        i += 1
        while guide < len(within) and within[guide] < x:
            nodes[count] = within[guide]
            count += 1
            guide += 1
        near = (guide < len(within) and within[guide] - x < 0.25 * element) or (
            guide > 0 and x - within[guide - 1] < 0.25 * element
        )
        if not near:
            nodes[count] = x
            count += 1
    while guide < len(within):
        nodes[count] = within[guide]
        count += 1
        guide += 1
    nodes[count] = tip
    count += 1
    if nodes[1] >= (0.5 - SAME_DEPTH_MM) * element:
        nodes[0] = 0.0
        return nodes[:count].copy()
    return nodes[1:count].copy()


@njit(cache=True, nogil=True)
def build_grid(constraints: Floats, boundaries: Floats, nodes: Floats, switch: float) -> NodeGrid:
    """Return the quadrature for constraint depths (M + 1,), layer boundaries (n - 1,) and nodes (N,).

    Every interval of quadrature lies in one element and one layer, and belongs to one constraint point.
    Beyond `switch` of the way to the next constraint point (0.5: the nearest) it belongs to that one. With
    LINEAR_CUT it belongs to the nearest, and lies in one cell.
    """
    linear, next_cell = switch == LINEAR_CUT, True  # whether `a` is at or beyond the point `closest`
    part = 0.5 if linear else switch
    count, layers, cells = len(nodes), len(boundaries), len(constraints)
    capacity = 2 * (count + layers + 2 * cells)
    x, weight, share, rate = np.empty(capacity), np.empty(capacity), np.zeros(capacity), np.zeros(capacity)
    layer, nearest, other = (
        np.empty(capacity, np.int64),
        np.empty(capacity, np.int64),
        np.empty(capacity, np.int64),
    )
    first = np.zeros(count + 1, np.int64)
    points = here = closest = element = 0
    while element < count and nodes[element] <= 0.0:  # an entry node ends an element that has no tissue
        element += 1
    while here < layers and boundaries[here] <= 0.0:
        here += 1
    a = 0.0
    while element < count:
        change = np.inf
        if closest + 1 < cells:
            change = (1.0 - part) * constraints[closest] + part * constraints[closest + 1]
        if linear and not next_cell:
            change = constraints[closest]
        b = min(nodes[element], change)
        if here < layers:
            b = min(b, boundaries[here])
        length = b - a
        # A boundary may lie on a node or on a change of constraint: the interval between them is empty.
        if length > 0.0:
            # Two Gauss points: with more the result is not more accurate. The split at every jump of c or of
            # the layer removes the larger error.
            for side in (-1.0, 1.0):
                x[points] = 0.5 * (a + b) + side * GAUSS_OFFSET * length
                weight[points] = 0.5 * length
                layer[points] = here
                nearest[points] = other[points] = closest
                if linear and cells > 1:
                    other[points] += 1 if next_cell else -1
                    rate[points] = 1.0 / (constraints[other[points]] - constraints[closest])
                    share[points] = (x[points] - constraints[closest]) * rate[points]
                points += 1
        a = b
        if b >= change:
            if next_cell:
                closest += 1
            next_cell = not (linear and next_cell)
        if here < layers and b >= boundaries[here]:
            here += 1
        if b >= nodes[element]:
            element += 1
            first[element] = points
    shapes = np.empty((points, HERMITE_COLUMNS))
    for e in range(1, count):
        for q in range(first[e], first[e + 1]):
            fill_hermite(shapes[q], x[q] - nodes[e - 1], nodes[e] - nodes[e - 1])
    return NodeGrid(
        nodes, first, x[:points], weight[:points], layer[:points], nearest[:points], other[:points],
        share[:points], rate[:points], shapes,
    )  # fmt: skip


@njit(cache=True, nogil=True, inline="always")
def find_cut(grid: NodeGrid, y: Floats, q: int) -> tuple[float, float]:
    """Return y and slope of the cut c(x) at a quadrature point, from the constraint points `y`, mm."""
    near = y[grid.constraint[q]]
    rise = y[grid.other[q]] - near
    return near + grid.share[q] * rise, grid.rate[q] * rise
