"""What is fixed in the tissue during one insertion: nodes, constraint depths, split quadrature."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

GAUSS = 0.5 / np.sqrt(3.0)  # two Gauss points stand at 1/2 -+ this, in fractions of an interval


class Grid(NamedTuple):
    """Element e ends at node e; element 0 is the free span with the part of the needle before node 0.

    Quadrature points are sorted by depth; those of element e are `first[e]` to `first[e + 1]`.
    """

    nodes: Floats  # (N,) depth of the nodes, tip last
    tip_node: Ints  # (M + 1,) node of each constraint point (constraint 0: -1 where there is no entry node)
    first: Ints  # (N + 1,) first quadrature point of each element
    x: Floats  # (Q,) depth of the quadrature points
    weight: Floats  # (Q,)
    layer: Ints  # (Q,)
    constraint: Ints  # (Q,) index of the nearest constraint point


@njit(cache=True)
def constraint_depths(depth: float, spacing: float) -> Floats:
    """Return 0, the first, shorter cell, then one constraint every `spacing`, the last at `depth`."""
    cells = max(1, int(np.ceil(depth / spacing - 1e-9)))
    x = np.empty(cells + 1)
    x[0] = 0.0
    for m in range(1, cells + 1):
        x[m] = depth - (cells - m) * spacing
    return x


@njit(cache=True)
def build_grid(constraints: Floats, boundaries: Floats, element: float) -> Grid:
    """Return nodes and quadrature for constraint depths (M + 1,) and layer boundaries (n - 1,).

    Every interval of quadrature lies in one element, one layer, and nearest to one constraint point.
    """
    nodes, tip_node = _nodes(constraints, element)
    middles = 0.5 * (constraints[:-1] + constraints[1:])
    inside = boundaries[(boundaries > 0.0) & (boundaries < constraints[-1])]
    edges = np.sort(np.concatenate((np.zeros(1), nodes, middles, inside)))
    first = np.zeros(len(nodes) + 1, np.int64)
    capacity = 2 * (len(edges) - 1)
    x, weight = np.empty(capacity), np.empty(capacity)
    layer, nearest = np.empty(capacity, np.int64), np.empty(capacity, np.int64)
    points = 0
    for i in range(len(edges) - 1):
        length = edges[i + 1] - edges[i]
        if length <= 0.0:
            continue
        middle = 0.5 * (edges[i] + edges[i + 1])
        here = np.searchsorted(boundaries, middle)
        closest = np.searchsorted(middles, middle)
        for side in (-1.0, 1.0):
            x[points] = middle + side * GAUSS * length
            weight[points] = 0.5 * length
            layer[points] = here
            nearest[points] = closest
            points += 1
        first[np.searchsorted(nodes, middle) + 1] = points
    for e in range(len(nodes)):  # an element without points begins where the one before it ends
        first[e + 1] = max(first[e + 1], first[e])
    return Grid(nodes, tip_node, first, x[:points], weight[:points], layer[:points], nearest[:points])


@njit(cache=True)
def _nodes(constraints: Floats, element: float) -> tuple[Floats, Ints]:
    """Return node depths and the node of each constraint point.

    Nodes stand every `element` back from each constraint point. The entry has a node unless the one
    after it is nearer than half an element: very short elements ruin the conditioning.
    """
    first_cell = constraints[1]
    short = int(np.ceil(first_cell / element - 1e-9))  # nodes in the first cell, its end included
    entry = first_cell - (short - 1) * element >= 0.5 * element
    cells = len(constraints) - 1
    per_cell = round((constraints[-1] - first_cell) / element / max(cells - 1, 1)) if cells > 1 else 0
    nodes = np.empty(int(entry) + short + (cells - 1) * per_cell)
    tip_node = np.empty(cells + 1, np.int64)
    tip_node[0] = int(entry) - 1
    if entry:
        nodes[0] = 0.0
    last = tip_node[0]
    for m in range(1, cells + 1):
        count = short if m == 1 else per_cell
        for j in range(count):
            nodes[last + 1 + j] = constraints[m] - (count - 1 - j) * element
        last += count
        tip_node[m] = last
    return nodes, tip_node
