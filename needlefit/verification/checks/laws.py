"""Check every tissue law, as the kernel evaluates it, against its strain energy and its own derivatives."""

from collections.abc import Callable
from functools import partial

import numpy as np

from needlefit.arrays import Floats
from needlefit.mechanics.law_form import compile_law
from needlefit.mechanics.laws import LAWS
from needlefit.mechanics.packing import evaluate_layer
from needlefit.mechanics.tissue import Tissue
from needlefit.verification.check import Check, CheckOutcome, Group, Quantity, at_most, worst
from needlefit.verification.law import differentiate_stress

ALPHAS, STRETCHES, THICKNESS_MM = 12, 200, 10.0
MAX_COMPRESSION = 0.45
"""|e| / t up to which laws are compared."""

DIFFERENCE_STEP = 2e-4
"""Of stretch and alpha: central differences of the fourth order."""

_QUANTITIES = (
    Quantity("k against the derivative of the stress, over k", at_most(1e-9), ""),
    Quantity("dk/dλ against differences of k, over k / (1 - λ)", at_most(1e-6), ""),
    Quantity("dk/dα against differences of k, over k", at_most(1e-6), ""),
)


def measure_law(name: str, rng: np.random.Generator) -> CheckOutcome:
    law = LAWS[name]
    alphas = law.into_range(rng.uniform(-10, 10, ALPHAS))
    tissue = Tissue(np.ones(ALPHAS), alphas, np.arange(1.0, ALPHAS), np.array([THICKNESS_MM]), law=name)
    d = rng.uniform(0, _find_reach(name, alphas), STRETCHES)
    errors = []
    for layer, alpha in enumerate(np.repeat(alphas[:, None], STRETCHES, axis=1)):
        k, tangent, slope, *_ = evaluate_layer(tissue, layer, d * THICKNESS_MM)
        by_d, by_a = -_differences(law.k, (1 - d, alpha), 0), _differences(law.k, (1 - d, alpha), 1)
        errors.append(
            [
                worst(np.abs(k / differentiate_stress(name, 1 - d, alpha) - 1)),
                worst(np.abs(tangent - k - d * by_d) / k),
                worst(np.abs(slope - by_a) / k),
            ]
        )
    return CheckOutcome(tuple(map(float, np.max(errors, axis=0))))


def _find_reach(name: str, alphas: Floats) -> float:
    """Return the largest |e| / t to compare at; tables may end before."""
    table, exponents = compile_law(name, alphas)
    return MAX_COMPRESSION if exponents.shape[1] else min(MAX_COMPRESSION, table[:, 0].min())


def _differences(function: Callable[..., Floats], arguments: tuple[Floats, Floats], which: int) -> Floats:
    """Return the derivative of a function with respect to one of its two arguments."""

    def at(step: float) -> Floats:
        return function(*(one + step * (n == which) for n, one in enumerate(arguments)))

    near, far = (at(h) - at(-h) for h in (DIFFERENCE_STEP, 2 * DIFFERENCE_STEP))
    return (8 * near - far) / (12 * DIFFERENCE_STEP)


CHECKS = tuple(
    Check(Group.REFERENCE, f"law `{name}`: {ALPHAS} random α", _QUANTITIES, partial(measure_law, name))
    for name in LAWS.names()
)
