"""Run the verification: measure every check in the folder `checks`, and compare it with its bounds."""

import importlib
import pkgutil
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from needlefit.project.random_streams import random_stream
from needlefit.verification import checks
from needlefit.verification.check import Check, CheckOutcome, CheckRow, ConvergenceCurve, Group

SEED = 1
"""Default seed of the random cases."""

ProgressCallback = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Verification:
    """The result of a verification: the table, and the refinement studies behind its observed orders.

    Attributes
    ----------
    seed : int
        Of the random cases.
    traces : tuple of str
        Where measuring a check ended in an error: its traceback.
    """

    seed: int
    rows: tuple[CheckRow, ...]
    curves: tuple[ConvergenceCurve, ...]
    traces: tuple[str, ...] = ()

    @property
    def failed(self) -> tuple[CheckRow, ...]:
        """The rows that fail."""
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
    seed: int = SEED, every: Sequence[Check] | None = None, progress: ProgressCallback = lambda *_: None
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
        rows += _judge_outcome(check, outcome)
        curves += outcome.curves
    return Verification(seed, tuple(rows), tuple(curves), tuple(traces))


def _judge_outcome(check: Check, outcome: CheckOutcome) -> Iterator[CheckRow]:
    for quantity, value in zip(check.quantities, outcome.values, strict=True):
        verdict = quantity.bound.verdict(value)
        yield CheckRow(
            check.group, check.title, quantity.words, float(value), quantity.bound, quantity.unit,
            verdict, outcome.remark,
        )  # fmt: skip
