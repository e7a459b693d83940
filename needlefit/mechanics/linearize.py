"""Compute a needle's shape and its exact derivatives with respect to the parameters, in one pass."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from needlefit.arrays import Floats, Ints
from needlefit.errors import ModelError
from needlefit.mechanics.control import Bevel, Controls, ModelOptions, Step
from needlefit.mechanics.kernel import insertion as forward
from needlefit.mechanics.kernel import insertion_derivatives as kernel
from needlefit.mechanics.kernel.beam import compute_position_derivatives
from needlefit.mechanics.kernel.parameter_loads import DerivativeColumns, DerivativeHistory
from needlefit.mechanics.kernel.scalar import CONVERGED
from needlefit.mechanics.law_form import differentiate_law
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.plan import Lattice, make_lattice, make_moves, make_stops
from needlefit.mechanics.shape import NeedleShape
from needlefit.mechanics.simulate import (
    begin_run,
    compile_controls,
    make_shape,
    measure_arrays,
    pack_groups,
    read_shape,
)
from needlefit.mechanics.tissue import Tissue
from needlefit.mechanics.validity import compute_scales

DERIVATIVE_KINDS = (
    "mu", "alpha", "friction", "boundaries", "rigidity", "offset", "cut_angle", "base_y", "base_slope",
    "stage_slope", "guides",
)  # fmt: skip
"""Kinds of parameters that `wrt` accepts, in the order of the Jacobian's columns."""

_DEFAULT_CONTROLS = Controls()
_DEFAULT_OPTIONS = ModelOptions()
_DEFAULT_WRT = ("mu", "alpha", "offset")

MAX_TOLERANCE_MM = 1e-9
"""Newton tolerance, mm: derivatives at a state that is 1e-7 mm off are up to 1e-6 wrong."""


@dataclass(frozen=True)
class Jacobian:
    """Derivatives of a `NeedleShape` with respect to P parameters, per MPa, mm, N mm^2, rad or 1.

    Bevel and base are shifted alike in all steps; guides of several steps at the same x are one guide,
    numbered by x. Where a node itself moves along the needle, its deflection is followed along with it.

    Attributes
    ----------
    names : tuple of str
        mu1, ..., alpha1, ..., friction1, ..., boundary1, ..., rigidity, offset, cut_angle, base_y,
        base_slope, stage_slope, guide1_x, guide1_y, guide1_slope, ...
    x : (N, P) array
        Of the nodes' beam coordinates: 1 for a guide's node and its own x, else 0.
    u, slope : (N, P) arrays
        Of the nodes' deflection and slope.
    constraints : (M + 1, P) array
        Of the y of the constraint points.
    tip_track : (M + 1, P) array
        Of the tip's deflection as it stood at each constraint point.
    """

    names: tuple[str, ...]
    x: Floats
    u: Floats
    slope: Floats
    constraints: Floats
    tip_track: Floats


def linearize(
    needle: Needle,
    tissue: Tissue,
    bevel: Bevel,
    depth: float,
    controls: Controls = _DEFAULT_CONTROLS,
    rules: ModelOptions = _DEFAULT_OPTIONS,
    *,
    wrt: Sequence[str] = _DEFAULT_WRT,
) -> tuple[NeedleShape, Jacobian]:
    """Insert the needle as `simulate` does; return its shape and the derivatives of that shape.

    Parameters
    ----------
    wrt : sequence of str
        Kinds of parameters, of `DERIVATIVE_KINDS`; the columns stand in the order of `DERIVATIVE_KINDS`.

    Returns
    -------
    NeedleShape
    Jacobian
        NaN where the solution failed.

    Raises
    ------
    ModelError
        If the needle is too short for the depth or the guides, or there is no such kind of parameter.
    """
    if not (math.isfinite(depth) and depth > 0):
        raise ModelError(f"depth is {depth} mm", expected="a positive, finite number")
    return linearize_steps(needle, tissue, (Step(float(depth), bevel, controls),), rules, wrt=wrt)


def linearize_steps(
    needle: Needle,
    tissue: Tissue,
    steps: Sequence[Step],
    rules: ModelOptions = _DEFAULT_OPTIONS,
    lattice: Lattice | None = None,
    *,
    wrt: Sequence[str] = _DEFAULT_WRT,
) -> tuple[NeedleShape, Jacobian]:
    """Insert the needle as `simulate_steps` does; return its last shape and the derivatives of that shape.

    Parameters and returns are those of `simulate_steps` and `linearize`.
    """
    lattice = lattice or make_lattice(steps, rules)
    moves = make_moves(steps, needle.length)
    guide_depths = _list_guide_depths(steps)
    names, columns, guide_columns = _make_columns(tuple(wrt), tissue.layers, guide_depths, rules.path_angle)
    groups = pack_groups(moves, lattice)
    deepest, guides, rays = measure_arrays(steps, lattice, rules)
    # Derivatives belong to the converged state: they need a smaller tolerance than shapes do, and the state
    # at each stop of a group, of which a forward run keeps none.
    recorded = max(len(stops.tip) for _, stops, _ in groups)
    tolerance = min(rules.tolerance, MAX_TOLERANCE_MM)
    run = begin_run(needle, tissue, lattice, rules, (deepest, guides, rays), tolerance, recorded)
    by_alpha = differentiate_law(tissue.law, tissue.alpha)
    history = _make_history(max(lattice.cell(deepest), 1) + 1, rays, columns.total)
    strengths = np.array([rules.bevel_strength(step.bevel)[0] for step in steps])
    sides = np.array([step.bevel.side / rules.bevel_strength(step.bevel)[1] for step in steps])
    status, iterations = CONVERGED, 0
    for n, (controls_id, stops, bevel_id) in enumerate(groups):
        turn_per_strength = sides[bevel_id]
        stops = stops._replace(turn=strengths[bevel_id] * turn_per_strength)
        controls = steps[controls_id].controls
        conditions = compile_controls(controls)
        # All stops of a group are solved before the first derivative: `record` keeps the state at each.
        forward.set_inputs(run, conditions, stops)
        status, used, nodes, points = forward.advance_needle(run, len(bevel_id))
        iterations += used
        if status == CONVERGED:
            own_columns = _list_guide_columns(controls, guide_depths, guide_columns)
            status, whole = kernel.differentiate_stops(
                run, by_alpha, own_columns, turn_per_strength, columns, history, n + 1 == len(groups)
            )
        if status != CONVERGED:
            break
    stop = make_stops(moves, lattice)[-1]
    if status != CONVERGED:
        shape = read_shape(forward.get_insertion(run), tissue, stop, steps[-1].controls, status, iterations)
        return shape, _make_nan_jacobian(names, shape)
    scales = compute_scales(tissue, needle.flexural_rigidity, stop.tip, lattice.spacing)
    shape = make_shape(nodes, points, iterations, scales)
    reached = slice(len(shape.constraints))
    by_x = _differentiate_nodes(shape.x, controls, own_columns, columns.total)
    return shape, Jacobian(
        names, by_x, whole[:, 0], whole[:, 1], history.constraints[reached], history.track[reached, 0]
    )


