"""Check the compiled model against the readable reference, with dense matrices and plain equations."""

from collections.abc import Iterable

import numpy as np

from needlefit.mechanics import reference
from needlefit.mechanics.batch import Batch, simulate_batches
from needlefit.mechanics.control import Bevel, Controls, ModelOptions, Step
from needlefit.mechanics.laws import LAWS
from needlefit.mechanics.shape import NeedleShape
from needlefit.mechanics.tissue import Tissue
from needlefit.verification.cases import (
    PAPER_NEEDLE,
    Draw,
    RandomCase,
    draw_case,
    draw_schedule,
    require_converged,
    solve_cases,
)
from needlefit.verification.check import Check, CheckOutcome, Group, Quantity, at_most, worst

SOFTEST_MPA = 1e-3  # MPa
SETS_PER_LAW = 8
"""Parameter sets of each law."""


_QUANTITIES = (
    Quantity("difference of deflections, constraint points", at_most(1e-6), "mm"),
    Quantity("difference of slopes", at_most(1e-6), ""),
)


def solve_reference(case: RandomCase) -> tuple[RandomCase, NeedleShape]:
    """Return the case and the reference's solution of it."""
    return case, reference.simulate_steps(case.needle, case.tissue, case.steps)


def compare_shapes(fast: NeedleShape, slow: NeedleShape) -> tuple[float, float]:
    """Return the largest differences of deflection or constraint point (mm) and of slope."""
    points, u = worst(np.abs(fast.constraints - slow.constraints)), worst(np.abs(fast.u - slow.u))
    return worst([points, u]), worst(np.abs(fast.slope - slow.slope))


def compare_all(pairs: Iterable[tuple[NeedleShape, NeedleShape]]) -> tuple[float, float]:
    """Return the largest differences of all pairs."""
    lengths, slopes = zip(*(compare_shapes(*pair) for pair in pairs), strict=True)
    return worst(lengths), worst(slopes)


def _check(title: str, draw: Draw, count: int, deepest: float) -> Check:
    def measure(rng: np.random.Generator) -> CheckOutcome:
        cases, remark = solve_cases(lambda: draw(rng, deepest, SOFTEST_MPA), solve_reference, count)
        return CheckOutcome(compare_all((case.shape(ModelOptions()), slow) for case, slow in cases), remark)

    return Check(Group.REFERENCE, f"{count} random {title}", _QUANTITIES, measure)


def _make_layers(law: str, depth: float) -> Tissue:
    shape = [[one.default] * 3 for one in LAWS[law].parameters]
    return Tissue([1.0] * 3, shape, [0.31 * depth, 0.64 * depth], [20.0, 40.0, 30.0], law=law)


def _in_lanes(rng: np.random.Generator) -> CheckOutcome:
    """Many parameter sets of one insertion at once; every one against the reference by itself."""
    depth = float(rng.uniform(20, 40))
    steps = (Step(depth, Bevel(0.1), Controls(0.3)),)
    batches = [
        Batch(
            PAPER_NEEDLE,
            _make_layers(law, depth),
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


CHECKS = (
    _check("insertions, constant inputs, μ = 0.001 to 100 MPa", draw_case, 12, 40.0),
    _check(
        "schedules, μ = 0.001 to 100 MPa: guides, tracked tip, retraction, friction",
        draw_schedule,
        10,
        25.0,
    ),
    Check(
        Group.REFERENCE,
        f"{SETS_PER_LAW} parameter sets of every law at once, μ = 0.01 to 100 MPa",
        _QUANTITIES,
        _in_lanes,
    ),
)
