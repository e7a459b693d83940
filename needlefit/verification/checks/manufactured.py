"""Check the order of convergence with manufactured solutions: in the tissue, at the nodes and between them.

Theory gives cubic elements order 4 in the deflection and 3 in the slope. At the nodes themselves the slope
superconverges, with order 4.

A deflection is chosen, and the cut is placed so that this deflection is the exact solution.

The chosen u is clamped at the base, cubic before the entry, has u to u''' continuous everywhere and
u'' = u''' = 0 at the tip. Equilibrium asks for the reaction k e g = -EI u'''', which gives e at every place;
with the cut at c = u - e the chosen u is the exact solution of the continuous problem. The solver is given c
at each of its quadrature points, as if every one of them had a constraint point of its own.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import Polynomial
from scipy.interpolate import CubicHermiteSpline

from needlefit.arrays import Floats
from needlefit.mechanics.control import ModelOptions
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.tissue import Tissue
from needlefit.verification.cases import (
    ReferenceLaw,
    make_clamped_needle,
    make_tissue,
    sample_between,
    solve_newton,
)
from needlefit.verification.check import (
    Check,
    CheckOutcome,
    ConvergenceCurve,
    Group,
    Quantity,
    define_check,
    within,
    worst,
)

EI = 1.0e4  # N mm^2
FREE_LENGTH_MM, DEPTH_MM = 20.0, 40.0  # mm before and in the tissue
MESH_SIZES_MM = (4.0, 2.0, 1.0, 0.5)  # below, rounding takes over: 1e-9 mm
NORMS = ("deflection", "slope")
NODAL_NORMS = ("deflection at the nodes", "slope at the nodes")
_CURVATURE = 6e-4  # 1 / mm: deflections of about 1 mm


@dataclass(frozen=True)
class ManufacturedDeflection:
    """A chosen deflection, made of polynomials.

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
        """Return the derivative of the given order at x, mm."""
        value = np.where(x < 0, self.before.deriv(order)(x), self.inside.deriv(order)(x))
        for edge, more in self.kinks:
            value = value + np.where(x > edge, more.deriv(order)(x), 0.0)
        return value


def make_deflection(boundaries: Floats) -> ManufacturedDeflection:
    """Return a deflection whose fourth derivative jumps at the entry and at every boundary."""
    xi = Polynomial([0.0, 1.0 / DEPTH_MM])
    ending = (1 - xi) ** 2  # neither moment nor shear at the tip
    w = 2 * xi - 1
    curvature = _CURVATURE * ending * (0.5 + 4 * w**3 - 3 * w)
    moment, shear = curvature(0.0), curvature.deriv()(0.0)
    before = Polynomial([moment, shear]).integ(2, k=[0.0, 0.0])
    # neither deflection nor slope at the base
    before = before - Polynomial(
        [
            before(-FREE_LENGTH_MM) + FREE_LENGTH_MM * before.deriv()(-FREE_LENGTH_MM),
            before.deriv()(-FREE_LENGTH_MM),
        ]
    )
    inside = curvature.integ(2, k=[before.deriv()(0.0), before(0.0)])
    kinks = tuple(
        (edge, (0.1 * _CURVATURE * (Polynomial([-edge, 1.0])) ** 2 * ending).integ(2, lbnd=edge))
        for edge in map(float, boundaries)
    )
    return ManufacturedDeflection(before, inside, kinks)


def solve_manufactured(
    tissue: Tissue, chosen: ManufacturedDeflection, h: float, first_cell: float
) -> tuple[Floats, CubicHermiteSpline]:
    """Return the nodes, mm, and the kernel's solution on elements of h (mm)."""
    depths = np.array([0.0, *np.arange(first_cell, DEPTH_MM - 1e-9, h), DEPTH_MM])
    straight = np.column_stack((depths, np.zeros(len(depths))))
    clamped = make_clamped_needle(Needle(FREE_LENGTH_MM + DEPTH_MM, EI), tissue, straight, ModelOptions(h, h))
    x = clamped.points
    layer = np.searchsorted(tissue.boundaries, x)
    e = ReferenceLaw.of(tissue).deflection_of(layer, -EI * chosen.at(x, 4), chosen.at(x, 1))
    # every quadrature point gets a constraint point of its own, which makes the chosen deflection exact
    clamped = replace(clamped, target=chosen.at(x) - e)
    guess = 0.9 * np.column_stack((chosen.at(clamped.x), chosen.at(clamped.x, 1)))  # not the answer itself
    state = solve_newton(clamped, guess)
    return clamped.x, CubicHermiteSpline(clamped.x, *state.T)


