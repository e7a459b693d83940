"""The Jacobian of the whole shape, against the derivatives of the readable reference, stepped and solved."""

import numpy as np

from needlefit.mechanics.control import Rules
from needlefit.mechanics.linearize import linearize_along
from needlefit.verification.cases import Case, Draw, random_case, random_schedule, solvable
from needlefit.verification.check import Check, Group, Outcome, Quantity, at_most
from needlefit.verification.complex_step import KINDS, derivatives, parameters

RANDOM = 5
COARSE = Rules(2.0, 2.0, tolerance=1e-11)
"""Rounding grows as elements shrink, and what is checked here does not depend on them."""
_SOFTEST = 0.05  # MPa; in softer tissue the rounding of the dense solves exceeds the bound


def errors(case: Case) -> dict[str, float]:
    """Return the largest error of each column over its largest entry: deflections, slopes and the cut."""
    _, jacobian = linearize_along(case.needle, case.tissue, case.steps, COARSE, wrt=KINDS)
    named = parameters(case)
    du, dc = derivatives(case, [named[name] for name in jacobian.names], COARSE)
    worst = np.zeros(len(jacobian.names))
    for ours, other in ((jacobian.u, du[0::2]), (jacobian.slope, du[1::2]), (jacobian.constraints, dc)):
        largest = np.abs(other).max(axis=0)
        share = np.abs(ours - other).max(axis=0) / np.where(largest > 0, largest, 1.0)
        worst = np.maximum(worst, share)
    return dict(zip(jacobian.names, worst, strict=True))


def _check(title: str, draw: Draw) -> Check:
    quantities = (
        Quantity("error of the columns, but for α", at_most(1e-7), ""),
        Quantity("error of the columns of α", at_most(1e-5), ""),
    )

    def measure(rng: np.random.Generator) -> Outcome:
        found, said = solvable(lambda: draw(rng, 25.0, _SOFTEST), errors, RANDOM)
        alpha = [error for each in found for name, error in each.items() if name.startswith("alpha")]
        others = [error for each in found for name, error in each.items() if not name.startswith("alpha")]
        columns = f"{len(alpha) + len(others)} columns"
        return Outcome((max(others), max(alpha)), "; ".join(filter(None, (columns, said))))

    return Check(Group.SENSITIVITIES, f"{RANDOM} random {title}", quantities, measure)


CHECKS = (
    _check("insertions under constant inputs", random_case),
    _check("schedules: guides, tracked tip, retraction, friction", random_schedule),
)
