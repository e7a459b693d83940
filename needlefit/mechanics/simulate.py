"""Simulate a needle insertion: pure functions from needle, tissue and inputs to the needle's shape.

The lateral loads on the needle are the tissue's load along the shaft, and the reactions of the supports.
"""

from collections.abc import Sequence
from dataclasses import dataclass

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


@dataclass(frozen=True)
class SupportReaction:
    """Force and moment of one support (base, guide or tracked tip) on the needle."""

    x: float  #: beam coordinate, mm
    force: float = 0.0  #: N, toward +y
    moment: float = 0.0  #: N mm, turning x toward y; 0 where the needle turns freely
    #: force_z, moment_z: toward +z, and turning x toward z
    force_z: float = 0.0
    moment_z: float = 0.0


@dataclass(frozen=True)
class Loads:
    """All loads across the needle's axis, in the constraint frame C; positive toward +y and +z."""

    s: Floats  #: (K,) beam coordinates in the tissue at which the model integrates the load, increasing, mm
    #: (K,) lateral load of the tissue there, N/mm; it jumps where constraint point or layer change
    load: Floats
    load_z: Floats  #: (K,) the same along z
    #: (K,) length of shaft that each of them stands for, mm: the tissue's force is `weight @ load`
    weight: Floats
    #: tip_region_force, tip_region_force_z: of the tissue on the stretch of the last constraint point, N
    tip_region_force: float
    tip_region_force_z: float
    base: SupportReaction
    #: one for each of the controls' guides, in their order; all 0 for one that does not hold yet
    guides: tuple[SupportReaction, ...]
    tip: SupportReaction  #: what holds a tracked tip where it is; all 0 where the tip is free

    @property
    def tip_force(self) -> float:
        """Lateral force on the tip, N: the tissue's around the tip, plus that of a tracker that holds it."""
        return self.tip_region_force + self.tip.force

    @property
    def tissue(self) -> SupportReaction:
        """The tissue's force on the whole shaft, N, and its moment about the entry, N mm."""
        forces = [self.weight * load for load in (self.load, self.load_z)]
        numbers = [number for force in forces for number in (float(force.sum()), float(force @ self.s))]
        return SupportReaction(0.0, *numbers)


def compute_loads(
    shape: NeedleShape,
    tissue: Tissue,
    needle: Needle,
    controls: Controls,
    rules: ModelOptions = _DEFAULT_OPTIONS,
) -> Loads:
    """Return all loads on a needle in equilibrium: docs/model.md, section 3.

    `tissue`, `needle` and `rules` are those under which it was found, `controls` those of its last step. NaN
    where the shape is, if it did not converge.
    """
    depths, (u, slope) = np.ascontiguousarray(shape.constraints[:, 0]), list_planes(shape)
    problem = pack_equilibrium(needle, tissue, depths, controls, rules, len(u))
    front = int(np.searchsorted(shape.x, 0.0))  # base and guides before the tissue
    s, weight, _, near = native.list_quadrature(problem, shape.x[front:].copy(), depths)
    bent = shape.x, u, slope, shape.constraints
    load = native.compute_load(problem, bent, s)  # (2, K)
    last = int(np.searchsorted(near, len(depths) - 1))  # the first that belongs to the last constraint point
    nodal_forces = native.balance_nodes(problem, bent, front, load).swapaxes(0, 1)  # (N, 2, 2)
    # Supports have nodes at exactly their x, so a node is found by its coordinate.
    reactions = dict(zip(shape.x.tolist(), nodal_forces.tolist(), strict=True))

    def read(x: float, clamped: bool) -> SupportReaction:
        held = reactions.get(x, [])  # a guide without a node holds nothing
        return SupportReaction(x, *(n for force, moment in held for n in (force, moment if clamped else 0.0)))

    load_y, load_z = load
    return Loads(
        s,
        load_y,
        load_z,
        weight,
        tip_region_force=float(weight[last:] @ load_y[last:]),
        tip_region_force_z=float(weight[last:] @ load_z[last:]),
        base=read(float(shape.x[0]), clamped=True),
        guides=tuple(read(guide.x, guide.slope is not None) for guide in controls.guides),
        tip=SupportReaction(shape.depth)
        if controls.tip is None
        else read(shape.depth, controls.tip.slope is not None),
    )


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
