"""Equilibria of finished insertions by SciPy's collocation of the beam equation: no elements, no weak form.

Between the places where the nearest constraint point or the layer changes, and before the entry, the
deflection is smooth and obeys EI u'''' = -k e g. Each such piece is mapped to [0, 1]; all of them together
are one large system of first order. Its boundary conditions are the supports of the needle and the
continuity of u to u''' from piece to piece.
"""

# ruff: noqa: N806  A, B, J: the symbols of the equations
import numpy as np
from equilibrium import equilibrium
from scipy.integrate import solve_bvp
from solver_checks import NEEDLE, interpolate, react

from needlefit.mechanics.control import Bevel, Controls, Guide, ModelOptions, Step
from needlefit.mechanics.simulate import simulate_steps
from needlefit.mechanics.tissue import Tissue

STEP = 1e-30  # of complex steps: nothing is subtracted, so that the derivative is exact to rounding
UNIT = 10.0  # mm: derivatives of order n are kept in mm per (10 mm)^n, to be alike in size
AT = np.linspace(0.0, 1.0, 9)


def collocate(tissue, constraints, controls):
    """Return depths x (K,) in the tissue and deflections (K,), mm, of the paper's needle in equilibrium.

    `constraints` (M + 1, 3) are depth, y and z of the constraint points, mm, the last under the tip.
    """
    depths, tip = constraints[:, 0], constraints[-1, 0]
    guides = [guide.x for guide in controls.guides]
    edges = np.concatenate(([tip - NEEDLE.length, 0.0, tip], guides, tissue.boundaries))
    edges = np.unique(np.concatenate((edges, 0.5 * (depths[1:] + depths[:-1]))))
    edges = edges[edges <= tip]
    middle, length = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
    inserted, count = middle > 0, len(middle)
    layer = np.searchsorted(tissue.boundaries, middle)[:, None]
    cut = constraints[np.abs(middle[:, None] - depths).argmin(axis=1), 1][:, None]
    at_start, at_end, values = _list_conditions(edges, controls)
    stretch = np.repeat(length / UNIT, 4)[:, None]  # (4 P, 1)
    factor = np.where(inserted, UNIT**4 / NEEDLE.flexural_rigidity, 0.0)[:, None]

    def find_parts(v):
        w = v.reshape(count, 4, -1)
        return np.where(inserted[:, None], w[:, 0] - cut, 0.0), w[:, 1] / UNIT

    def derive(x, v):
        fourth = -factor * react(tissue, layer, *find_parts(v))
        w = np.concatenate((v.reshape(count, 4, -1)[:, 1:], fourth[:, None]), axis=1)
        return stretch * w.reshape(v.shape)

    def linearize(x, v):
        J = np.zeros((4 * count, 4 * count, v.shape[1]))
        rows = 4 * np.arange(count)
        # v = (u, u', u'', u''') of each piece, four rows: the first three rows are v_n' = v_(n + 1)
        for n in range(3):
            J[rows + n, rows + n + 1] = stretch[rows]
        e, slope = find_parts(v)
        by_e = react(tissue, layer, e + 1j * STEP, slope).imag / STEP
        by_slope = react(tissue, layer, e, slope + 1j * STEP).imag / STEP
        J[rows + 3, rows] = -stretch[rows] * factor * by_e
        J[rows + 3, rows + 1] = -stretch[rows] * factor * by_slope / UNIT
        return J

    guess = np.zeros((count, 4, 4))
    guess[:, 0] = np.where(inserted[:, None], cut, 0.0)
    found = solve_bvp(
        derive,
        lambda a, b: at_start @ a + at_end @ b - values,
        np.linspace(0.0, 1.0, 4),
        guess.reshape(4 * count, -1),
        fun_jac=linearize,
        bc_jac=lambda a, b: (at_start, at_end),
        tol=1e-6,  # of scipy's residual; the deflection is then off by some 1e-8 mm
        bc_tol=1e-12,
        max_nodes=400,
    )
    assert found.success
    x = edges[:-1, None] + length[:, None] * AT  # (P, 9)
    u = found.sol(AT).reshape(count, 4, -1)[:, 0]
    return x[inserted].ravel(), u[inserted].ravel()


