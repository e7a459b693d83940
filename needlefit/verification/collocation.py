"""One equilibrium solved as a boundary value problem, by scipy's collocation: no elements, no weak form.

Between the places where the nearest constraint point or the layer changes, and before the entry, the
deflection is smooth and obeys EI u'''' = -k e g. Each such piece is mapped to [0, 1]; all of them together
are one large system of first order whose boundary conditions are what holds the needle and the continuity
of u to u''' from piece to piece.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_bvp

from needlefit.mechanics.control import Controls
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.tissue import Tissue
from needlefit.verification.law import Law

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_UNIT = 10.0  # mm: derivatives of order n are kept in mm per (10 mm)^n, to be alike in size
_TOLERANCE = 1e-6  # of scipy's residual; the deflection is then off by some 1e-8 mm
_AT = np.linspace(0.0, 1.0, 9)


@dataclass(frozen=True)
class Pieces:
    """Where the needle is cut up: P pieces between P + 1 edges.

    Attributes
    ----------
    edges : (P + 1,) array
        From base to tip, mm.
    inserted : (P,) array
        Whether the piece lies in the tissue.
    layer : (P,) array
    cut : (P,) array
        y of the nearest constraint point, mm.
    """

    edges: Floats
    inserted: NDArray[np.bool_]
    layer: Ints
    cut: Floats


def collocate(
    needle: Needle, tissue: Tissue, constraints: Floats, controls: Controls
) -> tuple[Floats, Floats]:
    """Return depths x (K,) in the tissue and the deflections (K,) there, both mm.

    Parameters
    ----------
    constraints : (M + 1, 2) array
        Depth and y of the constraint points, mm, the last under the tip.

    Raises
    ------
    ArithmeticError
        If the collocation does not converge.
    """
    pieces = cut_up(needle, tissue, constraints, controls)
    count = len(pieces.cut)
    at_start, at_end, values = conditions(pieces, controls)
    length = np.diff(pieces.edges)
    stretch = np.repeat(length / _UNIT, 4)[:, None]  # (4 P, 1)
    law = Law.of(tissue)
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


def cut_up(needle: Needle, tissue: Tissue, constraints: Floats, controls: Controls) -> Pieces:
    """Return the pieces on which everything is smooth."""
    depths, y = constraints.T
    tip = depths[-1]
    halfway = 0.5 * (depths[1:] + depths[:-1])
    stations = [guide.x for guide in (*controls.before, *controls.within)]
    edges = np.unique(np.concatenate(([tip - needle.length, 0.0, tip], stations, halfway, tissue.boundaries)))
    edges = edges[edges <= tip]
    middle = 0.5 * (edges[1:] + edges[:-1])
    nearest = np.abs(middle[:, None] - depths).argmin(axis=1)
    return Pieces(edges, middle > 0, np.searchsorted(tissue.boundaries, middle), y[nearest])


def conditions(pieces: Pieces, controls: Controls) -> tuple[Floats, Floats, Floats]:
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
        demand(0.0 if slope is None else slope * _UNIT, {}, {end + (2 if slope is None else 1): 1.0})
    return A, B, d
