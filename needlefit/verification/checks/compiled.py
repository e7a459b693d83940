"""The compiled model against the readable reference: dense matrices, no series, no elimination of its own."""

import numpy as np

from needlefit.mechanics import reference
from needlefit.mechanics.control import Rules
from needlefit.mechanics.shape import NeedleShape
from needlefit.verification.cases import Case, Draw, random_case, random_schedule, solvable
from needlefit.verification.check import Check, Group, Outcome, Quantity, at_most

SOFTEST = 1e-3  # MPa


def reference_shape(case: Case) -> tuple[Case, NeedleShape]:
    """Return the case with the reference's answer."""
    return case, reference.follow(case.needle, case.tissue, case.steps)


def difference(case: Case, slow: NeedleShape) -> tuple[float, float]:
    """Return the largest differences of deflection or constraint point (mm) and of slope."""
    fast = case.shape(Rules())
    points = np.max(np.abs(fast.constraints - slow.constraints))
    u, slope = np.max(np.abs(fast.u - slow.u)), np.max(np.abs(fast.slope - slow.slope))
    return float(max(points, u)), float(slope)


def _check(title: str, draw: Draw, count: int, deepest: float) -> Check:
    quantities = (
        Quantity("difference of deflections and of the cut", at_most(1e-6), "mm"),
        Quantity("difference of slopes", at_most(1e-6), ""),
    )

    def measure(rng: np.random.Generator) -> Outcome:
        cases, said = solvable(lambda: draw(rng, deepest, SOFTEST), reference_shape, count)
        found = np.array([difference(*case) for case in cases])
        return Outcome(tuple(map(float, found.max(axis=0))), said)

    return Check(Group.REFERENCE, f"{count} random {title}", quantities, measure)


CHECKS = (
    _check("insertions under constant inputs", random_case, 12, 40.0),
    _check("schedules: guides, tracked tip, retraction, friction", random_schedule, 10, 25.0),
)
