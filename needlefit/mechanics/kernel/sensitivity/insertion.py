"""Exact derivatives of an insertion with respect to its parameters, carried along from stop to stop.

What lies behind the needle enters a stop only through the ordinates of the constraint points, and these
through the rays that the tip cut. Kept are therefore, per parameter, the derivatives of every constraint
point and of every ray. At each stop two adjoint rows, K^T lam = the tip's deflection and slope, turn those
into the tip's derivatives; whole tangent systems are solved at the last stop only.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from needlefit.mechanics.kernel import insertion as forward
from needlefit.mechanics.kernel.foundation import Foundation, make_trend
from needlefit.mechanics.kernel.grid import SLACK
from needlefit.mechanics.kernel.insertion import Holds, Insertion, Stops
from needlefit.mechanics.kernel.scalar import (
    BROKEN,
    CONVERGED,
    OVER_COMPRESSED,
    Newton,
    span_shapes,
    sweep,
)
from needlefit.mechanics.kernel.sensitivity.adjoint import (
    add_layers,
    add_spots,
    bend,
    carry_over,
    gather,
    solve_rows,
)
from needlefit.mechanics.kernel.sensitivity.derivatives import Columns, History, list_spots, make_room
from needlefit.mechanics.kernel.sensitivity.tangent import differentiate_all

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@njit(cache=True, nogil=True, error_model="numpy")
def advance(
    insertion: Insertion, foundation: Foundation, by_alpha: tuple[Floats, Floats], holds: Holds, guides: Ints,
    stops: Stops, swing: Floats, newton: Newton, columns: Columns, history: History, whole: Floats,
) -> tuple[int, int]:  # fmt: skip
    """Bring the needle from stop to stop, then its derivatives; return the status and Newton iterations.

    Parameters
    ----------
    by_alpha : (P,) and (P,) arrays
        Derivatives of the law's coefficients and exponents with respect to alpha.
    guides : (G + H, 3) array
        Columns of each guide's x, y and slope, of those before the tissue first; -1: not asked for.
    swing : (S,) array
        Derivative of each stop's turn with respect to the bevel offset, 1 / mm.
    whole : (C, 2, P) array
        Filled with the derivatives of every node's deflection and slope at the last stop; without rows:
        more stops are to follow.
    """
    status, iterations, _ = forward.advance(insertion, foundation, holds, stops, newton)
    if status != CONVERGED:
        return status, iterations
    trend = make_trend(foundation, by_alpha[0], by_alpha[1])
    size = insertion.states.shape[1]
    chain = forward.begin_chain(holds, insertion.rigidity, size)
    room = make_room(insertion, len(foundation.mu), len(guides))
    record, y, factor, main = insertion.record, history.y, room.factor, insertion.main
    boundaries, rigidity, length, before = (
        insertion.boundaries, insertion.rigidity, insertion.length, len(chain.front)
    )  # fmt: skip
    constraints, rays, tip = history.constraints, history.rays, history.tip
    depths, cells, ray_of, opens, permanent = stops.tip, stops.cell, stops.ray, stops.opens, stops.permanent
    total, offset, alone = columns.total, columns.offset, len(holds.within) == 0
    local = (
        len(guides) > 0 or max(columns.boundary, columns.base_y, columns.base_slope, columns.stage_slope) >= 0
    )
    kind, mu, points, rows, held = chain.kind, foundation.mu, room.points, room.rows, room.held
    by_constraint, by_layer = room.by_constraint, room.by_layer
    curved = columns.alpha >= 0
    rough = foundation.rough or columns.friction >= 0
    end = len(depths) - 1
    for s in range(end + 1):
        depth, cell, ray, state = depths[s], cells[s], ray_of[s], record[s]
        if opens[s]:
            for p in range(total):
                rays[ray, 0, p], rays[ray, 1, p] = tip[0, p], insertion.tangent * tip[1, p]
        if cell > 0:  # c = y + (tip - x)(slope + turn)
            y[cell] = state[size, 0]
            ahead = depth - state[size, 1]
            for p in range(total):
                constraints[cell, p] = rays[ray, 0, p] + ahead * rays[ray, 1, p]
            if offset >= 0:
                constraints[cell, offset] += ahead * swing[s]
        if permanent[s] and cell > 0 and alone:
            grid = main
            last = np.searchsorted(grid.nodes, depth - SLACK)
        else:
            grid = forward.grid_at(insertion, holds, depth, cell)
            last = len(grid.nodes) - 1
        forward.hold(chain, holds, grid, last, depth, length)
        span_shapes(grid, chain.front[before - 1])
        if sweep(state, chain, foundation, grid, y, last, factor, points) == BROKEN:
            return OVER_COMPRESSED, iterations
        if curved:
            bend(points, foundation, trend, grid, last)
        spots = 0
        if local:
            spots = list_spots(
                room, boundaries, foundation, grid, chain, state, y, holds, guides, columns, last, depth
            )
        if s == end and len(whole) > 0:
            differentiate_all(whole, room, spots, foundation, grid, chain, state, constraints, columns, last)
        else:
            solve_rows(kind, before + last, factor, rows, held)
            gather(rows, points, by_constraint, by_layer, foundation, grid, state, before, last, cell, rough)
            carry_over(tip, by_constraint, constraints, cell, total)
            add_layers(
                tip, by_layer, mu, rigidity, columns.mu, columns.alpha, columns.friction,
                columns.rigidity,
            )  # fmt: skip
            if spots > 0:
                add_spots(tip, room, spots, kind)
    return CONVERGED, iterations
