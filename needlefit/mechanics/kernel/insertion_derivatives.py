"""Compute the exact derivatives of an insertion with respect to its parameters, from stop to stop.

The past enters a stop only through the y of the constraint points, and these only through the rays that the
tip cut. So the derivatives of every constraint point and of every ray are kept, one column for each
parameter. At each stop two adjoint rows, K^T lam = the tip's deflection and slope, give the derivatives of
the tip. Full tangent systems are solved at the last stop only.
"""

import numpy as np
from numba import njit

from needlefit.arrays import Floats, Ints
from needlefit.mechanics.kernel import insertion as forward
from needlefit.mechanics.kernel.adjoint import (
    add_entry_derivatives,
    add_layer_derivatives,
    differentiate_shape,
    fill_alpha_loads,
    solve_adjoint,
    start_from_constraints,
    sum_adjoint_loads,
)
from needlefit.mechanics.kernel.beam import count_below
from needlefit.mechanics.kernel.foundation import make_alpha_derivative
from needlefit.mechanics.kernel.grid import LINEAR_CUT, SAME_DEPTH_MM
from needlefit.mechanics.kernel.insertion import InsertionRun
from needlefit.mechanics.kernel.parameter_loads import (
    DerivativeColumns,
    DerivativeHistory,
    list_load_entries,
    make_workspace,
)
from needlefit.mechanics.kernel.scalar import (
    CONVERGED,
    OVER_COMPRESSED,
    TISSUE_CRUSHED,
    fill_entry_element,
    sweep_forward,
)


@njit(cache=True, nogil=True, error_model="numpy")
def differentiate_stops(
    run: InsertionRun, by_alpha: tuple[Floats, Floats], guides: Ints, turn_per_strength: Floats,
    columns: DerivativeColumns, history: DerivativeHistory, final: bool,
) -> tuple[int, Floats]:  # fmt: skip
    """Compute the derivatives of the stops of a run, which `advance_needle` has recorded.

    Parameters
    ----------
    by_alpha : (1, P) and (1, P), or (n, C) and (n, 0) arrays
        Derivatives of the law's coefficients and exponents, or table, with respect to alpha.
    guides : (G + H, 3) array
        Columns of each guide's x, y and slope, of those before the tissue first; -1: not asked for.
    turn_per_strength : (S,) array
        Derivative of each stop's turn with respect to the bevel's strength, 1 / mm or 1 / rad.
    final : bool
        Whether no more stops are to follow.

    Returns
    -------
    status : int
    whole : (N, 2, P) array
        Derivatives of every node's deflection and slope at the final stop; empty before it.
    """
    insertion, foundation, conditions, stops = run.insertion, run.foundation, run.conditions, run.stops
    alpha_derivative = make_alpha_derivative(foundation, by_alpha[0], by_alpha[1])
    size = insertion.states.shape[1]
    chain = forward.begin_chain(conditions, insertion.rigidity, size)
    workspace = make_workspace(insertion, len(foundation.mu), len(guides))
    record, y, factor, main = insertion.record, history.y, workspace.factor, insertion.main
    boundaries, rigidity, length, before = (
        insertion.boundaries, insertion.rigidity, insertion.length, len(chain.front)
    )  # fmt: skip
    constraints, rays, tip, track = history.constraints, history.rays, history.tip, history.track
    cut, linear = history.cut, insertion.switch == LINEAR_CUT
    depths, cells, ray_of, starts_ray, permanent = (
        stops.tip,
        stops.cell,
        stops.ray,
        stops.starts_ray,
        stops.permanent,
    )
    total, bevel, outside_guides_only = columns.total, columns.bevel, len(conditions.within) == 0
    whole = np.empty((size if final else 0, 2, total))
    local = (
        len(guides) > 0 or max(columns.boundary, columns.base_y, columns.base_slope, columns.stage_slope) >= 0
    )
    kind, mu, points, rows, prescribed_rows = (
        chain.kind,
        foundation.mu,
        workspace.points,
        workspace.rows,
        workspace.prescribed_rows,
    )
    by_constraint, by_layer = workspace.by_constraint, workspace.by_layer
    has_alpha = columns.alpha >= 0
    has_friction = foundation.has_friction or columns.friction >= 0
    end = len(depths) - 1
    for s in range(end + 1):
        depth, cell, ray, state = depths[s], cells[s], ray_of[s], record[s]
        if starts_ray[s]:
            for p in range(total):
                rays[ray, 0, p], rays[ray, 1, p] = tip[0, p], insertion.tangent * tip[1, p]
            if linear:
                for p in range(total):
                    rays[ray, 0, p] = cut[p]
                    if state[size, 1] == 0.0:  # the ray begins at the entry
                        constraints[0, p] = cut[p]
                    if stops.extrapolates[s]:
                        rays[ray, 1, p] += 0.5 * (tip[1, p] - track[cell - 2, 1, p])
        y[0] = state[size + 1, 0]
        if cell > 0:  # c = y + (tip - x)(slope + turn)
            y[cell] = state[size, 0]
            ahead = depth - state[size, 1]
            for p in range(total):
                constraints[cell, p] = rays[ray, 0, p] + ahead * rays[ray, 1, p]
            if bevel >= 0:
                constraints[cell, bevel] += ahead * turn_per_strength[s]
        if permanent[s] and cell > 0 and outside_guides_only:
            grid = main
            last = count_below(grid.nodes, depth - SAME_DEPTH_MM)
        else:
            grid = forward.build_stop_grid(insertion, conditions, depth, cell)
            last = len(grid.nodes) - 1
        forward.prescribe_stop(chain, conditions, grid, last, depth, length)
        fill_entry_element(grid, chain.front[before - 1])
        # The factor must belong to the converged state: that of the last Newton iteration is one step old,
        # which makes the derivatives 2e-3 wrong.
        if sweep_forward(state, chain, foundation, grid, y, last, factor, points) == TISSUE_CRUSHED:
            return OVER_COMPRESSED, whole
        if has_alpha:
            fill_alpha_loads(points, foundation, alpha_derivative, grid, last)
        load_entries = 0
        if local:
            load_entries = list_load_entries(
                workspace,
                boundaries,
                foundation,
                grid,
                chain,
                state,
                y,
                conditions,
                guides,
                columns,
                last,
                depth,
            )
        if s == end and final:
            whole = whole[: before + last + 1]
            differentiate_shape(
                whole, workspace, load_entries, foundation, grid, chain, state, constraints, columns, last
            )
            for p in range(total):
                tip[0, p], tip[1, p] = whole[before + last, 0, p], whole[before + last, 1, p]
        else:
            solve_adjoint(kind, before + last, factor, rows, prescribed_rows)
            sum_adjoint_loads(
                rows,
                points,
                by_constraint,
                by_layer,
                foundation,
                grid,
                state,
                before,
                last,
                cell,
                has_friction,
            )
            start_from_constraints(tip, by_constraint, constraints, cell, total)
            add_layer_derivatives(
                tip, by_layer, mu, rigidity, columns.mu, columns.alpha, columns.friction,
                columns.rigidity,
            )  # fmt: skip
            if load_entries > 0:
                add_entry_derivatives(tip, workspace, load_entries, kind)
        for p in range(total):
            track[cell, 0, p], track[cell, 1, p] = tip[0, p], tip[1, p]
            cut[p] = constraints[cell, p] if cell > 0 else tip[0, p]
    return CONVERGED, whole
