"""Check equilibria of finished insertions against an independent solution: SciPy's collocation of the beam
equation.

The collocation has no elements and no weak form.

Between the places where the nearest constraint point or the layer changes, and before the entry, the
deflection is smooth and obeys EI u'''' = -k e g. Each such piece is mapped to [0, 1]; all of them together
are one large system of first order. Its boundary conditions are the supports of the needle and the
continuity of u to u''' from piece to piece.
"""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_bvp

from needlefit.arrays import Bools, Floats, Ints
from needlefit.mechanics.control import Bevel, Controls, Guide, ModelOptions, Step
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.simulate import equilibrium, simulate_steps
from needlefit.mechanics.tissue import Tissue
from needlefit.verification.cases import (
    PAPER_NEEDLE,
    ReferenceLaw,
    interpolate,
    make_tissue,
    require_converged,
)
from needlefit.verification.check import Check, CheckOutcome, Group, Quantity, at_most, worst

_UNIT = 10.0  # mm: derivatives of order n are kept in mm per (10 mm)^n, to be alike in size
_TOLERANCE = 1e-6  # of scipy's residual; the deflection is then off by some 1e-8 mm
_AT = np.linspace(0.0, 1.0, 9)


@dataclass(frozen=True)
class SmoothPieces:
    """The needle divided where the equation is not smooth: P pieces between P + 1 edges."""

    edges: Floats  #: (P + 1,) from base to tip, mm
    inserted: Bools  #: (P,) whether the piece lies in the tissue
    layer: Ints  #: (P,)
    cut: Floats  #: (P,) y of the nearest constraint point, mm


def collocate(
    needle: Needle, tissue: Tissue, constraints: Floats, controls: Controls
) -> tuple[Floats, Floats]:
    """Solve one equilibrium by collocation; return depths x (K,) in the tissue and deflections (K,), mm.

    `constraints` (M + 1, 2) are depth and y of the constraint points, mm, the last under the tip.

    Raises ArithmeticError if the collocation does not converge.
    """
    pieces = divide_needle(needle, tissue, constraints, controls)
    count = len(pieces.cut)
    at_start, at_end, values = make_boundary_conditions(pieces, controls)
    length = np.diff(pieces.edges)
    stretch = np.repeat(length / _UNIT, 4)[:, None]  # (4 P, 1)
    law = ReferenceLaw.of(tissue)
    inserted, layer, cut = pieces.inserted, pieces.layer[:, None], pieces.cut[:, None]
    factor = np.where(inserted, _UNIT**4 / needle.flexural_rigidity, 0.0)[:, None]

    def parts(v: Floats) -> tuple[Floats, Floats]:
        w = v.reshape(count, 4, -1)
        return np.where(inserted[:, None], w[:, 0] - cut, 0.0), w[:, 1] / _UNIT

    def derivative(x: Floats, v: Floats) -> Floats:
        e, slope = parts(v)
        w = v.reshape(count, 4, -1)
        fourth = -factor * law.reaction(layer, e, slope)
        rates: Floats = stretch * np.concatenate((w[:, 1:], fourth[:, None]), axis=1).reshape(v.shape)
        return rates

    def jacobian(x: Floats, v: Floats) -> Floats:
        J = np.zeros((4 * count, 4 * count, v.shape[1]))
        rows = 4 * np.arange(count)
        # v = (u, u', u'', u''') of each piece, four rows: the first three rows are v_n' = v_(n + 1)
        for n in range(3):
            J[rows + n, rows + n + 1] = stretch[rows]
        by_e, by_slope = law.slopes(layer, *parts(v))
        J[rows + 3, rows] = -stretch[rows] * factor * by_e
        J[rows + 3, rows + 1] = -stretch[rows] * factor * by_slope / _UNIT
        return J

    guess = np.zeros((count, 4, 4))
    guess[:, 0] = np.where(inserted, pieces.cut, 0.0)[:, None]
    found = solve_bvp(
        derivative,
        lambda a, b: at_start @ a + at_end @ b - values,
        np.linspace(0.0, 1.0, 4),
        guess.reshape(4 * count, -1),
        fun_jac=jacobian,
        bc_jac=lambda a, b: (at_start, at_end),
        tol=_TOLERANCE,
        bc_tol=1e-12,
        max_nodes=400,
    )
    if not found.success:
        raise ArithmeticError(f"the collocation did not converge: {found.message}")
    x = pieces.edges[:-1, None] + length[:, None] * _AT  # (P, 9)
    u = found.sol(_AT).reshape(count, 4, -1)[:, 0]
    return x[inserted].ravel(), u[inserted].ravel()


def divide_needle(needle: Needle, tissue: Tissue, constraints: Floats, controls: Controls) -> SmoothPieces:
    """Divide the needle into pieces on which tissue and constraint point are the same."""
    depths, y = constraints.T
    tip = depths[-1]
    halfway = 0.5 * (depths[1:] + depths[:-1])
    stations = [guide.x for guide in (*controls.before, *controls.within)]
    edges = np.unique(np.concatenate(([tip - needle.length, 0.0, tip], stations, halfway, tissue.boundaries)))
    edges = edges[edges <= tip]
    middle = 0.5 * (edges[1:] + edges[:-1])
    nearest = np.abs(middle[:, None] - depths).argmin(axis=1)
    return SmoothPieces(edges, middle > 0, np.searchsorted(tissue.boundaries, middle), y[nearest])