def differentiate_positions(shape: NeedleShape, jacobian: Jacobian, s: Floats) -> Floats:
    """Return the derivatives (K, 2, P) of `positions(shape, s)` with respect to the Jacobian's parameters.

    Parameters
    ----------
    s : (K,) array
        Beam coordinates on the needle, mm.
    """
    wanted = np.ascontiguousarray(s, dtype=np.float64)
    return compute_position_derivatives(
        shape.x, shape.u, shape.slope, wanted, jacobian.x,
        np.ascontiguousarray(jacobian.u), np.ascontiguousarray(jacobian.slope),
    )  # fmt: skip


def _list_guide_depths(steps: Sequence[Step]) -> tuple[float, ...]:
    """Return where guides stand in any step, mm, from the base inwards."""
    return tuple(sorted({guide.x for step in steps for guide in step.controls.guides}))


@lru_cache(maxsize=512)  # a fit asks for the same columns over and over
def _make_columns(
    wrt: tuple[str, ...], layers: int, guide_depths: tuple[float, ...], path_angle: bool
) -> tuple[tuple[str, ...], DerivativeColumns, Ints]:
    """Return the columns' names, where each kind begins, and each guide's columns (G, 3)."""
    wrong = [kind for kind in wrt if kind not in DERIVATIVE_KINDS]
    if wrong:
        raise ModelError(
            f"there is no derivative with respect to `{wrong[0]}`",
            expected=f"of {', '.join(DERIVATIVE_KINDS)}",
        )
    names: list[str] = []
    first: dict[str, int] = {}
    for kind in DERIVATIVE_KINDS:
        first[kind] = len(names) if kind in wrt else -1
        if kind in wrt:
            names += _list_names(kind, layers, len(guide_depths))
    guide_columns = np.full((len(guide_depths), 3), -1)
    if first["guides"] >= 0:
        guide_columns = first["guides"] + np.arange(3 * len(guide_depths)).reshape(-1, 3)
    # The bevel's strength has one column in the kernel; that of the rule which is not used stays 0.
    kinds = [kind for kind in DERIVATIVE_KINDS[:-1] if kind != ("offset" if path_angle else "cut_angle")]
    return tuple(names), DerivativeColumns(len(names), *(first[kind] for kind in kinds)), guide_columns


def _list_names(kind: str, layers: int, guides: int) -> list[str]:
    if kind in ("mu", "alpha", "friction"):
        return [f"{kind}{i + 1}" for i in range(layers)]
    if kind == "boundaries":
        return [f"boundary{i + 1}" for i in range(layers - 1)]
    if kind == "guides":
        return [f"guide{i + 1}_{what}" for i in range(guides) for what in ("x", "y", "slope")]
    return [kind]


def _list_guide_columns(controls: Controls, guide_depths: tuple[float, ...], guide_columns: Ints) -> Ints:
    """Return the columns (G, 3) of the guides of one step."""
    if not controls.guides:
        return guide_columns[:0]
    return guide_columns[[guide_depths.index(guide.x) for guide in controls.guides]]


def _make_history(points: int, rays: int, columns: int) -> DerivativeHistory:
    """Return the derivatives before first contact."""
    return DerivativeHistory(
        np.zeros((points, columns)), np.zeros((rays, 2, columns)), np.zeros((2, columns)), np.zeros(points),
        np.zeros((points, 2, columns)), np.zeros(columns),
    )  # fmt: skip


def _differentiate_nodes(x: Floats, controls: Controls, guide_columns: Ints, columns: int) -> Floats:
    """Return how the nodes (N,) move along the needle: those of guides that hold it, with their own x."""
    nodes = np.zeros((len(x), columns))
    for guide, column in zip(controls.guides, guide_columns[:, 0], strict=True):
        if column >= 0:
            nodes[:-1][x[:-1] == guide.x, column] = 1.0  # none holds the tip
    return nodes


def _make_nan_jacobian(names: tuple[str, ...], shape: NeedleShape) -> Jacobian:
    nodes = np.full((len(shape.x), len(names)), np.nan)
    points = np.full((len(shape.constraints), len(names)), np.nan)
    return Jacobian(names, nodes, nodes, nodes, points, points)
