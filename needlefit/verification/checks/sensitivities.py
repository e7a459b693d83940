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
SMALLEST = 1e-3
"""mm per unit (per logarithm of mu and EI): a column below is measured against this, for the state itself is
known to no better than 1e-10 mm. Of slopes: a hundredth, per mm."""
_SOFTEST = 0.2  # MPa, the softest of the paper; in softer tissue rounding alone exceeds the bound

_QUANTITIES = (
    Quantity("error of the columns, but for places and α", at_most(1e-7), ""),
    Quantity("places: boundaries, guides along the needle", at_most(1e-6), ""),
    Quantity("α", at_most(1e-5), ""),
)


def errors(case: Case) -> dict[str, float]:
    """Return the largest error of each column over its largest entry: deflections and cut, and slopes."""
    _, jacobian = linearize_along(case.needle, case.tissue, case.steps, COARSE, wrt=KINDS)
    named = parameters(case)
    du, dc = derivatives(case, [named[name] for name in jacobian.names], COARSE)
    unit = np.array([_unit(case, name) for name in jacobian.names])
    lengths = np.vstack((jacobian.u, jacobian.constraints)), np.vstack((du[0::2], dc)), SMALLEST
    slopes = jacobian.slope, du[1::2], 0.01 * SMALLEST
    shares = [
        np.abs(ours - other).max(axis=0) * unit / np.maximum(np.abs(other).max(axis=0) * unit, smallest)
        for ours, other, smallest in (lengths, slopes)
    ]
    return dict(zip(jacobian.names, np.maximum(*shares), strict=True))


def _unit(case: Case, name: str) -> float:
    """Return mu or EI for their columns, which become those of the logarithm, and 1 for the others."""
    if name == "rigidity":
        return case.needle.flexural_rigidity
    return float(case.tissue.mu[int(name[2:]) - 1]) if name.startswith("mu") else 1.0


def _kind(name: str) -> int:
    """Return which quantity a column counts for."""
    if name.startswith("alpha"):
        return 2
    return 1 if name.startswith("boundary") or name.endswith("_x") else 0


def _check(title: str, draw: Draw) -> Check:
    def measure(rng: np.random.Generator) -> Outcome:
        found, said = solvable(lambda: draw(rng, 25.0, _SOFTEST), errors, RANDOM)
        columns = [(_kind(name), error) for each in found for name, error in each.items()]
        worst = (max((e for kind, e in columns if kind == wanted), default=0.0) for wanted in range(3))
        return Outcome(tuple(worst), "; ".join(filter(None, (f"{len(columns)} columns", said))))

    return Check(Group.SENSITIVITIES, f"{RANDOM} random {title}", _QUANTITIES, measure)


CHECKS = (
    _check("insertions under constant inputs", random_case),
    _check("schedules: guides, tracked tip, retraction, friction", random_schedule),
)
