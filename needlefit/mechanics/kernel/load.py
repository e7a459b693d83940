"""Compute the tissue's load on the shaft, and the forces of the supports that balance it."""

import numpy as np
from numba import njit

from needlefit.arrays import Floats
from needlefit.mechanics.kernel.beam import (
    HERMITE_COLUMNS,
    SLOPES,
    count_below,
    fill_element_ends,
    fill_hermite,
    find_element,
)
from needlefit.mechanics.kernel.foundation import Foundation, evaluate_stiffness, friction_factor
from needlefit.mechanics.kernel.grid import LINEAR_CUT, build_grid
from needlefit.mechanics.kernel.scalar import compute_bending_stiffness


@njit(cache=True, nogil=True, error_model="numpy")
def compute_load(
    x: Floats, u: Floats, slope: Floats, constraints: Floats, foundation: Foundation, boundaries: Floats,
    switch: float, s: Floats,
) -> Floats:  # fmt: skip
    """Return the tissue's load -k e g, N/mm, at beam coordinates `s` (K,), for nodes x, u, slope (N,); 0
    before the tissue.
    """
    load = np.zeros(len(s))
    part = 0.5 if switch == LINEAR_CUT else switch
    depths = constraints[:, 0].copy()
    change = (1.0 - part) * constraints[:-1, 0] + part * constraints[1:, 0]
    ends, row = np.empty(4), np.empty(HERMITE_COLUMNS)
    for i in range(len(s)):
        if s[i] < 0.0:
            continue
        e = find_element(x, s[i])
        fill_element_ends(ends, u, slope, e)
        fill_hermite(row, s[i] - x[e], x[e + 1] - x[e])
        layer = count_below(boundaries, s[i])
        away = -constraints[count_below(change, s[i]), 1]
        if switch == LINEAR_CUT and len(constraints) > 1:
            m = max(count_below(depths, s[i]), 1)
            rise = constraints[m, 1] - constraints[m - 1, 1]
            along = (s[i] - constraints[m - 1, 0]) / (constraints[m, 0] - constraints[m - 1, 0])
            away = -(constraints[m - 1, 1] + along * rise)
        turn = 0.0
        for j in range(4):
            away += row[j] * ends[j]
            turn += row[SLOPES + j] * ends[j]
        k, _ = evaluate_stiffness(foundation, layer, abs(away) / foundation.thickness[layer])
        load[i] = -k * away * friction_factor(foundation.friction[layer], turn)[0]
    return load


@njit(cache=True, nogil=True, error_model="numpy")
def balance_forces(
    x: Floats, u: Floats, slope: Floats, constraints: Floats, foundation: Foundation, boundaries: Floats,
    switch: float, rigidity: float,
) -> tuple[Floats, Floats, Floats, int, Floats]:  # fmt: skip
    """Return the tissue's load at the solver's quadrature points, and the force left over at each node.

    Returns
    -------
    s, weight, load : (K,) arrays
        Quadrature points, mm, what each stands for, mm, and the load, N/mm.
    last : int
        The first of them that belongs to the last constraint point.
    nodal_forces : (N, 2) array
        Force (N) and moment (N mm) that must act on each node beside the load: what holds it, where
        something does; elsewhere nothing but rounding.
    """
    front = count_below(x, 0.0)  # base and guides before the tissue
    grid = build_grid(constraints[:, 0].copy(), boundaries, x[front:].copy(), switch)
    load = compute_load(x, u, slope, constraints, foundation, boundaries, switch, grid.x)
    nodal_forces = np.zeros((len(x), 2))
    ends, row = np.empty(4), np.empty(HERMITE_COLUMNS)
    for i in range(len(x) - 1):
        fill_element_ends(ends, u, slope, i)
        length = x[i + 1] - x[i]
        a, b, c, d = compute_bending_stiffness(rigidity, length)
        away = ends[0] - ends[2]
        nodal_forces[i, 0] += a * away + b * (ends[1] + ends[3])
        nodal_forces[i, 1] += b * away + c * ends[1] + d * ends[3]
        nodal_forces[i + 1, 0] -= a * away + b * (ends[1] + ends[3])
        nodal_forces[i + 1, 1] += b * away + d * ends[1] + c * ends[3]
        e = i + 1 - front  # the grid's element from node i to node i + 1
        if e < 0:
            continue
        for q in range(grid.first[e], grid.first[e + 1]):
            fill_hermite(row, grid.x[q] - x[i], length)
            force = grid.weight[q] * load[q]
            nodal_forces[i, 0] -= force * row[0]
            nodal_forces[i, 1] -= force * row[1]
            nodal_forces[i + 1, 0] -= force * row[2]
            nodal_forces[i + 1, 1] -= force * row[3]
    last = int(np.searchsorted(grid.constraint, len(constraints) - 1))
    return grid.x, grid.weight, load, last, nodal_forces
