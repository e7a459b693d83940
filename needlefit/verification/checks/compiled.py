"""Check the compiled model against the readable reference, and every law against its strain energy."""

from collections.abc import Callable, Iterable, Sequence
from functools import partial

import numpy as np

from needlefit.arrays import Floats
from needlefit.mechanics import reference
from needlefit.mechanics.batch import Batch, simulate_batches
from needlefit.mechanics.control import Bevel, Controls, ModelOptions, Step
from needlefit.mechanics.laws import LAWS, TissueLaw
from needlefit.mechanics.packing import compile_law, evaluate_layer
from needlefit.mechanics.shape import NeedleShape
from needlefit.mechanics.tissue import Tissue
from needlefit.verification.cases import (
    PAPER_NEEDLE,
    STEP,
    Draw,
    RandomCase,
    draw_case,
    draw_schedule,
    require_converged,
    solve_cases,
)
from needlefit.verification.check import Check, CheckOutcome, Group, Quantity, at_most, define_check, worst

SHAPES, STRETCHES, THICKNESS_MM = 12, 200, 10.0  #: random sets of shape parameters, stretches of each
MAX_COMPRESSION = 0.45  #: |e| / t up to which laws are compared
DIFFERENCE_STEP = 2e-4  #: of stretch and shape parameters: central differences of the fourth order

_LAW_ERRORS = (
    Quantity("k against the derivative of the stress, over k", at_most(1e-9), ""),
    Quantity("dk/dλ against differences of k, over k / (1 - λ)", at_most(1e-6), ""),
    Quantity("dk by the shape parameters against differences of k, over k", at_most(1e-6), ""),
)


def measure_law(name: str, rng: np.random.Generator) -> CheckOutcome:
    law = LAWS[name]
    shapes = law.draw_shape(rng, (SHAPES,))
    tissue = Tissue(np.ones(SHAPES), shapes, np.arange(1.0, SHAPES), THICKNESS_MM, law=name)
    table, exponents = compile_law(name, shapes)
    # the largest |e| / t to compare at; tables may end before
    reach = MAX_COMPRESSION if exponents.shape[1] else min(MAX_COMPRESSION, table[:, 0].min())
    d = rng.uniform(0, reach, STRETCHES)
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


def _differences(function: Callable[..., Floats], arguments: Sequence[Floats], which: int) -> Floats:
    """Return the derivative of a function with respect to one of its arguments."""

    def at(step: float) -> Floats:
        return function(*(one + step * (n == which) for n, one in enumerate(arguments)))

    near, far = (at(h) - at(-h) for h in (DIFFERENCE_STEP, 2 * DIFFERENCE_STEP))
    return (8 * near - far) / (12 * DIFFERENCE_STEP)


LAW_CHECKS = tuple(
    Check(
        Group.REFERENCE,
        f"law `{law.name}`: "
        + (
            f"{SHAPES} random {', '.join(one.symbol for one in law.parameters)}" if law.parameters else "k(λ)"
        ),
        _LAW_ERRORS,
        partial(measure_law, law.name),
    )
    for law in LAWS.values()
)


SOFTEST_MPA, SETS_PER_LAW = 1e-3, 8
_QUANTITIES = (
    Quantity("difference of deflections, constraint points", at_most(1e-6), "mm"),
    Quantity("difference of slopes", at_most(1e-6), ""),
)


def compare_all(pairs: Iterable[tuple[NeedleShape, NeedleShape]]) -> tuple[float, float]:
    """Return the largest differences of deflection or constraint point (mm) and of slope, of all pairs."""
    lengths, slopes = list[float](), list[float]()
    for fast, slow in pairs:
        lengths += [worst(np.abs(fast.constraints - slow.constraints)), worst(np.abs(fast.u - slow.u))]
        slopes.append(worst(np.abs(fast.slope - slow.slope)))
    return worst(lengths), worst(slopes)


def _check(title: str, draw: Draw, count: int, deepest: float) -> Check:
    def solve(case: RandomCase) -> tuple[RandomCase, NeedleShape]:
        return case, reference.simulate_steps(case.needle, case.tissue, case.steps)

    def measure(rng: np.random.Generator) -> CheckOutcome:
        cases, remark = solve_cases(lambda: draw(rng, deepest, SOFTEST_MPA), solve, count)
        return CheckOutcome(compare_all((case.shape(ModelOptions()), slow) for case, slow in cases), remark)

    return Check(Group.REFERENCE, f"{count} random {title}", _QUANTITIES, measure)


@define_check(
    Group.REFERENCE,
    f"{SETS_PER_LAW} parameter sets of every law at once, μ = 0.01 to 100 MPa",
    *_QUANTITIES,
)
def in_lanes(rng: np.random.Generator) -> CheckOutcome:
    """Many parameter sets of one insertion at once; every one against the reference by itself."""
    depth = float(rng.uniform(20, 40))
    steps = (Step(depth, Bevel(0.1), Controls(0.3)),)

    def make_layers(law: str) -> Tissue:
        shape = [[one.default] * 3 for one in LAWS[law].parameters]
        return Tissue([1.0] * 3, shape, [0.31 * depth, 0.64 * depth], [20.0, 40.0, 30.0], law=law)

    batches = [
        Batch(
            PAPER_NEEDLE,
            make_layers(law),
            steps,
            mu=10 ** rng.uniform(-2, 2, (SETS_PER_LAW, 3)),
            shape=np.moveaxis(LAWS[law].draw_shape(rng, (SETS_PER_LAW, 3)), 0, 1),
            offset=rng.uniform(0.01, 0.15, SETS_PER_LAW),
            rigidity=10 ** rng.uniform(3.5, 4.5, SETS_PER_LAW),
        )
        for law in LAWS.names()
    ]
    found = zip(batches, simulate_batches(batches), strict=True)
    pairs = [
        (require_converged(shapes[i]), reference.simulate_steps(*batch.pick(i)))
        for batch, shapes in found
        for i in range(SETS_PER_LAW)
    ]
    return CheckOutcome(compare_all(pairs))


_SCHEDULES = "schedules, μ = 0.001 to 100 MPa: guides, tracked tip, retraction, friction"
CHECKS = (
    _check("insertions, constant inputs, μ = 0.001 to 100 MPa", draw_case, 12, 40.0),
    _check(_SCHEDULES, draw_schedule, 10, 25.0),
    in_lanes,
    *LAW_CHECKS,
)