def measure_errors(case: str, tissue: Tissue, first_cell: float = 1.0) -> ConvergenceCurve:
    """Return the errors in the tissue over `MESH_SIZES_MM`; `first_cell` is in elements."""
    chosen = make_deflection(tissue.boundaries)
    errors: dict[str, list[float]] = {norm: [] for norm in (*NORMS, *NODAL_NORMS)}
    for h in MESH_SIZES_MM:
        nodes, found = solve_manufactured(tissue, chosen, h, first_cell * h)
        inserted = nodes[nodes >= 0.0]
        inside = sample_between(np.union1d(inserted, [0.0]))
        for norm, x, order in zip(errors, (inside, inside, inserted, inserted), (0, 1, 0, 1), strict=True):
            errors[norm].append(worst(np.abs(found(x, order) - chosen.at(x, order))))
    return ConvergenceCurve(case, MESH_SIZES_MM, {norm: tuple(values) for norm, values in errors.items()})


_QUANTITIES = tuple(
    Quantity(f"order of the {norm}", within(order, 0.15), "")
    for norm, order in zip(NORMS, (4.0, 3.0), strict=True)
)
_PLACE = 17.37  # mm: an interface that no mesh has a node at
_THIN = ([0.5, 3.0], [8.0, -6.0], [_PLACE], [2.0, 1.0])  # alpha plays no part in the neo-Hookean law
_ROUGH = make_tissue(*_THIN, friction=[50.0, 50.0])  # so strong that the small slopes show it

CASES: dict[str, tuple[Tissue, float]] = {
    "One layer, linear law": (make_tissue([1.0], [1.0], law="linear"), 1.0),
    "Two layers, interface on an element boundary, linear law": (
        make_tissue([0.5, 5.0], [1.0, 1.0], [16.0], law="linear"),
        1.0,
    ),
    "Two layers, interface inside elements, linear law": (
        make_tissue([0.5, 5.0], [1.0, 1.0], [_PLACE], law="linear"),
        1.0,
    ),
    "Two layers, interface inside elements, neo-Hookean law in thin tissue": (
        make_tissue(*_THIN, law="neo_hookean"),
        1.0,
    ),
    "Two layers, interface inside elements, Ogden law in thin tissue": (make_tissue(*_THIN), 1.0),
    "The same with friction": (_ROUGH, 1.0),
    "The same with a first cell too short for a node at the entry": (_ROUGH, 0.4),
}
"""Tissue, and the first cell in elements."""


def _check(title: str, tissue: Tissue, first_cell: float) -> Check:
    def measure(rng: np.random.Generator) -> CheckOutcome:
        curve = measure_errors(title, tissue, first_cell)
        return CheckOutcome(tuple(curve.order(norm) for norm in NORMS), curves=(curve,))

    return Check(Group.MANUFACTURED, title, _QUANTITIES, measure)


@define_check(
    Group.MANUFACTURED,
    "All of these at the nodes alone, where the slope superconverges",
    *(Quantity(f"lowest order of the {norm}", within(4.0, 0.2), "") for norm in NODAL_NORMS),
)
def at_nodes(rng: np.random.Generator) -> CheckOutcome:
    curves = [measure_errors(title, *case) for title, case in CASES.items()]
    return CheckOutcome(tuple(float(np.min([curve.order(norm) for curve in curves])) for norm in NODAL_NORMS))


CHECKS = (*(_check(title, *case) for title, case in CASES.items()), at_nodes)
