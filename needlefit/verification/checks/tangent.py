"""Check Newton's tangent of the kernel, against the residual of the readable reference.

At a state u the solver steps by d = -K_T^-1 R(u). If K_T is the derivative of R, then R'(u) d = -R(u), with
R put together from the reference and its derivative by a complex step; and near the solution each step
squares the error.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats
from needlefit.mechanics import reference
from needlefit.mechanics.control import Bevel, ModelOptions
from needlefit.mechanics.simulate import simulate
from needlefit.mechanics.tissue import Tissue
from needlefit.verification.cases import (
    PAPER_NEEDLE,
    ClampedNeedle,
    make_clamped_needle,
    make_tissue,
    require_converged,
    solve_newton,
)
from needlefit.verification.check import Check, CheckOutcome, Group, Quantity, at_most, within, worst

Numbers = NDArray[Any]  # real or complex

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


def measure(friction: float) -> tuple[float, float]:
    """Return the relative defect of one Newton step, and the order of convergence of Newton's method."""
    tissue = make_tissue(
        mu=[0.5, 3.0], alpha=[6.0, -5.0], boundaries=[13.37], thickness=[5.0, 5.0], friction=[friction] * 2
    )
    constraints = require_converged(simulate(PAPER_NEEDLE, tissue, Bevel(0.2), 25.0)).constraints
    clamped = make_clamped_needle(PAPER_NEEDLE, tissue, constraints, ModelOptions())
    s = (clamped.x - clamped.x[0]) / PAPER_NEEDLE.length
    sway = np.column_stack((s**2 * np.cos(9 * s), (2 * s * np.cos(9 * s) - 9 * s**2 * np.sin(9 * s)) / 150))
    found = solve_newton(clamped, np.zeros_like(sway))
    start = found + _STARTS[0] * sway
    step = solve_newton(clamped, start, np.inf, 1) - start
    R = residual(clamped, tissue, constraints)
    force = R(start.ravel())
    # complex step: a derivative without subtraction, so 1e-30 loses no digit
    along = R(start.ravel() + 1e-30j * step.ravel()).imag / 1e-30
    defect = np.linalg.norm(along + force) / np.linalg.norm(force)
    errors = [
        worst(np.abs(solve_newton(clamped, found + a * sway, np.inf, 1)[:, 0] - found[:, 0])) for a in _STARTS
    ]
    return float(defect), float(np.polyfit(np.log(_STARTS), np.log(errors), 1)[0])


_QUANTITIES = (
    Quantity("defect of R′(u) d = −R(u) over |R|", at_most(1e-8), ""),
    Quantity("order of Newton’s convergence", within(2.0, 0.15), ""),
)


def _check(title: str, friction: float) -> Check:
    return Check(Group.TANGENT, title, _QUANTITIES, lambda rng: CheckOutcome(measure(friction)))


CHECKS = (
    _check("Ogden law in thin tissue (t = 5 mm), symmetric tangent", 0.0),
    _check("The same with friction, tangent not symmetric", 2.0),
)
