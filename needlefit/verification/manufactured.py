"""Equilibria made to measure: a deflection is chosen, and the tissue placed so that it is the solution.

The chosen u is clamped at the base, cubic before the entry, has u to u''' continuous everywhere and
u'' = u''' = 0 at the tip. Equilibrium asks for the reaction k e g = -EI u'''', which gives e at every place;
with the cut at c = u - e the chosen u is the exact solution of the continuous problem. The solver is given c
at each of its quadrature points, as if every one of them had a constraint point of its own.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from needlefit.mechanics.control import ModelOptions
from needlefit.mechanics.kernel.scalar import NewtonOptions
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.tissue import Tissue
from needlefit.verification.check import Curve, worst
from needlefit.verification.law import Law
from needlefit.verification.samples import between
from needlefit.verification.stop import settle, stop_at

Floats = NDArray[np.float64]

EI = 1.0e4  # N mm^2
FREE, DEPTH = 20.0, 40.0  # mm before and in the tissue
SIZES = (4.0, 2.0, 1.0, 0.5)  # below, rounding takes over: 1e-9 mm
NORMS = ("deflection", "slope")
NODAL = ("deflection at the nodes", "slope at the nodes")
_CURVATURE = 6e-4  # 1 / mm: deflections of about 1 mm


@dataclass(frozen=True)
class Chosen:
    """A deflection made of polynomials.

    Attributes
    ----------
    before : Polynomial
        The cubic before the entry.
    inside : Polynomial
        After it.
    kinks : tuple of (float, Polynomial)
        What is added beyond an interface, where u'''' jumps.
    """

    before: Polynomial
    inside: Polynomial
    kinks: tuple[tuple[float, Polynomial], ...]

    def at(self, x: Floats, order: int = 0) -> Floats:
        """Return the derivative of this order."""
        value = np.where(x < 0, self.before.deriv(order)(x), self.inside.deriv(order)(x))
        for edge, more in self.kinks:
            value = value + np.where(x > edge, more.deriv(order)(x), 0.0)
        return value


def choose(boundaries: Floats) -> Chosen:
    """Return a deflection whose fourth derivative jumps at the entry and at every boundary."""
    xi = Polynomial([0.0, 1.0 / DEPTH])
    ending = (1 - xi) ** 2  # neither moment nor shear at the tip
    w = 2 * xi - 1
    curvature = _CURVATURE * ending * (0.5 + 4 * w**3 - 3 * w)
    moment, shear = curvature(0.0), curvature.deriv()(0.0)
    before = Polynomial([moment, shear]).integ(2, k=[0.0, 0.0])
    # neither deflection nor slope at the base
    before = before - Polynomial([before(-FREE) + FREE * before.deriv()(-FREE), before.deriv()(-FREE)])
    inside = curvature.integ(2, k=[before.deriv()(0.0), before(0.0)])
    kinks = tuple(
        (edge, (0.1 * _CURVATURE * (Polynomial([-edge, 1.0])) ** 2 * ending).integ(2, lbnd=edge))
        for edge in map(float, boundaries)
    )
    return Chosen(before, inside, kinks)


def solve(tissue: Tissue, chosen: Chosen, h: float, first_cell: float) -> tuple[Floats, CubicHermiteSpline]:
    """Return nodes, mm, and what the compiled solver makes of the problem on elements of h (mm)."""
    depths = np.array([0.0, *np.arange(first_cell, DEPTH - 1e-9, h), DEPTH])
    straight = np.column_stack((depths, np.zeros(len(depths))))
    stop = stop_at(Needle(FREE + DEPTH, EI), tissue, straight, ModelOptions(h, h))
    x = stop.grid.x  # of the quadrature points
    layer = np.searchsorted(tissue.boundaries, x)
    e = Law.of(tissue).deflection_of(layer, -EI * chosen.at(x, 4), chosen.at(x, 1))
    grid = stop.grid._replace(constraint=np.arange(len(x)))
    stop = replace(stop, grid=grid, y=chosen.at(x) - e)
    guess = 0.9 * np.column_stack((chosen.at(stop.x), chosen.at(stop.x, 1)))  # not the answer itself
    state = settle(stop, guess, NewtonOptions(1e-12, 60))
    return stop.x, CubicHermiteSpline(stop.x, *state.T)


def refine(case: str, tissue: Tissue, first_cell: float = 1.0) -> Curve:
    """Return the errors in the tissue over SIZES; `first_cell` in elements."""
    chosen = choose(tissue.boundaries)
    errors: dict[str, list[float]] = {norm: [] for norm in (*NORMS, *NODAL)}
    for h in SIZES:
        nodes, found = solve(tissue, chosen, h, first_cell * h)
        inserted = nodes[nodes >= 0.0]
        inside = between(np.union1d(inserted, [0.0]))
        for norm, x, order in zip(errors, (inside, inside, inserted, inserted), (0, 1, 0, 1), strict=True):
            errors[norm].append(worst(np.abs(found(x, order) - chosen.at(x, order))))
    return Curve(case, SIZES, {norm: tuple(values) for norm, values in errors.items()})