def make_boundary_conditions(pieces: SmoothPieces, controls: Controls) -> tuple[Floats, Floats, Floats]:
    """Return A, B (4 P, 4 P) and d (4 P,) of the boundary conditions A v(0) + B v(1) = d."""
    count = len(pieces.cut)
    A, B, d = np.zeros((4 * count, 4 * count)), np.zeros((4 * count, 4 * count)), np.zeros(4 * count)
    row = 0

    def demand(value: float, at_start: dict[int, float], at_end: dict[int, float]) -> None:
        nonlocal row
        for column, factor in at_start.items():
            A[row, column] = factor
        for column, factor in at_end.items():
            B[row, column] = factor
        d[row] = value
        row += 1

    tip, end = controls.tip, 4 * (count - 1)
    demand(controls.base_y + controls.stage_slope * pieces.edges[-1], {0: 1.0}, {})
    demand(controls.base_slope * _UNIT, {1: 1.0}, {})
    held = {guide.x: guide for guide in controls.guides}
    for i, edge in enumerate(pieces.edges[1:-1]):
        left, right = 4 * i, 4 * (i + 1)
        guide = held.get(float(edge))
        # a free guide exerts a force: u''' jumps; one that holds the slope exerts a moment too: u'' jumps as
        # well
        continuous = range(4) if guide is None else range(3) if guide.slope is None else range(2)
        for n in continuous:
            demand(0.0, {right + n: 1.0}, {left + n: -1.0})
        if guide is not None:
            demand(guide.y, {right: 1.0}, {})
            if guide.slope is not None:
                demand(guide.slope * _UNIT, {right + 1: 1.0}, {})
    if tip is None:
        demand(0.0, {}, {end + 2: 1.0})
        demand(0.0, {}, {end + 3: 1.0})
    else:
        demand(tip.y, {}, {end: 1.0})
        slope = tip.slope
        # entries of v: u, u', u'', u'''; without a slope to hold, the tip has no moment (entry 2)
        demand(0.0 if slope is None else slope * _UNIT, {}, {end + (2 if slope is None else 1): 1.0})
    return A, B, d


def _check(title: str, tissue: Tissue, *steps: Step) -> Check:
    """Return a check of the last equilibrium of an insertion."""

    def measure(rng: np.random.Generator) -> CheckOutcome:
        constraints = require_converged(simulate_steps(PAPER_NEEDLE, tissue, steps)).constraints
        controls = steps[-1].controls
        x, u = collocate(PAPER_NEEDLE, tissue, constraints, controls)
        shapes = (
            equilibrium(PAPER_NEEDLE, tissue, constraints, controls, rules)
            for rules in (ModelOptions(element=0.25, tolerance=1e-9), ModelOptions())
        )
        errors = (worst(np.abs(interpolate(require_converged(shape), x) - u)) for shape in shapes)
        return CheckOutcome(tuple(errors))

    quantities = (
        Quantity("difference of the deflection, h = 0.25 mm", at_most(1e-6), "mm"),
        Quantity("difference of the deflection, h = 1 mm", at_most(1e-5), "mm"),
    )
    return Check(Group.COLLOCATION, title, quantities, measure)


_FREE = Bevel(0.085)
CHECKS = (
    _check(
        "Four layers of the paper’s values, 35.3 mm deep",
        make_tissue(mu=[0.2, 33.0, 0.2, 33.0], alpha=[1.0, -1.0, 1.0, -1.0], boundaries=[12.2, 18.7, 29.4]),
        Step(35.3, _FREE),
    ),
    _check(
        "Thin tissue (t = 5 mm), α = −10, base moved aside",
        make_tissue(mu=[0.2, 2.0], alpha=[-10.0, -10.0], boundaries=[9.6], thickness=[5.0, 5.0]),
        Step(25.0, Bevel(0.25), Controls(base_y=2.0)),
    ),
    _check(
        "Thin tissue (t = 5 mm), α = 10, bevel turned over, free guide",
        make_tissue(mu=[0.3, 1.0], alpha=[10.0, 10.0], boundaries=[11.5], thickness=[5.0, 5.0]),
        Step(14.5, Bevel(0.3)),
        Step(30.0, Bevel(0.3, -1), Controls(base_y=1.0, guides=(Guide(-15.0, 0.5, None),))),
    ),
    _check(
        "Neo-Hookean law, t = 5 mm, base moved aside",
        make_tissue(
            mu=[0.4, 4.0], alpha=[-7.0, 9.0], boundaries=[10.4], thickness=[5.0, 5.0], law="neo_hookean"
        ),
        Step(26.7, Bevel(0.2), Controls(base_y=2.0)),
    ),
    _check(
        "Friction, base tilted after 15 mm",
        make_tissue(
            mu=[0.5, 5.0], alpha=[3.0, -4.0], boundaries=[13.3], thickness=[10.0, 10.0], friction=[2.0, 2.0]
        ),
        Step(15.0, Bevel(0.2)),
        Step(28.4, Bevel(0.2), Controls(base_slope=0.1)),
    ),
)
