"""Compute a needle's shape and its exact derivatives with respect to the parameters, in one pass."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from needlefit.arrays import Floats
from needlefit.errors import ModelError
from needlefit.mechanics import native
from needlefit.mechanics.control import Bevel, Controls, ModelOptions, Step
from needlefit.mechanics.laws import LAWS
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.packing import Columns, pack_problem, plan_insertion
from needlefit.mechanics.plan import Lattice
from needlefit.mechanics.shape import NeedleShape
from needlefit.mechanics.simulate import list_depths, read_shape
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

MAX_TOLERANCE_MM = 1e-9
"""Newton tolerance of the shape that is differentiated, mm; at this, `simulate_steps` gives the same shape."""


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
    lattice, packed = plan_insertion(steps, needle.length, rules, lattice)
    guide_depths = tuple(
        sorted({guide.x for step in steps for guide in step.controls.guides})
    )  # from the base on
    names, columns = _make_columns(tuple(wrt), tissue.law, tissue.layers, guide_depths, rules.path_angle)
    rules = replace(rules, tolerance=min(rules.tolerance, MAX_TOLERANCE_MM))
    problem = pack_problem(needle, tissue, steps, lattice, rules, packed, columns=columns)
    shapes = native.make_shapes(problem, packed.last.cell + 1)
    native.simulate(problem, shapes, 0, 1)
    scales = compute_scales(tissue, needle.flexural_rigidity, packed.last.tip, lattice.spacing)
    shape = read_shape(shapes, list_depths(packed.last, lattice), scales)
    by_x = _differentiate_nodes(shape.x, steps[-1].controls, columns)
    if not names:
        return shape, Jacobian((), by_x, by_x, by_x, *(np.empty((len(shape.constraints), 0)),) * 2)
    u, slope = (shapes.arrays[name][0, : len(shape.x)].copy() for name in ("u_by", "slope_by"))
    points, track = (shapes.arrays[name][0].copy() for name in ("constraints_by", "track_by"))
    return shape, Jacobian(names, by_x if shape.converged else u, u, slope, points, track)


def differentiate_positions(shape: NeedleShape, jacobian: Jacobian, s: Floats) -> Floats:
    """Return the derivatives (K, 2, P) of `positions(shape, s)` with respect to the Jacobian's parameters.

    Parameters
    ----------
    s : (K,) array
        Beam coordinates on the needle, mm.
    """
    return native.compute_position_derivatives(
        shape.x, shape.u, shape.slope, s, jacobian.x, jacobian.u, jacobian.slope
    )


@lru_cache(maxsize=512)  # a fit asks for the same columns over and over
def _make_columns(
    wrt: tuple[str, ...], law: str, layers: int, guide_depths: tuple[float, ...], path_angle: bool
) -> tuple[tuple[str, ...], Columns]:
    """Return the columns' names, and the columns."""
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
    return tuple(names), Columns(len(names), np.array([first[kind] for kind in kinds]), guides)


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


def _differentiate_nodes(x: Floats, controls: Controls, columns: Columns) -> Floats:
    """Return how the nodes (N,) move along the needle: those of guides that hold it, with their own x."""
    nodes = np.zeros((len(x), columns.total))
    for guide in controls.guides:
        column = columns.guides[guide.x][0]
        if column >= 0:
            nodes[:-1][x[:-1] == guide.x, column] = 1.0  # none holds the tip
    return nodes
