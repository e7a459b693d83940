"""Check the kernel's Newton method on a clamped needle: manufactured solutions, and the tangent.

Manufactured solutions. Theory gives cubic elements order 4 in the deflection and 3 in the slope. At the nodes
themselves the slope superconverges, with order 4. A deflection is chosen, and the cut is placed so that this
deflection is the exact solution.

The chosen u is clamped at the base, cubic before the entry, has u to u''' continuous everywhere and
u'' = u''' = 0 at the tip. Equilibrium asks for the reaction k e g = -EI u'''', which gives e at every place;
with the cut at c = u - e the chosen u is the exact solution of the continuous problem. The solver is given c
at each of its quadrature points, as if every one of them had a constraint point of its own.

Tangent. At a state u the solver steps by d = -K_T^-1 R(u). If K_T is the derivative of R, then
R'(u) d = -R(u), with R put together from the reference and its derivative by a complex step; and near the
solution each step squares the error.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import Polynomial
from scipy.interpolate import CubicHermiteSpline

from needlefit.arrays import Floats
from needlefit.mechanics import native, reference
from needlefit.mechanics.control import Bevel, Controls, ModelOptions
from needlefit.mechanics.laws import Numbers
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.simulate import STATUS_NAMES, equilibrium, pack_equilibrium, simulate
from needlefit.mechanics.tissue import Tissue
from needlefit.verification.cases import (
    PAPER_NEEDLE,
    STEP,
    ReferenceLaw,
    make_tissue,
    require_converged,
    sample_between,
)
from needlefit.verification.check import (
    Check,
    CheckOutcome,
    ConvergenceCurve,
    Group,
    Quantity,
    at_most,
    define_check,
    within,
    worst,
)


@dataclass(frozen=True)
class ClampedNeedle:
    """A needle clamped at its base, y = u' = 0, and otherwise free."""

    needle: Needle
    tissue: Tissue
    rules: ModelOptions
    x: Floats  #: (N,) nodes from base to tip, mm: those that the model itself would take
    points: Floats  #: (Q,) quadrature points, mm
    #: depths, y: (M + 1,) constraint points, mm
    depths: Floats
    y: Floats
    target: Floats | None = (
        None  #: (Q,) y of the cut at each quadrature point, in place of the constraint points'
    )

    @classmethod
    def of(cls, needle: Needle, tissue: Tissue, constraints: Floats, rules: ModelOptions) -> "ClampedNeedle":
        """Return the clamped needle with these constraint points (M + 1, 2)."""
        x = equilibrium(needle, tissue, constraints, rules=rules).x
        depths, y = np.ascontiguousarray(constraints.T)
        problem = pack_equilibrium(needle, tissue, depths, Controls(), rules)
        points, *_ = native.list_quadrature(problem, x[1:].copy(), depths)
        return cls(needle, tissue, rules, x, points, depths, y)

    def solve(self, guess: Floats, tolerance: float = 1e-12, max_iterations: int = 60) -> Floats:
        """Return the state (N, 2) that Newton's method reaches from a guess; ArithmeticError if none.

        With an infinite tolerance and one iteration it is that after one step.
        """
        problem = pack_equilibrium(self.needle, self.tissue, self.depths, Controls(), self.rules)
        problem.tolerance, problem.max_iterations = tolerance, max_iterations
        _, state, status, _ = native.find_equilibrium(
            problem, self.depths, self.y, np.ascontiguousarray(guess), self.target
        )
        if status != native.CONVERGED:
            raise ArithmeticError(f"the solver failed: {STATUS_NAMES[status]}")
        return state


EI = 1.0e4  # N mm^2
FREE_LENGTH_MM, DEPTH_MM = 20.0, 40.0  # mm before and in the tissue
MESH_SIZES_MM = (4.0, 2.0, 1.0, 0.5)  # below, rounding takes over: 1e-9 mm
NORMS = ("deflection", "slope")
NODAL_NORMS = ("deflection at the nodes", "slope at the nodes")
_CURVATURE = 6e-4  # 1 / mm: deflections of about 1 mm


@dataclass(frozen=True)
class ManufacturedDeflection:
    """A chosen deflection, made of polynomials."""

    before: Polynomial  #: the cubic before the entry
    inside: Polynomial  #: after it
    kinks: tuple[tuple[float, Polynomial], ...]  #: what is added beyond an interface, where u'''' jumps

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
    clamped = ClampedNeedle.of(Needle(FREE_LENGTH_MM + DEPTH_MM, EI), tissue, straight, ModelOptions(h, h))
    x = clamped.points
    layer = np.searchsorted(tissue.boundaries, x)
    e = ReferenceLaw.of(tissue).deflection_of(layer, -EI * chosen.at(x, 4), chosen.at(x, 1))
    # every quadrature point gets a constraint point of its own, which makes the chosen deflection exact
    clamped = replace(clamped, target=chosen.at(x) - e)
    guess = 0.9 * np.column_stack((chosen.at(clamped.x), chosen.at(clamped.x, 1)))  # not the answer itself
    state = clamped.solve(guess)
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


_ORDERS = tuple(
    Quantity(f"order of the {norm}", within(order, 0.15), "")
    for norm, order in zip(NORMS, (4.0, 3.0), strict=True)
)
_PLACE = 17.37  # mm: an interface that no mesh has a node at
_THIN = ([0.5, 3.0], [8.0, -6.0], [_PLACE], [2.0, 1.0])  # alpha plays no part in the neo-Hookean law
_ROUGH = make_tissue(*_THIN, friction=[50.0, 50.0])  # so strong that the small slopes show it

