"""Simulate a needle insertion: pure functions from needle, tissue and inputs to the needle's shape."""

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import groupby

import numpy as np

from needlefit.arrays import Floats, Ints
from needlefit.errors import ModelError
from needlefit.mechanics.control import Bevel, Controls, Guide, ModelOptions, Step
from needlefit.mechanics.insertion_limits import check_reach, check_size
from needlefit.mechanics.kernel import insertion as kernel
from needlefit.mechanics.kernel.foundation import Foundation, make_foundation
from needlefit.mechanics.kernel.grid import (
    GUIDE_ENGAGEMENT_MM,
    build_grid,
    list_constraint_depths,
    list_node_depths,
)
from needlefit.mechanics.kernel.scalar import CONVERGED, FACTOR_COLUMNS, NewtonOptions, find_equilibrium
from needlefit.mechanics.law_form import compile_law
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.plan import Lattice, Move, TipStop, make_lattice, make_moves, make_stops
from needlefit.mechanics.shape import NeedleShape, Status
from needlefit.mechanics.tissue import Tissue
from needlefit.mechanics.validity import compute_scales

STATUS_NAMES: tuple[Status, ...] = ("converged", "over-compressed", "not converged", "non-finite")
_DEFAULT_CONTROLS = Controls()
_DEFAULT_OPTIONS = ModelOptions()


def simulate(
    needle: Needle,
    tissue: Tissue,
    bevel: Bevel,
    depth: float,
    controls: Controls = _DEFAULT_CONTROLS,
    rules: ModelOptions = _DEFAULT_OPTIONS,
) -> NeedleShape:
    """Insert the needle to `depth` (mm of inserted arc length) under constant inputs; return its shape in C.

    The same model as `mechanics.reference.simulate`, compiled.

    Returns
    -------
    NeedleShape
        With `converged` False and a reason in `status` where the solution failed.

    Raises
    ------
    ModelError
        If the needle is too short for the depth or the guides.
    """
    if not (math.isfinite(depth) and depth > 0):
        raise ModelError(f"depth is {depth} mm", expected="a positive, finite number")
    return simulate_steps(needle, tissue, (Step(float(depth), bevel, controls),), rules)


def simulate_steps(
    needle: Needle,
    tissue: Tissue,
    steps: Sequence[Step],
    rules: ModelOptions = _DEFAULT_OPTIONS,
    lattice: Lattice | None = None,
) -> NeedleShape:
    """Move the needle through `steps`, insertions and retractions, and return its last shape in C.

    Parameters
    ----------
    lattice : Lattice, optional
        Where constraint points lie; by default so that the last step ends on one.

    Raises
    ------
    ModelError
        If there are no steps, or the needle is too short for one of them.
    """
    lattice = lattice or make_lattice(steps, rules)
    moves = make_moves(steps, needle.length)
    run = begin_run(needle, tissue, lattice, rules, measure_arrays(steps, lattice, rules), rules.tolerance)
    turns = np.array([compute_turn(step.bevel, rules) for step in steps])
    status, iterations = CONVERGED, 0
    for controls_id, stops, bevel_id in pack_groups(moves, lattice):
        stops = stops._replace(turn=turns[bevel_id])
        conditions = compile_controls(steps[controls_id].controls)
        kernel.set_inputs(run, conditions, stops)
        status, used, shape, points = kernel.advance_needle(run, len(bevel_id))
        iterations += used
        if status != CONVERGED:
            break
    stop = make_stops(moves, lattice)[-1]
    if status != CONVERGED:
        insertion = kernel.get_insertion(run)
        return read_shape(insertion, tissue, stop, steps[-1].controls, status, iterations)
    scales = compute_scales(tissue, needle.flexural_rigidity, stop.tip, lattice.spacing)
    return make_shape(shape, points, iterations, scales)


