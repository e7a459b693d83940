"""Simulate a needle insertion: pure functions from needle, tissue and inputs to the needle's shape.

The lateral loads on the needle are the tissue's load along the shaft, and the reactions of the supports.
"""

from collections.abc import Sequence

import numpy as np

from needlefit.arrays import Floats
from needlefit.errors import ModelError
from needlefit.mechanics import native
from needlefit.mechanics.control import Bevel, Controls, ModelOptions, Step
from needlefit.mechanics.doubts import warn_of_units
from needlefit.mechanics.needle import Needle, is_bounded, require_type
from needlefit.mechanics.packing import pack_insertion, pack_problem, pack_stops
from needlefit.mechanics.plan import Lattice, TipStop
from needlefit.mechanics.shape import NeedleShape, Status, compute_scales, list_planes
from needlefit.mechanics.tissue import Tissue
from needlefit.mechanics.torsion import turn_tip

STATUS_NAMES: tuple[Status, ...] = ("converged", "over-compressed", "not converged", "non-finite")
_DEFAULT_CONTROLS = Controls()
_DEFAULT_OPTIONS = ModelOptions()


def require_depth(depth: float) -> None:
    """Raise ModelError unless a depth is one that a needle may be inserted to."""
    if not (is_bounded(depth) and depth > 0):
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

    Raises ModelError if the needle is too short for the depth or the guides.

    Returns
    -------
    NeedleShape
        With `converged` False and a reason in `status` where the solution failed.
    """
    require_depth(depth)
    steps = (Step(float(depth), bevel, controls),)
    shape = find_last_shape(needle, tissue, steps, rules)
    warn_of_units(needle, tissue, steps, rules)
    return shape


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
    shape = find_last_shape(needle, tissue, steps, rules, lattice)
    warn_of_units(needle, tissue, steps, rules)
    return shape


def find_last_shape(
    needle: Needle, tissue: Tissue, steps: Sequence[Step], rules: ModelOptions, lattice: Lattice | None = None
) -> NeedleShape:
    """Do what `simulate_steps` does, for inputs whose units were judged where they were read."""
    steps = turn_tip(needle, tissue, steps)
    require_type("rules", rules, ModelOptions)
    lattice, packed = pack_insertion(steps, needle.length, rules, lattice)
    problem = pack_problem(needle, tissue, steps, lattice, rules, packed)
    shapes = native.make_shapes(problem, packed.last.cell + 1)
    native.simulate(problem, shapes, 0, 1)
    scales = compute_scales(tissue, packed.last.tip, lattice.spacing)
    return read_shape(shapes, scales)


def pack_equilibrium(
    needle: Needle,
    tissue: Tissue,
    depths: Floats,
    controls: Controls,
    rules: ModelOptions,
    planes: int = 1,
) -> native.KernelProblem:
    """Return the problem of a needle with constraint points at `depths` (M + 1,), mm, the last at the tip."""
    spacing, depth = rules.spacing, float(depths[-1])
    stop = TipStop(depth, 1, False, 0, False, 0, 0)
    step = Step(max(depth, spacing), Bevel(), controls)
    first_cell = float(depths[1]) if len(depths) > 1 else spacing
    return pack_problem(
        needle, tissue, (step,), Lattice(spacing, spacing), rules, pack_stops([stop]),
        planes=planes, first_cell=first_cell,
        deepest=max(len(depths) * spacing, depth) + first_cell + 2 * spacing,
    )  # fmt: skip


def read_shape(shapes: native.Shapes, scales: Floats) -> NeedleShape:
    """Return the shape of the first set; NaN where it failed."""
    a = shapes.arrays
    x, points, track = (a[name][0].copy() for name in ("x", "constraints", "track"))
    nodes = native.to_space(x, a["u"][:, 0].copy(), a["slope"][:, 0].copy(), points, track)
    return NeedleShape(*nodes, STATUS_NAMES[a["status"][0]], int(a["passes"][0]), scales)


def compute_lateral_load(
    shape: NeedleShape, tissue: Tissue, s: Floats, rules: ModelOptions = _DEFAULT_OPTIONS
) -> Floats:
    """Return the lateral load (2, K) of the tissue along y and z, N/mm, at beam coordinates `s` (K,), mm.

    Where the load jumps, that of the side nearer to the base.
    """
    needle, (u, slope) = Needle(shape.x[-1] - shape.x[0], 1.0), list_planes(shape)
    depths = np.ascontiguousarray(shape.constraints[:, 0])
    problem = pack_equilibrium(needle, tissue, depths, Controls(), rules, len(u))
    bent = shape.x, u, slope, shape.constraints
    return native.compute_load(problem, bent, np.ascontiguousarray(s, dtype=np.float64))
