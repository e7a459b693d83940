"""Compute a needle's shape and its exact derivatives with respect to the parameters, in one pass."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from needlefit.arrays import Bools, Floats
from needlefit.errors import ModelError
from needlefit.mechanics import native
from needlefit.mechanics.batch import NeedleShapes
from needlefit.mechanics.control import Bevel, Controls, ModelOptions, Step
from needlefit.mechanics.laws import LAWS
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.packing import Columns
from needlefit.mechanics.plan import Lattice
from needlefit.mechanics.prepared import Evaluation, PreparedInsertion, run_evaluations
from needlefit.mechanics.shape import NeedleShape
from needlefit.mechanics.simulate import read_shape
from needlefit.mechanics.tissue import Tissue
from needlefit.mechanics.validity import compute_scales

DERIVATIVE_KINDS = (
    "mu", "shape", "friction", "boundaries", "rigidity", "offset", "cut_angle", "base_y", "base_slope",
    "stage_slope", "guides",
)  # fmt: skip
"""Kinds of parameters that `wrt` accepts, in the order of the Jacobian's columns."""

_DEFAULT_CONTROLS = Controls()
_DEFAULT_OPTIONS = ModelOptions()
_DEFAULT_WRT = ("mu", "shape", "offset")


@dataclass(frozen=True)
class Jacobian:
    """Derivatives of a `NeedleShape` with respect to P parameters, per MPa, mm, N mm^2, rad or 1.

    Bevel and base are shifted alike in all steps; guides of several steps at the same x are one guide,
    numbered by x. Where a node itself moves along the needle, its deflection is followed along with it.

    Attributes
    ----------
    names : tuple of str
        mu1, ..., the law's shape parameters (alpha1, ...), friction1, ..., boundary1, ..., rigidity, offset,
        cut_angle, base_y, base_slope, stage_slope, guide1_x, guide1_y, guide1_slope, ...
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


@dataclass(frozen=True)
class Jacobians:
    """Derivatives of `NeedleShapes`: the fields of `Jacobian` with a leading axis of B sets, but for `x`.

    Attributes
    ----------
    x : (N, P) array
        The same for all sets.
    u, slope : (B, N, P) arrays
    constraints, tip_track : (B, M + 1, P) arrays
    converged : (B,) array of bool
        All derivatives of other sets are NaN.
    """

    names: tuple[str, ...]
    x: Floats
    u: Floats
    slope: Floats
    constraints: Floats
    tip_track: Floats
    converged: Bools

    def __getitem__(self, i: int) -> Jacobian:
        u, points, track = self.u[i], self.constraints[i], self.tip_track[i]
        return Jacobian(self.names, self.x if self.converged[i] else u, u, self.slope[i], points, track)


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
    columns = find_columns(tuple(wrt), tissue, steps, rules)
    insertion = PreparedInsertion(needle, tissue, steps, rules, lattice, columns)
    one = Evaluation(insertion, 1, {}, np.ones(1, dtype=bool))
    run_evaluations([one], 1)
    scales = compute_scales(tissue, needle.flexural_rigidity, insertion.depth, insertion.lattice.spacing)
    shape = read_shape(one.shapes, scales)
    return shape, read_jacobians(one, np.array([shape.converged]))[0]


def read_jacobians(evaluation: Evaluation, converged: Bools) -> Jacobians:
    """Return the derivatives of all sets of an evaluation with columns that was run."""
    insertion = evaluation.insertion
    assert insertion.columns is not None
    x = evaluation.shapes.arrays["x"][evaluation.some]
    by_x = _differentiate_nodes(x, insertion, evaluation.values.get("guide_x"), evaluation.some)
    if not insertion.columns.total:
        nodes, points = (np.empty((evaluation.sets, size, 0)) for size in (len(x), insertion.points))
        return Jacobians((), by_x, nodes, nodes, points, points, converged)
    arrays = [evaluation.shapes.arrays[f"{name}_by"] for name in ("u", "slope", "constraints", "track")]
    if not evaluation.valid.all():
        for array in arrays:
            array[~evaluation.valid] = np.nan
    u, slope, points, track = arrays
    return Jacobians(insertion.columns.names, by_x, u, slope, points, track, converged)


def differentiate_positions(shape: NeedleShape, jacobian: Jacobian, s: Floats) -> Floats:
    """Return the derivatives (K, 2, P) of `positions(shape, s)` with respect to the Jacobian's parameters.

    Parameters
    ----------
    s : (K,) array
        Beam coordinates on the needle, mm.
    """
    x, u, slope, u_by, slope_by = (
        np.ascontiguousarray(part)[None]
        for part in (shape.x, shape.u, shape.slope, jacobian.u, jacobian.slope)
    )
    wanted, x_by = np.ascontiguousarray(s, dtype=np.float64), np.ascontiguousarray(jacobian.x)
    found: Floats = native.compute_position_derivatives(x, u, slope, wanted, x_by, u_by, slope_by)[0]
    return found


def differentiate_batch_positions(shapes: NeedleShapes, jacobians: Jacobians, s: Floats) -> Floats:
    """Return the derivatives (B, K, 2, P) of `compute_batch_positions(shapes, s)`."""
    x, u, slope, wanted = (
        np.ascontiguousarray(part, dtype=np.float64) for part in (shapes.x, shapes.u, shapes.slope, s)
    )
    return native.compute_position_derivatives(x, u, slope, wanted, jacobians.x, jacobians.u, jacobians.slope)


def find_columns(wrt: tuple[str, ...], tissue: Tissue, steps: Sequence[Step], rules: ModelOptions) -> Columns:
    """Return the columns of the derivatives of an insertion by kinds of parameters, of `DERIVATIVE_KINDS`.

    Raises
    ------
    ModelError
        If there is no such kind of parameter.
    """
    guide_depths = sorted({guide.x for step in steps for guide in step.controls.guides})  # from the base on
    return _make_columns(wrt, tissue.law, tissue.layers, tuple(guide_depths), rules.path_angle)


@lru_cache(maxsize=512)  # a fit asks for the same columns over and over
def _make_columns(
    wrt: tuple[str, ...], law: str, layers: int, guide_depths: tuple[float, ...], path_angle: bool
) -> Columns:
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
            names += _list_names(kind, law, layers, len(guide_depths))
    at = first["guides"]
    guides = {
        x: (-1, -1, -1) if at < 0 else range(at + 3 * i, at + 3 * i + 3) for i, x in enumerate(guide_depths)
    }
    # The bevel's strength has one column in the kernel; that of the rule which is not used stays 0.
    kinds = [kind for kind in DERIVATIVE_KINDS[:-1] if kind != ("offset" if path_angle else "cut_angle")]
    return Columns(tuple(names), np.array([first[kind] for kind in kinds]), guides)


def _list_names(kind: str, law: str, layers: int, guides: int) -> list[str]:
    if kind == "shape":
        return [name for row in LAWS[law].name_shape(range(1, layers + 1)) for name in row]
    if kind in ("mu", "friction"):
        return [f"{kind}{i + 1}" for i in range(layers)]
    if kind == "boundaries":
        return [f"boundary{i + 1}" for i in range(layers - 1)]
    if kind == "guides":
        return [f"guide{i + 1}_{what}" for i in range(guides) for what in ("x", "y", "slope")]
    return [kind]


def _differentiate_nodes(
    x: Floats, insertion: PreparedInsertion, guide_x: Floats | None, some: int
) -> Floats:
    """Return how the nodes (N,) of a set move along the needle: those of guides that hold it move with it.

    The first guide stands at `guide_x` (B,) of this set, where that is given.
    """
    columns, controls = insertion.columns, insertion.steps[-1].controls
    assert columns is not None
    nodes = np.zeros((len(x), columns.total))
    for number, guide in enumerate(controls.guides):
        column = columns.guides[guide.x][0]
        place = guide.x if guide_x is None or number else guide_x[some]
        if column >= 0:
            nodes[:-1][x[:-1] == place, column] = 1.0  # none holds the tip
    return nodes
