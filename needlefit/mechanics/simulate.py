"""Simulate a needle insertion: pure functions from needle, tissue and inputs to the needle's shape."""

import math
from collections.abc import Sequence

import numpy as np

from needlefit.arrays import Floats
from needlefit.errors import ModelError
from needlefit.mechanics import native
from needlefit.mechanics.control import Bevel, Controls, ModelOptions, Step
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.packing import pack_plan, pack_problem, plan_insertion
from needlefit.mechanics.plan import Lattice, TipStop, check_reach
from needlefit.mechanics.shape import NeedleShape, Status, compute_scales
from needlefit.mechanics.tissue import Tissue

STATUS_NAMES: tuple[Status, ...] = ("converged", "over-compressed", "not converged", "non-finite")
_DEFAULT_CONTROLS = Controls()
_DEFAULT_OPTIONS = ModelOptions()


def require_depth(depth: float) -> None:
    """Raise ModelError unless a depth is one that a needle may be inserted to."""
    if not (math.isfinite(depth) and depth > 0):
        raise ModelError(f"depth is {depth} mm", expected="a positive, finite number")


def simulate(
    needle: Needle,
    tissue: Tissue,
    bevel: Bevel,
    depth: float,
    controls: Controls = _DEFAULT_CONTROLS,
    rules: ModelOptions = _DEFAULT_OPTIONS,
) -> NeedleShape:
    """Insert the needle to `depth` (mm of inserted arc length) under constant inputs; return its shape in C.

    The same model as `mechanics.reference.simulate`, by the kernel.

    Raises ModelError if the needle is too short for the depth or the guides.

    Returns
    -------
    NeedleShape
        With `converged` False and a reason in `status` where the solution failed.
    """
    require_depth(depth)
    return simulate_steps(needle, tissue, (Step(float(depth), bevel, controls),), rules)


def simulate_steps(
    needle: Needle,
    tissue: Tissue,
    steps: Sequence[Step],
    rules: ModelOptions = _DEFAULT_OPTIONS,
    lattice: Lattice | None = None,
) -> NeedleShape:
    """Move the needle through `steps`, insertions and retractions, and return its last shape in C.

    Raises ModelError if there are no steps, or the needle is too short for one of them.

    Parameters
    ----------
    lattice : Lattice, optional
        Where constraint points lie; by default so that the last step ends on one.
    """
    lattice, packed = plan_insertion(steps, needle.length, rules, lattice)
    problem = pack_problem(needle, tissue, steps, lattice, rules, packed)
    shapes = native.make_shapes(problem, packed.last.cell + 1)
    native.simulate(problem, shapes, 0, 1)
    scales = compute_scales(tissue, packed.last.tip, lattice.spacing)
    return read_shape(shapes, scales)


def equilibrium(
    needle: Needle,
    tissue: Tissue,
    constraints: Floats,
    controls: Controls = _DEFAULT_CONTROLS,
    rules: ModelOptions = _DEFAULT_OPTIONS,
) -> NeedleShape:
    """Return the needle's equilibrium against given constraint points, without an insertion before it.

    `constraints` (M + 1, 2) are depth (from 0, increasing, the last under the tip) and y of the points, mm;
    the mesh starts from the depth of point 1.
    """
    depths, y = np.ascontiguousarray(np.asarray(constraints, dtype=np.float64).T)
    depth = float(depths[-1])
    require_depth(depth)
    check_reach(needle.length, depth, controls)
    problem = pack_equilibrium(needle, tissue, depths, controls, rules)
    x, state, status, passes = native.find_equilibrium(problem, depths, y)
    if status != native.CONVERGED:
        state[:] = np.nan
    points = np.column_stack((depths, y))
    u, slope = state.T.copy()
    scales = compute_scales(tissue, depth, rules.spacing)
    return NeedleShape(x, u, slope, points, state[-1:], STATUS_NAMES[status], passes, scales)


def pack_equilibrium(
    needle: Needle, tissue: Tissue, depths: Floats, controls: Controls, rules: ModelOptions
) -> native.KernelProblem:
    """Return the problem of a needle with constraint points at `depths` (M + 1,), mm, the last at the tip."""
    spacing, depth = rules.spacing, float(depths[-1])
    stop = TipStop(depth, 1, False, 0, False, 0, 0)
    step = Step(max(depth, spacing), Bevel(), controls)
    first_cell = float(depths[1]) if len(depths) > 1 else spacing
    return pack_problem(
        needle, tissue, (step,), Lattice(spacing, spacing), rules, pack_plan([stop]),
        first_cell=first_cell, deepest=max(len(depths) * spacing, depth) + first_cell + 2 * spacing,
    )  # fmt: skip


def read_shape(shapes: native.Shapes, scales: Floats, i: int = 0) -> NeedleShape:
    """Return the shape of one set; NaN where it failed."""
    a = shapes.arrays
    x, u, slope, points, track = (a[n][i].copy() for n in ("x", "u", "slope", "constraints", "track"))
    status = STATUS_NAMES[a["status"][i]]
    return NeedleShape(x, u, slope, points, track, status, int(a["passes"][i]), scales)
