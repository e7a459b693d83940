"""Define and run checks: quantities with acceptance bounds, set before anything is measured.

The checks are those of all files of the folder `checks`.
"""

import importlib
import math
import pkgutil
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from needlefit.project.random_streams import random_stream
from needlefit.verification import checks

Verdict = Literal["passes", "FAILS", "stated"]


class Group(Enum):
    """The groups of the table in its order: each has a title and an explanation."""

    CLOSED_FORMS = ("Closed forms", "Beams whose deflection is known exactly; default mesh, h = 1 mm.")
    MANUFACTURED = (
        "Manufactured solutions",
        "A deflection is chosen, constraint points laid to make it exact; observed orders, h = 2 to 0.5 mm.",
    )
    COLLOCATION = (
        "Independent collocation",
        "Single equilibria out of finished insertions as boundary value problems: no elements, no weak form.",
    )
    REFINEMENT = ("Discretisation error", "What the default mesh, h = C_int = 1 mm, leaves at the tip.")
    REFERENCE = (
        "Compiled model and reference",
        "Series, elimination and warm starts against dense matrices that read like the equations.",
    )
    TANGENT = ("Newton’s tangent", "Its step d at a state u, against the reference’s residual R(u).")
    SENSITIVITIES = (
        "Sensitivities",
        "Against complex steps of the reference’s equations, h = 1 mm; errors over a column’s largest entry.",
    )
    GEOMETRY = (
        "From the beam to the plane",
        "Points as integrals of cos u' and sin u' from the base, and where what holds the needle has it.",
    )
    PATH_ANGLE = (
        "Advance by the path angle",
        "It has a limit as C_int shrinks: the observed order, what C_int = 1 mm leaves, continuity.",
    )
    SYMMETRIES = ("Symmetries and identities", "What must not matter.")
    STATED = (
        "Constraint spacing",
        "C_int is part of the model and no mesh size: stated, not judged.",
    )

    def __init__(self, title: str, explanation: str) -> None:
        self.title, self.explanation = title, explanation


@dataclass(frozen=True)
class AcceptanceBound:
    """Bounds of a measured value: `low` <= value <= `high`; None, None: it is reported, not judged."""

    low: float | None = None
    high: float | None = None

    def verdict(self, value: float) -> Verdict:
        """Return whether a value passes; a value that is not finite always fails."""
        if not math.isfinite(value):
            return "FAILS"
        if self.low is None and self.high is None:
            return "stated"
        kept = (self.low is None or value >= self.low) and (self.high is None or value <= self.high)
        return "passes" if kept else "FAILS"


def worst(values: ArrayLike) -> float:
    """Return the largest value, NaN if any is NaN; ValueError if there are none, which must not pass."""
    # np.max, since Python's own max may pass over a NaN
    return float(np.max(values))


def at_most(high: float) -> AcceptanceBound:
    return AcceptanceBound(high=high)


def within(value: float, slack: float) -> AcceptanceBound:
    """Return the acceptance bound of an observed order: `value` plus or minus `slack`."""
    return AcceptanceBound(value - slack, value + slack)


@dataclass(frozen=True)
class Quantity:
    """One quantity of a check, before it is measured: one row of the table."""

    words: str
    bound: AcceptanceBound
    unit: str  # "" where it has none


@dataclass(frozen=True)
class ConvergenceCurve:
    """The result of a refinement study: errors at decreasing mesh sizes."""

    case: str  #: what was solved
    h: tuple[float, ...]  #: mesh sizes, mm
    errors: dict[str, tuple[float, ...]]  #: by norm, at each mesh size

    def order(self, norm: str) -> float:
        """Return the observed order: the slope of log error over log h, by least squares.

        Only over the three smallest h: on coarser meshes terms of higher order still show.
        """
        return float(np.polyfit(np.log(self.h[-3:]), np.log(self.errors[norm][-3:]), 1)[0])

    def orders(self, norm: str) -> list[float]:
        """Return the observed order between each pair of successive mesh sizes."""
        return (np.diff(np.log(self.errors[norm])) / np.diff(np.log(self.h))).tolist()


@dataclass(frozen=True)
class CheckOutcome:
    """The result of one check: a value for each of its quantities."""

    values: tuple[float, ...]
    remark: str = ""
    curves: tuple[ConvergenceCurve, ...] = ()


#: returns the outcome; whatever is random comes from the generator that it is given
Measure = Callable[[np.random.Generator], CheckOutcome]


@dataclass(frozen=True)
class Check:
    """One check: what is solved, which quantities are measured there, how, and within which bounds."""

    group: Group
    title: str
    quantities: tuple[Quantity, ...]
    measure: Measure


def define_check(group: Group, title: str, *quantities: Quantity) -> Callable[[Measure], Check]:
    """Return a decorator that makes a check of the function that measures it."""
    return lambda measure: Check(group, title, quantities, measure)


@dataclass(frozen=True)
class CheckRow:
    """One row of the table of results."""

    group: Group
    title: str
    quantity: str
    measured: float  # NaN where measuring it failed
    bound: AcceptanceBound
    unit: str
    verdict: Verdict
    remark: str = ""


@dataclass(frozen=True)
class Verification:
    """The result of a verification: the table, and the refinement studies behind its observed orders."""

    seed: int  #: of the random cases
    rows: tuple[CheckRow, ...]
    curves: tuple[ConvergenceCurve, ...]
    traces: tuple[str, ...] = ()  #: tracebacks of the checks whose measure ended in an error

    @property
    def failed(self) -> tuple[CheckRow, ...]:
        return tuple(row for row in self.rows if row.verdict == "FAILS")


def find_checks() -> tuple[Check, ...]:
    """Return the checks of all files of the folder `checks`, in the order of the table."""
    modules = sorted(module.name for module in pkgutil.iter_modules(checks.__path__))
    every = [
        check for name in modules for check in importlib.import_module(f"{checks.__name__}.{name}").CHECKS
    ]
    order = list(Group)
    return tuple(sorted(every, key=lambda check: order.index(check.group)))


def verify(
    seed: int = 1,
    every: Sequence[Check] | None = None,
    progress: Callable[[str, int, int], None] = lambda *_: None,
) -> Verification:
    """Measure all checks, or those of `every`; a check that crashes fails, and the others continue."""
    rows, curves, traces = list[CheckRow](), list[ConvergenceCurve](), list[str]()
    every = find_checks() if every is None else every
    for done, check in enumerate(every):
        progress(check.title, done, len(every))
        try:
            # a stream per check: adding a check changes the random cases of no other
            outcome = check.measure(random_stream(seed, "verify", check.group.title, check.title))
        except Exception as error:
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            outcome = CheckOutcome((float("nan"),) * len(check.quantities), f"not measured: {reason}")
            traces.append("".join(traceback.format_exception(error)))
        for one, value in zip(check.quantities, outcome.values, strict=True):
            head, verdict = (check.group, check.title, one.words), one.bound.verdict(value)
            rows.append(CheckRow(*head, float(value), one.bound, one.unit, verdict, outcome.remark))
        curves += outcome.curves
    return Verification(seed, tuple(rows), tuple(curves), tuple(traces))
