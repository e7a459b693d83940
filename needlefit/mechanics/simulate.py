"""The model as a pure function: needle, tissue, bevel, depth -> shape."""

import math

import numpy as np
from numpy.typing import NDArray

from needlefit.errors import ModelError
from needlefit.mechanics import laws
from needlefit.mechanics.control import Bevel, Controls, Rules
from needlefit.mechanics.kernel.foundation import Foundation, make_foundation
from needlefit.mechanics.kernel.grid import Grid, build_grid, constraint_depths
from needlefit.mechanics.kernel.scalar import CONVERGED, Beam, Newton, equilibrate, insert, regular_shapes
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.shape import NeedleShape, Status
from needlefit.mechanics.tissue import Tissue

Floats = NDArray[np.float64]

_STATUS: tuple[Status, ...] = ("converged", "over-compressed", "not converged", "non-finite")
_DEFAULT_CONTROLS = Controls()
_DEFAULT_RULES = Rules()


def simulate(
    needle: Needle,
    tissue: Tissue,
    bevel: Bevel,
    depth: float,
    controls: Controls = _DEFAULT_CONTROLS,
    rules: Rules = _DEFAULT_RULES,
) -> NeedleShape:
    """Insert the needle to `depth` (mm of inserted arc length) and return its shape in C.

    The same model as `mechanics.reference.simulate`, compiled.

    Returns
    -------
    NeedleShape
        With `converged` False and a reason in `status` where the solution failed.

    Raises
    ------
    ModelError
        If the needle is too short for the depth or the guide.
    """
    check_reach(needle, depth, controls)
    depths = constraint_depths(float(depth), rules.spacing)
    beam, foundation, grid = compile_inputs(needle, tissue, depths, controls, rules)
    turn = bevel.side * bevel.offset / rules.spacing
    newton = Newton(rules.tolerance, rules.max_iterations)
    state, y, track, status, iterations = insert(beam, foundation, grid, depths, turn, newton)
    return NeedleShape(
        _node_depths(beam, grid), state[:, 0], state[:, 1], np.column_stack((depths, y)), track,
        _STATUS[status], iterations,
    )  # fmt: skip


def equilibrium(
    needle: Needle,
    tissue: Tissue,
    constraints: Floats,
    controls: Controls = _DEFAULT_CONTROLS,
    rules: Rules = _DEFAULT_RULES,
) -> NeedleShape:
    """Return the equilibrium against given constraint points, without any history.

    Parameters
    ----------
    constraints : (M + 1, 2) array
        Depth (from 0, increasing, the last under the tip) and y of the points, mm.
    """
    constraints = np.ascontiguousarray(constraints, dtype=np.float64)
    check_reach(needle, float(constraints[-1, 0]), controls)
    depths, y = constraints[:, 0].copy(), constraints[:, 1].copy()
    beam, foundation, grid = compile_inputs(needle, tissue, depths, controls, rules)
    state = np.zeros((len(grid.nodes) + 1, 2))
    last = len(depths) - 1
    newton = Newton(rules.tolerance, rules.max_iterations)
    status, iterations = equilibrate(state, beam, foundation, grid, regular_shapes(grid), y, last, newton)
    if status != CONVERGED:
        state[:] = np.nan
    return NeedleShape(
        _node_depths(beam, grid),
        state[:, 0],
        state[:, 1],
        constraints,
        state[-1:],
        _STATUS[status],
        iterations,
    )


def check_reach(needle: Needle, depth: float, controls: Controls) -> None:
    """Raise ModelError unless the needle reaches `depth` with its base still before guide and tissue."""
    if not (math.isfinite(depth) and depth > 0):
        raise ModelError(f"depth is {depth} mm", expected="a positive, finite number")
    before = controls.guide_distance or 0.0
    if depth + before >= needle.length:
        raise ModelError(
            f"a needle of {needle.length:g} mm cannot be inserted {depth:g} mm"
            + (f" through a guide {before:g} mm before the tissue" if before else ""),
            expected=f"a depth below {needle.length - before:g} mm",
            mend="lessen the depth, or give the needle's true length",
        )


def compile_inputs(
    needle: Needle, tissue: Tissue, depths: Floats, controls: Controls, rules: Rules
) -> tuple[Beam, Foundation, Grid]:
    """Return the nouns as the kernel reads them."""
    reach = math.inf if controls.guide_distance is None else controls.guide_distance
    beam = Beam(needle.flexural_rigidity, needle.length, reach, controls.base_y, controls.base_slope)
    coefficients, exponents = laws.power_terms(tissue.law, tissue.alpha)
    foundation = make_foundation(tissue.mu, coefficients, exponents, tissue.thickness, tissue.friction)
    return beam, foundation, build_grid(depths, tissue.boundaries, rules.element)


def _node_depths(beam: Beam, grid: Grid) -> Floats:
    held = max(float(grid.nodes[-1]) - beam.length, -beam.reach)
    return np.concatenate(([held], grid.nodes))
