"""Solve a clamped needle with the kernel, for any constraint points and any first guess."""

from dataclasses import dataclass

import numpy as np

from needlefit.arrays import Floats
from needlefit.mechanics import native
from needlefit.mechanics.control import Controls, ModelOptions
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.simulate import STATUS_NAMES, equilibrium, pack_equilibrium
from needlefit.mechanics.tissue import Tissue


@dataclass(frozen=True)
class ClampedNeedle:
    """A needle clamped at its base, y = u' = 0, and otherwise free.

    Attributes
    ----------
    x : (N,) array
        Nodes from base to tip, mm: those that the model itself would take.
    points : (Q,) array
        Quadrature points, mm.
    depths, y : (M + 1,) arrays
        Constraint points, mm.
    target : (Q,) array or None
        y of the cut at each quadrature point, in place of the constraint points'.
    """

    needle: Needle
    tissue: Tissue
    rules: ModelOptions
    x: Floats
    points: Floats
    depths: Floats
    y: Floats
    target: Floats | None = None


def make_clamped_needle(
    needle: Needle, tissue: Tissue, constraints: Floats, rules: ModelOptions
) -> ClampedNeedle:
    """Return the clamped needle with these constraint points (M + 1, 2)."""
    x = equilibrium(needle, tissue, constraints, rules=rules).x
    depths, y = np.ascontiguousarray(constraints.T)
    problem = pack_equilibrium(needle, tissue, depths, Controls(), rules)
    points, *_ = native.list_quadrature(problem, x[1:].copy(), depths)
    return ClampedNeedle(needle, tissue, rules, x, points, depths, y)


def solve_newton(
    clamped: ClampedNeedle, guess: Floats, tolerance: float = 1e-12, max_iterations: int = 60
) -> Floats:
    """Return the state (N, 2) that Newton's method reaches from a guess; a step with an infinite tolerance.

    Raises
    ------
    ArithmeticError
        If it does not converge.
    """
    problem = pack_equilibrium(clamped.needle, clamped.tissue, clamped.depths, Controls(), clamped.rules)
    problem.tolerance, problem.max_iterations = tolerance, max_iterations
    _, state, status, _ = native.find_equilibrium(
        problem, clamped.depths, clamped.y, np.ascontiguousarray(guess), clamped.target
    )
    if status != native.CONVERGED:
        raise ArithmeticError(f"the solver failed: {STATUS_NAMES[status]}")
    return state
