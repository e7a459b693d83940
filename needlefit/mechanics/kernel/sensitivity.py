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
from needlefit.mechanics.kernel.adjoint import differentiate_tip
from needlefit.mechanics.kernel.derivatives import Columns, Here, History, list_spots, make_room, place
from needlefit.mechanics.kernel.foundation import Foundation, Trend
from needlefit.mechanics.kernel.grid import Grid
from needlefit.mechanics.kernel.insertion import Holds, Insertion, Stops
from needlefit.mechanics.kernel.scalar import (
    BROKEN,
    CONVERGED,
    OVER_COMPRESSED,
    Chain,
    Newton,
    span_shapes,
    sweep,
)
from needlefit.mechanics.kernel.tangent import differentiate_all

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@njit(cache=True, nogil=True, error_model="numpy")
def advance(
    insertion: Insertion, foundation: Foundation, trend: Trend, holds: Holds, guides: Ints, stops: Stops,
    swing: Floats, newton: Newton, columns: Columns, history: History, whole: Floats,
) -> tuple[int, int]:  # fmt: skip
    """Bring needle and derivatives from stop to stop; return the status and Newton iterations.

    Parameters
    ----------
    guides : (G + H, 3) array
        Columns of each guide's x, y and slope, of those before the tissue first; -1: not asked for.
    swing : (S,) array
        Derivative of each stop's turn with respect to the bevel offset, 1 / mm.
    whole : (C, 2, P) array
        Filled with the derivatives of every node's deflection and slope at the last stop; without rows:
        more stops are to follow.
    """
    iterations = 0
    size = insertion.states.shape[1]
    chain, trial = forward.begin_chain(holds, insertion.rigidity, size), np.empty((size, 2))
    room = make_room(insertion, len(foundation.mu), len(guides))
    state, y = insertion.states[0], insertion.y
    end = len(stops.tip) - 1
    for s in range(end + 1):
        status, used, _ = forward.between(
            insertion, foundation, holds, stops, s, s + 1, newton, chain, trial, room.factor
        )
        iterations += used
        if status != CONVERGED:
            return status, iterations
        grid, last = _grid(insertion, holds, chain, stops.tip[s], stops.cell[s])
        place(history, insertion, columns, stops, s, swing[s])
        if sweep(state, chain, foundation, grid, y, last, room.factor) == BROKEN:
            return OVER_COMPRESSED, iterations
        here = Here(stops.tip[s], stops.cell[s], grid, last, chain, state, y)
        spots = list_spots(room, insertion.boundaries, foundation, here, holds, guides, columns)
        if s == end and len(whole) > 0:
            differentiate_all(whole, room, spots, foundation, trend, here, columns, history)
            history.tip[:] = whole[len(chain.front) + last]
        else:
            differentiate_tip(room, spots, foundation, trend, here, columns, history)
    return CONVERGED, iterations


@njit(cache=True, nogil=True)
def _grid(insertion: Insertion, holds: Holds, chain: Chain, depth: float, cell: int) -> tuple[Grid, int]:
    """Return the grid of the stop at which the needle stands, and the tip's node in it."""
    last = insertion.size[0] - insertion.size[1] - 1
    if insertion.size[2] == 1:
        return insertion.main, last
    grid = forward.grid_at(insertion, holds, depth, cell)
    span_shapes(grid, chain.front[len(chain.front) - 1])
    return grid, last
