"""The model as pure functions: needle, tissue and inputs -> shape."""

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from needlefit.errors import ModelError
from needlefit.mechanics import laws
from needlefit.mechanics.control import Bevel, Controls, Guide, Rules, Step
from needlefit.mechanics.kernel import insertion as kernel
from needlefit.mechanics.kernel.foundation import Foundation, make_foundation
from needlefit.mechanics.kernel.grid import GRIP, build_grid, constraint_depths, node_depths
from needlefit.mechanics.kernel.scalar import CONVERGED, WIDTH, Newton, equilibrate
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.plan import (
    Lattice,
    Move,
    Stop,
    check_reach,
    check_size,
    lattice_of,
    moves_of,
    stops_of,
)
from needlefit.mechanics.shape import NeedleShape, Status
from needlefit.mechanics.tissue import Tissue
from needlefit.mechanics.validity import scales_of

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

STATUS: tuple[Status, ...] = ("converged", "over-compressed", "not converged", "non-finite")
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
    return follow(needle, tissue, (Step(float(depth), bevel, controls),), rules)


def follow(
    needle: Needle,
    tissue: Tissue,
    steps: Sequence[Step],
    rules: Rules = _DEFAULT_RULES,
    lattice: Lattice | None = None,
) -> NeedleShape:
    """Lead the needle through `steps`, insertions and retractions, and return its last shape in C.

    Parameters
    ----------
    needle : Needle
    tissue : Tissue
    steps : sequence of Step
    rules : Rules
    lattice : Lattice, optional
        Where constraint points lie; by default so that the last step ends on one.

    Returns
    -------
    NeedleShape

    Raises
    ------
    ModelError
        If there are no steps, or the needle is too short for one of them.
    """
    lattice = lattice or lattice_of(steps, rules)
    moves = moves_of(steps, needle.length)
    under_way = begin(needle, tissue, steps, lattice, rules)
    foundation = compile_tissue(tissue)
    newton = Newton(rules.tolerance, rules.max_iterations)
    turns = np.array([step.bevel.side * step.bevel.offset / rules.spacing for step in steps])
    status, iterations = CONVERGED, 0
    for held, stops, cut in packed(moves, lattice):
        stops = stops._replace(turn=turns[cut])
        holds = compile_controls(steps[held].controls)
        status, used, _ = kernel.advance(under_way, foundation, holds, stops, newton)
        iterations += used
        if status != CONVERGED:
            break
    return read(under_way, tissue, stops_of(moves, lattice)[-1], steps[-1].controls, status, iterations)


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
        Depth (from 0, increasing, the last under the tip) and y of the points, mm; the mesh starts from
        the depth of point 1.
    """
    depths, y = np.ascontiguousarray(np.asarray(constraints, dtype=np.float64).T)
    depth = float(depths[-1])
    if not depth > 0:
        raise ModelError(f"depth is {depth} mm", expected="a positive, finite number")
    check_reach(needle.length, depth, controls)
    check_size((depth,), rules)
    holds = compile_controls(controls)
    within = np.array([guide.x for guide in controls.within if guide.x <= depth - GRIP])
    nodes = node_depths(depth, depths[1], rules.spacing, rules.element, within)
    grid = build_grid(depths, tissue.boundaries, nodes, rules.switch)
    last = len(grid.nodes) - 1
    size = 1 + len(controls.before) + len(grid.nodes)
    chain = kernel.begin_chain(holds, needle.flexural_rigidity, size)
    kernel.hold(chain, holds, grid, last, depth, needle.length)
    state, trial, factor = np.zeros((size, 2)), np.empty((size, 2)), np.empty((size, WIDTH))
    kernel.start(state, chain, size)
    newton = Newton(rules.tolerance, rules.max_iterations)
    status, iterations = equilibrate(
        state, chain, compile_tissue(tissue), grid, y, last, newton, trial, factor
    )
    if status != CONVERGED:
        state[:] = np.nan
    nodes = np.concatenate((chain.front, grid.nodes))
    points = np.column_stack((depths, y))
    scales = scales_of(tissue, needle.flexural_rigidity, depth, rules.spacing)
    return NeedleShape(
        nodes, state[:, 0], state[:, 1], points, state[-1:], STATUS[status], iterations, scales
    )


def begin(
    needle: Needle, tissue: Tissue, steps: Sequence[Step], lattice: Lattice, rules: Rules
) -> kernel.Insertion:
    """Return the needle before first contact, with room for all steps."""
    depths = tuple(step.depth for step in steps)
    check_size(depths, rules)
    deepest = max(depths)
    guides = max(len(step.controls.guides) for step in steps)
    rays = lattice.cell(deepest) + len(steps) + 1
    return kernel.begin(
        needle.flexural_rigidity, needle.length, lattice.first_cell, lattice.spacing, rules.element,
        rules.switch, rules.tangent, tissue.boundaries, deepest, guides, rays,
    )  # fmt: skip


def compile_tissue(tissue: Tissue) -> Foundation:
    """Return the tissue as the kernel reads it."""
    coefficients, exponents = laws.power_terms(tissue.law, tissue.alpha)
    return make_foundation(tissue.mu, coefficients, exponents, tissue.thickness, tissue.friction)


@lru_cache(maxsize=64)
def compile_controls(controls: Controls) -> kernel.Holds:
    """Return the inputs as the kernel reads them."""
    tip = controls.tip
    return kernel.Holds(
        np.array([controls.base_y, controls.base_slope, controls.stage_slope]),
        _places(controls.before),
        _places(controls.within),
        np.array([np.nan, np.nan] if tip is None else [tip.y, _or_nan(tip.slope)]),
    )


def _places(guides: tuple[Guide, ...]) -> Floats:
    return np.array([(guide.x, guide.y, _or_nan(guide.slope)) for guide in guides]).reshape(-1, 3)


def _or_nan(slope: float | None) -> float:
    return math.nan if slope is None else slope


@lru_cache(maxsize=512)  # a fit asks for the same insertions over and over
def packed(moves: tuple[Move, ...], lattice: Lattice) -> tuple[tuple[int, kernel.Stops, Ints], ...]:
    """Return the stops of all moves in groups under the same inputs: whose, the stops, and whose bevels."""
    groups = []
    for held, some in groupby(stops_of(moves, lattice), key=lambda stop: stop.held):
        stops, cut = pack(tuple(some))
        groups.append((held, stops, cut))
    return tuple(groups)


def pack(stops: Sequence[Stop]) -> tuple[kernel.Stops, Ints]:
    """Return stops as the kernel reads them, their turn left open, and the names of their bevels."""
    columns = zip(*((s.tip, s.cell, s.permanent, s.ray, s.opens, s.cut) for s in stops), strict=True)
    tip, cell, permanent, ray, opens, cut = (np.array(column) for column in columns)
    return kernel.Stops(tip, cell, permanent, ray, opens, np.empty(0)), cut


def read(
    under_way: kernel.Insertion, tissue: Tissue, stop: Stop, controls: Controls, status: int, iterations: int
) -> NeedleShape:
    """Return the needle's shape at a stop; NaN where the solution failed on the way there."""
    if status == CONVERGED:
        size = int(under_way.size[0])
        nodes, state = under_way.nodes[:size].copy(), under_way.states[0, :size].copy()
    else:
        nodes = kernel.chain_nodes(under_way, compile_controls(controls), stop.tip, stop.cell)
        state = np.full((len(nodes), 2), np.nan)
    x = constraint_depths(stop.tip, stop.cell, under_way.first_cell, under_way.spacing)
    points = np.empty((len(x), 2))
    points[:, 0], points[:, 1] = x, under_way.y[: stop.cell + 1]
    track = under_way.track[: stop.cell + 1].copy()
    scales = scales_of(tissue, under_way.rigidity, stop.tip, under_way.spacing)
    return NeedleShape(nodes, state[:, 0], state[:, 1], points, track, STATUS[status], iterations, scales)