def equilibrium(
    needle: Needle,
    tissue: Tissue,
    constraints: Floats,
    controls: Controls = _DEFAULT_CONTROLS,
    rules: ModelOptions = _DEFAULT_OPTIONS,
) -> NeedleShape:
    """Return the needle's equilibrium against given constraint points, without an insertion before it.

    Parameters
    ----------
    constraints : (M + 1, 2) array
        Depth (from 0, increasing, the last under the tip) and y of the points, mm; the mesh starts from
        the depth of point 1.
    """
    depths, y = np.ascontiguousarray(np.asarray(constraints, dtype=np.float64).T)
    depth = float(depths[-1])
    if not depth > 0:
        raise ModelError(f"depth is {depth} mm", expected="a positive, finite number")
    check_reach(needle.length, depth, controls)
    check_size((depth,), rules)
    conditions = compile_controls(controls)
    within = np.array([guide.x for guide in controls.within if guide.x <= depth - GUIDE_ENGAGEMENT_MM])
    nodes = list_node_depths(depth, depths[1], rules.spacing, rules.element, within)
    grid = build_grid(depths, tissue.boundaries, nodes, rules.cut_switch)
    last = len(grid.nodes) - 1
    size = 1 + len(controls.before) + len(grid.nodes)
    chain = kernel.begin_chain(conditions, needle.flexural_rigidity, size)
    kernel.prescribe_stop(chain, conditions, grid, last, depth, needle.length)
    state, trial, factor = np.zeros((size, 2)), np.empty((size, 2)), np.empty((size, FACTOR_COLUMNS))
    kernel.apply_prescribed(state, chain, size)
    newton = NewtonOptions(rules.tolerance, rules.max_iterations)
    status, iterations = find_equilibrium(
        state, chain, compile_tissue(tissue), grid, y, last, newton, trial, factor
    )
    if status != CONVERGED:
        state[:] = np.nan
    nodes = np.concatenate((chain.front, grid.nodes))
    points = np.column_stack((depths, y))
    u, slope = state.T.copy()
    scales = compute_scales(tissue, needle.flexural_rigidity, depth, rules.spacing)
    return NeedleShape(nodes, u, slope, points, state[-1:], STATUS_NAMES[status], iterations, scales)


def begin_insertion(
    needle: Needle, tissue: Tissue, steps: Sequence[Step], lattice: Lattice, rules: ModelOptions
) -> kernel.KernelInsertion:
    """Return the kernel's state before first contact, with arrays large enough for all steps."""
    size = measure_arrays(steps, lattice, rules)
    return kernel.begin_insertion(*_list_needle(needle, tissue, lattice, rules), *size, 0)


def begin_run(
    needle: Needle, tissue: Tissue, lattice: Lattice, rules: ModelOptions, size: tuple[float, int, int],
    tolerance: float, recorded: int = 0,
) -> kernel.InsertionRun:  # fmt: skip
    """Return a run of the kernel before first contact.

    Parameters
    ----------
    size : (depth, guides, rays)
        Of its arrays, as `measure_arrays` returns it.
    tolerance : float
        Of Newton's method, mm.
    recorded : int
        The number of stops whose state it records, for derivatives.
    """
    return kernel.begin_run(
        *_list_needle(needle, tissue, lattice, rules), *size, recorded, *list_layers(tissue),
        NewtonOptions(tolerance, rules.max_iterations),
    )  # fmt: skip


def measure_arrays(steps: Sequence[Step], lattice: Lattice, rules: ModelOptions) -> tuple[float, int, int]:
    """Return the depth (mm), the guides and the rays that arrays for all steps must have room for."""
    depths = tuple(step.depth for step in steps)
    check_size(depths, rules)
    deepest = max(depths)
    # At most one ray for each cell, one more for each step that changes inputs inside a cell, and one at the
    # entry.
    rays = lattice.cell(deepest) + len(steps) + 1
    return deepest, max(len(step.controls.guides) for step in steps), rays


def _list_needle(
    needle: Needle, tissue: Tissue, lattice: Lattice, rules: ModelOptions
) -> tuple[float, float, float, float, float, float, float, Floats]:
    return (
        needle.flexural_rigidity, needle.length, lattice.first_cell, lattice.spacing, rules.element,
        rules.cut_switch, rules.tangent, tissue.boundaries,
    )  # fmt: skip


