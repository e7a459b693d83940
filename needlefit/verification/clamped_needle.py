"""Solve a clamped needle with the compiled solver, for any constraint points and any first guess."""

from dataclasses import dataclass

import numpy as np

from needlefit.arrays import Floats
from needlefit.mechanics.control import ModelOptions
from needlefit.mechanics.kernel.foundation import Foundation
from needlefit.mechanics.kernel.grid import NodeGrid, build_grid
from needlefit.mechanics.kernel.scalar import CLAMPED, FACTOR_COLUMNS, Chain, NewtonOptions, find_equilibrium
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.simulate import STATUS_NAMES, compile_tissue, equilibrium
from needlefit.mechanics.tissue import Tissue

SINGLE_NEWTON_STEP = NewtonOptions(np.inf, 1)


@dataclass(frozen=True)
class ClampedNeedle:
    """A needle clamped at its base, y = u' = 0, and otherwise free.

    Attributes
    ----------
    x : (N,) array
        Nodes from base to tip, mm: those that the model itself would take.
    y : (M + 1,) array
        y of the constraint points that `grid` refers to, mm.
    """

    x: Floats
    chain: Chain
    grid: NodeGrid
    foundation: Foundation
    y: Floats


def make_clamped_needle(
    needle: Needle, tissue: Tissue, constraints: Floats, rules: ModelOptions
) -> ClampedNeedle:
    """Return the clamped needle with these constraint points (M + 1, 2)."""
    x = equilibrium(needle, tissue, constraints, rules=rules).x
    depths, y = np.ascontiguousarray(constraints.T)
    held = Chain(needle.flexural_rigidity, x[:1].copy(), np.zeros(len(x), np.int64), np.zeros((len(x), 2)))
    held.kind[0] = CLAMPED
    grid = build_grid(depths, tissue.boundaries, x[1:].copy(), rules.cut_switch)
    return ClampedNeedle(x, held, grid, compile_tissue(tissue), y)


def solve_newton(clamped: ClampedNeedle, guess: Floats, newton: NewtonOptions) -> Floats:
    """Return the state (N, 2) that Newton's method reaches from a guess.

    Raises
    ------
    ArithmeticError
        If it does not converge.
    """
    state = guess.copy()
    workspace = np.empty_like(state), np.empty((len(state), FACTOR_COLUMNS))
    last = len(clamped.grid.nodes) - 1
    status, _ = find_equilibrium(
        state, clamped.chain, clamped.foundation, clamped.grid, clamped.y, last, newton, *workspace
    )
    if STATUS_NAMES[status] != "converged":
        raise ArithmeticError(f"the solver failed: {STATUS_NAMES[status]}")
    return state
