"""Report how the tip depends on the constraint spacing C_int: it is part of the model, not a mesh size.

The values are reported, not judged. b turns the cut once per C_int, so halving C_int at fixed b turns the
needle more often; b halved with it turns as much per mm, and still does not give the same needle.
"""

import numpy as np

from needlefit.mechanics.control import Bevel, ModelOptions
from needlefit.mechanics.simulate import simulate
from needlefit.verification.cases import PAPER_NEEDLE, make_tissue, require_converged
from needlefit.verification.check import AcceptanceBound, Check, CheckOutcome, Group, Quantity

DEPTH, OFFSET = 50.0, 0.085
_TISSUE = make_tissue(mu=[0.2, 33.0, 0.2, 33.0], alpha=[1.0, -1.0, 1.0, -1.0], boundaries=[20.0, 28.0, 45.0])


def tip(spacing: float, offset: float) -> float:
    """Return the tip's deflection, mm."""
    return require_converged(
        simulate(PAPER_NEEDLE, _TISSUE, Bevel(offset), DEPTH, rules=ModelOptions(spacing, spacing))
    ).tip_lateral


def _measure(rng: np.random.Generator) -> CheckOutcome:
    return CheckOutcome((tip(1.0, OFFSET), tip(0.5, OFFSET), tip(0.5, OFFSET / 2)))


CHECKS = (
    Check(
        Group.STATED,
        "The tip in four layers of the paper’s values, 50 mm deep",
        tuple(
            Quantity(f"deflection, {words}", AcceptanceBound(), "mm")
            for words in (
                f"C_int = 1 mm, b = {OFFSET:g} mm",
                f"C_int = 0.5 mm, b = {OFFSET:g} mm",
                f"C_int = 0.5 mm, b = {OFFSET / 2:g} mm",
            )
        ),
        _measure,
    ),
)
