"""Check that forces and moments on the needle balance: tissue, base, guides and tracked tip."""

import numpy as np

from needlefit.mechanics.load import compute_loads
from needlefit.verification.cases import EXACT_OPTIONS, RandomCase, draw_schedule
from needlefit.verification.check import Check, CheckOutcome, Group, Quantity, at_most, worst

RANDOM_CASES = 10


def compute_imbalance(case: RandomCase) -> tuple[float, float]:
    """Return the sum of all forces, and of all moments about the entry, over the sum of their sizes."""
    found = compute_loads(case.shape(), case.tissue, case.needle, case.steps[-1].controls, EXACT_OPTIONS)
    forces = [held.force for held in found.all_loads]
    moments = [held.moment + held.x * held.force for held in found.all_loads]
    return _sum_over_sizes(forces), _sum_over_sizes(moments)


def _sum_over_sizes(values: list[float]) -> float:
    return abs(sum(values)) / float(np.sum(np.abs(values)))


def _measure(rng: np.random.Generator) -> CheckOutcome:
    forces, moments = zip(*(compute_imbalance(draw_schedule(rng)) for _ in range(RANDOM_CASES)), strict=True)
    return CheckOutcome((worst(forces), worst(moments)))


CHECKS = (
    Check(
        Group.SYMMETRIES,
        "Tissue, base, guides and tracked tip balance, schedules of all inputs",
        (
            Quantity(f"sum of forces over their sizes, {RANDOM_CASES} random cases", at_most(1e-5), ""),
            Quantity(f"sum of moments over their sizes, {RANDOM_CASES} random cases", at_most(1e-5), ""),
        ),
        _measure,
    ),
)
