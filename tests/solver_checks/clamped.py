"""The kernel's Newton method on a clamped needle: manufactured solutions.

Manufactured solutions. A deflection is chosen: clamped at the base, cubic before the entry, with u to u'''
continuous everywhere, u'' = u''' = 0 at the tip, and a jump of u'''' at the entry and at every boundary.
Equilibrium asks for the reaction k e g = -EI u'''', which gives e at every place; with the cut at u - e the
chosen u is the exact solution. The kernel is given that cut at each quadrature point. Theory gives cubic
elements order 4 in the deflection and 3 in the slope; at the nodes the slope superconverges, with order 4.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from equilibrium import equilibrium, find_equilibrium
from numpy.polynomial import Polynomial
from scipy.interpolate import CubicHermiteSpline

from needlefit.arrays import Floats
from needlefit.mechanics import native
from needlefit.mechanics.control import Controls, ModelOptions
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.simulate import pack_equilibrium
from needlefit.mechanics.tissue import Tissue
from solver_checks import react, sample_between


@dataclass(frozen=True)
class ClampedNeedle:
    """A needle clamped at its base, y = u' = 0, and otherwise free."""

    needle: Needle
    tissue: Tissue
    rules: ModelOptions
    constraints: Floats  #: (M + 1, 3) depth, y and z = 0 of the constraint points, mm

    @cached_property
    def nodes(self):
        """(N,) from base to tip, mm."""
        return equilibrium(self.needle, self.tissue, self.constraints, rules=self.rules).x

    def list_points(self):
        """Return the quadrature points (Q,), mm."""
        depths = self.constraints[:, 0].copy()
        problem = pack_equilibrium(self.needle, self.tissue, depths, Controls(), self.rules)
        return native.list_quadrature(problem, self.nodes[1:].copy(), depths)[0]

    def solve(self, guess, target):
        """Return the state (N, 2) that Newton's method reaches from a guess.

        `target` (Q,) is the y of the cut at each quadrature point, in place of the constraint points'.
        """
        depths, y, _ = np.ascontiguousarray(self.constraints.T)
        problem = pack_equilibrium(self.needle, self.tissue, depths, Controls(), self.rules)
        problem.tolerance, problem.max_iterations = 1e-12, 60
        guess = np.ascontiguousarray(guess)
        _, state, status, _ = find_equilibrium(problem, depths, y[:, None], guess, target[:, None])
        assert status == native.CONVERGED
        return state


# ---- manufactured solutions

EI = 1.0e4  # N mm^2
FREE_MM, DEPTH_MM = 20.0, 40.0  # before and in the tissue
MESH_SIZES_MM = (4.0, 2.0, 1.0, 0.5)  # below, rounding takes over: 1e-9 mm
CURVATURE = 6e-4  # 1/mm: deflections of about 1 mm
BOUNDARY_MM = 17.37  # no mesh has a node there


def choose_deflection(x, order, boundaries):
    """Return the derivative of the given order of the chosen deflection at x, mm."""
    xi = Polynomial([0.0, 1.0 / DEPTH_MM])
    ending = (1 - xi) ** 2  # neither moment nor shear at the tip
    w = 2 * xi - 1
    curvature = CURVATURE * ending * (0.5 + 4 * w**3 - 3 * w)
    before = Polynomial([curvature(0.0), curvature.deriv()(0.0)]).integ(2)
    at_base, slope = before(-FREE_MM), before.deriv()(-FREE_MM)
    before = before - Polynomial([at_base + FREE_MM * slope, slope])
    inside = curvature.integ(2, k=[before.deriv()(0.0), before(0.0)])
    u = np.where(x < 0, before.deriv(order)(x), inside.deriv(order)(x))
    for edge in map(float, boundaries):
        kink = (0.1 * CURVATURE * Polynomial([-edge, 1.0]) ** 2 * ending).integ(2, lbnd=edge)
        u = u + np.where(x > edge, kink.deriv(order)(x), 0.0)
    return u


def find_compression(tissue, layer, force, slope):
    """Return the deflection e (mm) at which the reaction is `force` (N/mm), by bisection."""
    low = np.zeros_like(force)
    high = tissue.thickness[layer] * (1 - 1e-12)  # at the full thickness the Ogden law is infinite
    for _ in range(100):
        middle = 0.5 * (low + high)
        weak = react(tissue, layer, middle, slope) < np.abs(force)
        low, high = np.where(weak, middle, low), np.where(weak, high, middle)
    return np.copysign(0.5 * (low + high), force)


def measure_orders(tissue, first_cell=1.0):
    """Return the observed orders of deflection and slope, between nodes and at the nodes.

    `first_cell` is in elements. Orders are over the three smallest meshes: on coarser ones terms of higher
    order still show.
    """
    errors = []
    for h in MESH_SIZES_MM:
        depths = np.array([0.0, *np.arange(first_cell * h, DEPTH_MM - 1e-9, h), DEPTH_MM])
        straight = np.outer(depths, [1.0, 0.0, 0.0])
        clamped = ClampedNeedle(Needle(FREE_MM + DEPTH_MM, EI), tissue, ModelOptions(h, h), straight)
        x, nodes = clamped.list_points(), clamped.nodes
        u, slope, fourth = (choose_deflection(x, order, tissue.boundaries) for order in (0, 1, 4))
        e = find_compression(tissue, np.searchsorted(tissue.boundaries, x), -EI * fourth, slope)
        exact = np.column_stack([choose_deflection(nodes, order, tissue.boundaries) for order in (0, 1)])
        found = CubicHermiteSpline(nodes, *clamped.solve(0.9 * exact, u - e).T)  # not the answer itself
        inserted = nodes[nodes >= 0.0]
        inside = sample_between(np.union1d(inserted, [0.0]))
        errors.append([
            np.max(np.abs(found(at, order) - choose_deflection(at, order, tissue.boundaries)))
            for at in (inside, inserted) for order in (0, 1)
        ])  # fmt: skip
    return tuple(np.polyfit(np.log(MESH_SIZES_MM[-3:]), np.log(errors[-3:]), 1)[0])


_PAIR, _THIN = ([0.5, 5.0], [1.0, 1.0]), ([0.5, 3.0], [8.0, -6.0], [BOUNDARY_MM])
_ROUGH = Tissue(*_THIN, thickness=2.0, friction=50.0)  # so strong that the small slopes show it
#: tissue, and the first cell in elements
MANUFACTURED = {
    "one layer, linear": (Tissue([1.0], [1.0], law="linear"), 1.0),
    "interface on a node, linear": (Tissue(*_PAIR, [16.0], law="linear"), 1.0),
    "interface inside elements, linear": (Tissue(*_PAIR, [BOUNDARY_MM], law="linear"), 1.0),
    "neo-Hookean, thin": (Tissue([0.5, 3.0], [1.0, 1.0], [BOUNDARY_MM], 2.0, law="neo_hookean"), 1.0),
    "Ogden, thin": (Tissue(*_THIN, thickness=2.0), 1.0),
    "friction": (_ROUGH, 1.0),
    "friction, first cell too short for a node at the entry": (_ROUGH, 0.4),
}