_PAIR = ([0.5, 5.0], [1.0, 1.0])
#: tissue, and the first cell in elements
CASES: dict[str, tuple[Tissue, float]] = {
    "One layer, linear law": (make_tissue([1.0], [1.0], law="linear"), 1.0),
    "Two layers, interface on an element boundary, linear law": (
        make_tissue(*_PAIR, [16.0], law="linear"),
        1.0,
    ),
    "Two layers, interface inside elements, linear law": (make_tissue(*_PAIR, [_PLACE], law="linear"), 1.0),
    "Two layers, interface inside elements, neo-Hookean law in thin tissue": (
        make_tissue(*_THIN, law="neo_hookean"),
        1.0,
    ),
    "Two layers, interface inside elements, Ogden law in thin tissue": (make_tissue(*_THIN), 1.0),
    "The same with friction": (_ROUGH, 1.0),
    "The same with a first cell too short for a node at the entry": (_ROUGH, 0.4),
}


def _check_orders(title: str, tissue: Tissue, first_cell: float) -> Check:
    def measure(rng: np.random.Generator) -> CheckOutcome:
        curve = measure_errors(title, tissue, first_cell)
        return CheckOutcome(tuple(curve.order(norm) for norm in NORMS), curves=(curve,))

    return Check(Group.MANUFACTURED, title, _ORDERS, measure)


@define_check(
    Group.MANUFACTURED,
    "All of these at the nodes alone, where the slope superconverges",
    *(Quantity(f"lowest order of the {norm}", within(4.0, 0.2), "") for norm in NODAL_NORMS),
)
def at_nodes(rng: np.random.Generator) -> CheckOutcome:
    curves = [measure_errors(title, *case) for title, case in CASES.items()]
    return CheckOutcome(tuple(float(np.min([curve.order(norm) for curve in curves])) for norm in NODAL_NORMS))


_STARTS = (0.2, 0.1, 0.05, 0.025)  # share of the disturbance, whose largest deflection is 1 mm


def residual(clamped: ClampedNeedle, tissue: Tissue, constraints: Floats) -> Callable[[Numbers], Numbers]:
    """Return R(u) of the reference's equations without the clamped base's, (2 N,); u may be complex."""
    x_c, y_c = constraints.T
    K_b = reference.bending_stiffness(clamped.x, PAPER_NEEDLE.flexural_rigidity)
    change = reference.change_depths(x_c, ModelOptions())
    x, w = reference.quadrature(clamped.x, change, tissue.boundaries)
    N, dN = reference.shape_functions(clamped.x, x)
    layer = np.searchsorted(tissue.boundaries, x)
    nearest = np.searchsorted(change, x)
    t, gamma = tissue.thickness[layer], tissue.friction[layer]

    def R(u: Numbers) -> Numbers:
        e = N @ u - y_c[nearest]
        k, _ = reference.modulus(tissue, layer, 1 - np.sign(e.real) * e / t)
        g = 1 - gamma * np.sin(np.arctan(dN @ u)) ** 2
        # the first two equations are those of the clamped base
        forces: Numbers = (K_b @ u + N.T @ (w * k * e * g))[2:]
        return forces

    return R


def measure_tangent(friction: float) -> tuple[float, float]:
    """Return the relative defect of one Newton step, and the order of convergence of Newton's method."""
    tissue = make_tissue(
        mu=[0.5, 3.0], alpha=[6.0, -5.0], boundaries=[13.37], thickness=[5.0, 5.0], friction=[friction] * 2
    )
    constraints = require_converged(simulate(PAPER_NEEDLE, tissue, Bevel(0.2), 25.0)).constraints
    clamped = ClampedNeedle.of(PAPER_NEEDLE, tissue, constraints, ModelOptions())
    s = (clamped.x - clamped.x[0]) / PAPER_NEEDLE.length
    sway = np.column_stack((s**2 * np.cos(9 * s), (2 * s * np.cos(9 * s) - 9 * s**2 * np.sin(9 * s)) / 150))
    found = clamped.solve(np.zeros_like(sway))
    start = found + _STARTS[0] * sway
    step = clamped.solve(start, np.inf, 1) - start
    R = residual(clamped, tissue, constraints)
    force = R(start.ravel())
    # complex step: a derivative without subtraction, so a tiny step loses no digit
    along = R(start.ravel() + STEP * 1j * step.ravel()).imag / STEP
    defect = np.linalg.norm(along + force) / np.linalg.norm(force)
    errors = [worst(np.abs(clamped.solve(found + a * sway, np.inf, 1)[:, 0] - found[:, 0])) for a in _STARTS]
    return float(defect), float(np.polyfit(np.log(_STARTS), np.log(errors), 1)[0])


def _check_tangent(title: str, friction: float) -> Check:
    quantities = (
        Quantity("defect of R′(u) d = −R(u) over |R|", at_most(1e-8), ""),
        Quantity("order of Newton’s convergence", within(2.0, 0.15), ""),
    )
    return Check(Group.TANGENT, title, quantities, lambda rng: CheckOutcome(measure_tangent(friction)))


CHECKS = (
    *(_check_orders(title, *case) for title, case in CASES.items()),
    at_nodes,
    _check_tangent("Ogden law in thin tissue (t = 5 mm), symmetric tangent", 0.0),
    _check_tangent("The same with friction, tangent not symmetric", 2.0),
)