def list_layers(tissue: Tissue) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Return the arguments of `make_foundation`."""
    return tissue.mu, *compile_law(tissue.law, tissue.alpha), tissue.thickness, tissue.friction


def compile_tissue(tissue: Tissue) -> Foundation:
    """Return the tissue in the form that the kernel reads."""
    return make_foundation(*list_layers(tissue))


@lru_cache(maxsize=64)
def compile_controls(controls: Controls) -> kernel.BoundaryConditions:
    """Return the boundary conditions in the form that the kernel reads."""
    return kernel.BoundaryConditions(
        np.array(list_base(controls)),
        _make_guide_array(controls.before),
        _make_guide_array(controls.within),
        np.array(list_tip(controls)),
    )


def list_base(controls: Controls) -> tuple[float, float, float]:
    """Return the kernel's numbers of the base."""
    return controls.base_y, controls.base_slope, controls.stage_slope


def list_tip(controls: Controls) -> tuple[float, float]:
    """Return the kernel's numbers of a tracked tip."""
    tip = controls.tip
    return (math.nan, math.nan) if tip is None else (tip.y, _or_nan(tip.slope))


def _make_guide_array(guides: tuple[Guide, ...]) -> Floats:
    return np.array([(guide.x, guide.y, _or_nan(guide.slope)) for guide in guides]).reshape(-1, 3)


def _or_nan(slope: float | None) -> float:
    return math.nan if slope is None else slope


@lru_cache(maxsize=512)  # a fit asks for the same insertions over and over
def pack_groups(moves: tuple[Move, ...], lattice: Lattice) -> tuple[tuple[int, kernel.TipStops, Ints], ...]:
    """Return the stops of all moves, grouped by equal controls: their number, the stops, bevel numbers."""
    return group_stops(make_stops(moves, lattice))


def group_stops(stops: Sequence[TipStop]) -> tuple[tuple[int, kernel.TipStops, Ints], ...]:
    """Return stops grouped as by `pack_groups`."""
    groups = groupby(stops, key=lambda stop: stop.controls_id)
    return tuple((controls_id, *pack_stops(tuple(some))) for controls_id, some in groups)


def pack_stops(stops: Sequence[TipStop]) -> tuple[kernel.TipStops, Ints]:
    """Return stops in the form that the kernel reads, without their turn, and the numbers of their bevels."""
    columns = zip(
        *((s.tip, s.cell, s.permanent, s.ray, s.starts_ray, s.extrapolates, s.bevel_id) for s in stops),
        strict=True,
    )
    tip, cell, permanent, ray, starts_ray, extrapolates, bevel_id = (np.array(column) for column in columns)
    stopped = kernel.TipStops(tip, cell, permanent, ray, starts_ray, extrapolates, np.empty(0))
    return stopped, bevel_id


def make_stop_arrays(count: int) -> kernel.TipStops:
    """Return room for so many stops in the form that the kernel reads."""
    tip, cell, flag = np.zeros(count), np.zeros(count, np.int64), np.zeros(count, np.bool_)
    return kernel.TipStops(tip, cell, flag, cell.copy(), flag.copy(), flag.copy(), tip.copy())


def compute_turn(bevel: Bevel, rules: ModelOptions) -> float:
    """Return the slope that a bevel adds to the cut."""
    strength, length = rules.bevel_strength(bevel)
    return bevel.side * strength / length


def make_shape(nodes: Floats, points: Floats, iterations: int, scales: Floats) -> NeedleShape:
    """Return the shape that `advance_needle` has found."""
    x, u, slope = nodes
    constraints, tip_track = points
    return NeedleShape(x, u, slope, constraints, tip_track, "converged", iterations, scales)


def read_shape(
    insertion: kernel.KernelInsertion,
    tissue: Tissue,
    stop: TipStop,
    controls: Controls,
    status: int,
    iterations: int,
) -> NeedleShape:
    """Return what is known of a needle that did not reach a stop; all else is NaN."""
    nodes = kernel.list_chain_nodes(insertion, compile_controls(controls), stop.tip, stop.cell)
    u, slope = np.full((2, len(nodes)), np.nan)
    depths = list_constraint_depths(stop.tip, stop.cell, insertion.first_cell, insertion.spacing)
    points = np.column_stack((depths, insertion.y[: stop.cell + 1]))
    track = insertion.track[: stop.cell + 1].copy()
    scales = compute_scales(tissue, insertion.rigidity, stop.tip, insertion.spacing)
    return NeedleShape(nodes, u, slope, points, track, STATUS_NAMES[status], iterations, scales)
