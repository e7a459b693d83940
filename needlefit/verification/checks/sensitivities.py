"""Check the Jacobian of the whole shape against complex-step derivatives of the readable reference."""

from dataclasses import dataclass

import numpy as np

from needlefit.arrays import Floats
from needlefit.mechanics.batch import linearize_steps
from needlefit.mechanics.control import ModelOptions
from needlefit.verification.cases import (
    EXACT_OPTIONS,
    Draw,
    RandomCase,
    draw_case,
    draw_schedule,
    require_converged,
    solve_cases,
)
from needlefit.verification.check import Check, CheckOutcome, Group, Quantity, at_most, worst
from needlefit.verification.complex_step import PARAMETER_KINDS, derivatives, parameters

RANDOM_CASES = 10
SENSITIVITY_OPTIONS: ModelOptions = EXACT_OPTIONS
MIN_COLUMN = 1e-3
"""mm per unit (per logarithm of mu and EI): a column below is measured against this, for the state itself is
known to no better than 1e-10 mm. Of slopes: a hundredth, per mm."""
PAPER_SOFTEST_MPA, SOFTEST_MPA = 0.2, 1e-3
"""MPa: the softest tissue of the paper, and far below it."""


@dataclass(frozen=True)
class ReferenceDerivatives:
    """Derivatives by the reference: of deflections and slopes (2 N, P), of constraint points (M + 1, P)."""

    case: RandomCase
    names: tuple[str, ...]
    du: Floats
    dc: Floats


def differentiate_reference(case: RandomCase) -> ReferenceDerivatives:
    """Return the reference's derivatives by all parameters of a case."""
    named = parameters(case)
    return ReferenceDerivatives(
        case, tuple(named), *derivatives(case, list(named.values()), SENSITIVITY_OPTIONS)
    )


def measure_errors(other: ReferenceDerivatives) -> dict[str, float]:
    """Return the largest error of each column, relative to its largest entry; over lengths and slopes.

    Raises
    ------
    ArithmeticError
        If the compiled solver fails where the reference did not.
    ValueError
        If the Jacobian lacks a column.
    """
    case = other.case
    shape, jacobian = linearize_steps(
        case.needle, case.tissue, case.steps, SENSITIVITY_OPTIONS, wrt=PARAMETER_KINDS
    )
    require_converged(shape)
    columns = [jacobian.names.index(name) for name in other.names]
    unit = np.array([_unit(case, name) for name in other.names])
    # the reference interleaves the degrees of freedom: u at even rows, slope at odd rows
    lengths = np.vstack((jacobian.u, jacobian.constraints)), np.vstack((other.du[0::2], other.dc)), MIN_COLUMN
    slopes = jacobian.slope, other.du[1::2], 0.01 * MIN_COLUMN
    shares = [
        np.abs(ours[:, columns] - true).max(axis=0)
        * unit
        / np.maximum(np.abs(true).max(axis=0) * unit, smallest)
        for ours, true, smallest in (lengths, slopes)
    ]
    return dict(zip(other.names, map(float, np.maximum(*shares)), strict=True))


def _unit(case: RandomCase, name: str) -> float:
    """Return mu or EI for their columns, which become those of the logarithm, and 1 for the others."""
    if name == "rigidity":
        return case.needle.flexural_rigidity
    # "mu2" is layer 2, index 1
    return float(case.tissue.mu[int(name[2:]) - 1]) if name.startswith("mu") else 1.0


def _kind(case: RandomCase, name: str) -> int:
    """Return which quantity a column counts for."""
    return {"shape": 2, "boundary": 1, "guide_x": 1}.get(parameters(case)[name].kind, 0)


def _draw_layered(draw: Draw, rng: np.random.Generator, softest: float) -> RandomCase:
    """Return a case with a boundary and a shape parameter to differentiate by."""
    while True:
        case = draw(rng, 25.0, softest)
        if case.tissue.layers > 1 and len(case.tissue.shape):
            return case


def _check(title: str, draw: Draw, softest: float, bound: float) -> Check:
    def measure(rng: np.random.Generator) -> CheckOutcome:
        found, remark = solve_cases(
            lambda: _draw_layered(draw, rng, softest), differentiate_reference, RANDOM_CASES
        )
        columns = [
            (_kind(each.case, name), error) for each in found for name, error in measure_errors(each).items()
        ]
        values = tuple(worst([e for kind, e in columns if kind == wanted]) for wanted in range(3))
        return CheckOutcome(
            values, "; ".join(filter(None, (f"{len(columns)} columns", remark, _explain_bound(softest))))
        )

    words = ("other columns", "columns of places (boundaries, guides)", "columns of shape parameters")
    quantities = tuple(Quantity(f"error of the {each}", at_most(bound), "") for each in words)
    reach = "μ = 0.2" if softest == PAPER_SOFTEST_MPA else "μ = 0.001"
    return Check(
        Group.SENSITIVITIES,
        f"{RANDOM_CASES} random {title.format(f'{reach} to 100 MPa')}",
        quantities,
        measure,
    )


def _explain_bound(softest: float) -> str:
    if softest == PAPER_SOFTEST_MPA:
        return ""
    return "the state is known to its rounding, some 10⁻¹⁰ mm, which soft tissue passes on enlarged"


_INSERTIONS = "insertions, constant inputs, {}"
_SCHEDULES = "schedules, {}: guides, tracked tip, retraction, friction"
CHECKS = (
    _check(_INSERTIONS, draw_case, PAPER_SOFTEST_MPA, 1e-7),
    _check(_SCHEDULES, draw_schedule, PAPER_SOFTEST_MPA, 1e-7),
    _check(_INSERTIONS, draw_case, SOFTEST_MPA, 1e-5),
    _check(_SCHEDULES, draw_schedule, SOFTEST_MPA, 1e-5),
)
