"""Check every tissue law, as the kernel evaluates it, against its strain energy and its own derivatives."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from needlefit.arrays import Floats
from needlefit.mechanics.law_form import compile_law
from needlefit.mechanics.laws import LAWS, TissueLaw
from needlefit.mechanics.packing import evaluate_layer
from needlefit.mechanics.tissue import Tissue
from needlefit.verification.check import Check, CheckOutcome, Group, Quantity, at_most, worst
from needlefit.verification.law import STEP

SHAPES, STRETCHES, THICKNESS_MM = 12, 200, 10.0
"""Random sets of shape parameters and stretches of each, and the thickness."""

MAX_COMPRESSION = 0.45
"""|e| / t up to which laws are compared."""

DIFFERENCE_STEP = 2e-4
"""Of stretch and shape parameters: central differences of the fourth order."""

_QUANTITIES = (
    Quantity("k against the derivative of the stress, over k", at_most(1e-9), ""),
    Quantity("dk/dλ against differences of k, over k / (1 - λ)", at_most(1e-6), ""),
    Quantity("dk by the shape parameters against differences of k, over k", at_most(1e-6), ""),
)


def measure_law(name: str, rng: np.random.Generator) -> CheckOutcome:
    law = LAWS[name]
    shapes = law.draw_shape(rng, (SHAPES,))
    tissue = Tissue(np.ones(SHAPES), shapes, np.arange(1.0, SHAPES), THICKNESS_MM, law=name)
    d = rng.uniform(0, _find_reach(name, shapes), STRETCHES)
    errors = []
    for layer in range(SHAPES):
        shape = [np.full(STRETCHES, value) for value in shapes[:, layer]]
        slopes = [evaluate_layer(tissue, layer, d * THICKNESS_MM, p).by_shape for p in range(len(shape))]
        k, tangent, *_ = evaluate_layer(tissue, layer, d * THICKNESS_MM)
        by_d, *by_shape = (_differences(law.k, (1 - d, *shape), n) for n in range(1 + len(shape)))
        off = [worst(np.abs(slope - true) / k) for slope, true in zip(slopes, by_shape, strict=True)]
        errors.append(
            [
                worst(np.abs(k / _differentiate_stress(law, 1 - d, shape) - 1)),
                worst(np.abs(tangent - k + d * by_d) / k),
                worst([0.0, *off]),
            ]
        )
    return CheckOutcome(tuple(map(float, np.max(errors, axis=0))))


def _differentiate_stress(law: TissueLaw, stretch: Floats, shape: Sequence[Floats]) -> Floats:
    """Return k over mu by a complex step of the stress; or the k of a law without one."""
    stress = law.stress(stretch + 1j * STEP, *shape)
    if stress is None:
        return law.k(stretch, *shape)
    found: Floats = stress.imag / STEP
    return found


def _find_reach(name: str, shapes: Floats) -> float:
    """Return the largest |e| / t to compare at; tables may end before."""
    table, exponents = compile_law(name, shapes)
    return MAX_COMPRESSION if exponents.shape[1] else min(MAX_COMPRESSION, table[:, 0].min())


def _differences(function: Callable[..., Floats], arguments: Sequence[Floats], which: int) -> Floats:
    """Return the derivative of a function with respect to one of its arguments."""

    def at(step: float) -> Floats:
        return function(*(one + step * (n == which) for n, one in enumerate(arguments)))

    near, far = (at(h) - at(-h) for h in (DIFFERENCE_STEP, 2 * DIFFERENCE_STEP))
    return (8 * near - far) / (12 * DIFFERENCE_STEP)


CHECKS = tuple(
    Check(
        Group.REFERENCE,
        f"law `{law.name}`: "
        + (
            f"{SHAPES} random {', '.join(one.symbol for one in law.parameters)}" if law.parameters else "k(λ)"
        ),
        _QUANTITIES,
        partial(measure_law, law.name),
    )
    for law in LAWS.values()
)