def _list_conditions(edges, controls):
    """Return A, B (4 P, 4 P) and d (4 P,) of the boundary conditions A v(0) + B v(1) = d."""
    size = 4 * (len(edges) - 1)
    rows = [
        (controls.base_y + controls.stage_slope * edges[-1], {0: 1.0}, {}),
        (controls.base_slope * UNIT, {1: 1.0}, {}),
    ]
    held = {guide.x: guide for guide in controls.guides}
    for i, edge in enumerate(edges[1:-1]):
        left, right = 4 * i, 4 * (i + 1)
        guide = held.get(float(edge))
        # a free guide exerts a force: u''' jumps; one that holds the slope exerts a moment too: u'' jumps
        continuous = 4 if guide is None else 3 if guide.slope is None else 2
        rows += [(0.0, {right + n: 1.0}, {left + n: -1.0}) for n in range(continuous)]
        if guide is not None:
            rows.append((guide.y, {right: 1.0}, {}))
            if guide.slope is not None:
                rows.append((guide.slope * UNIT, {right + 1: 1.0}, {}))
    # neither moment nor shear at the tip
    rows += [(0.0, {}, {size - 2: 1.0}), (0.0, {}, {size - 1: 1.0})]
    A, B = np.zeros((size, size)), np.zeros((size, size))
    for row, (_, at_start, at_end) in enumerate(rows):
        A[row, list(at_start)] = list(at_start.values())
        B[row, list(at_end)] = list(at_end.values())
    return A, B, np.array([value for value, *_ in rows])


def measure_difference(tissue, steps):
    """Return the differences of deflection, mm, after an insertion: on elements of 0.25 mm, and of 1 mm."""
    constraints, controls = simulate_steps(NEEDLE, tissue, steps).constraints, steps[-1].controls
    x, u = collocate(tissue, constraints, controls)
    fine, default = (
        equilibrium(NEEDLE, tissue, constraints, controls, rules)
        for rules in (ModelOptions(element=0.25, tolerance=1e-9), ModelOptions())
    )
    return tuple(float(np.max(np.abs(interpolate(shape, x) - u))) for shape in (fine, default))


COLLOCATED = {
    "four layers of the paper's values": (
        Tissue([0.2, 33.0, 0.2, 33.0], [1.0, -1.0, 1.0, -1.0], [12.2, 18.7, 29.4]),
        (Step(35.3, Bevel(0.085)),),
    ),
    "thin tissue, alpha = -10, base moved aside": (
        Tissue([0.2, 2.0], [-10.0, -10.0], [9.6], 5.0),
        (Step(25.0, Bevel(0.25), Controls(base_y=2.0)),),
    ),
    "thin tissue, alpha = 10, bevel turned over, free guide": (
        Tissue([0.3, 1.0], [10.0, 10.0], [11.5], 5.0),
        (
            Step(14.5, Bevel(0.3)),
            Step(30.0, Bevel(0.3, -1), Controls(base_y=1.0, guides=(Guide(-15.0, 0.5, None),))),
        ),
    ),
    "neo-Hookean, base moved aside": (
        Tissue([0.4, 4.0], [-7.0, 9.0], [10.4], 5.0, law="neo_hookean"),
        (Step(26.7, Bevel(0.2), Controls(base_y=2.0)),),
    ),
    "friction, base tilted after 15 mm": (
        Tissue([0.5, 5.0], [3.0, -4.0], [13.3], 10.0, 2.0),
        (Step(15.0, Bevel(0.2)), Step(28.4, Bevel(0.2), Controls(base_slope=0.1))),
    ),
}
