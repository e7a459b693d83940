"""The answer of a run, one sentence for each group: what terminal, report and `Run.verdicts` show first."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Literal

from needlefit.reporting.number_format import format_mm

if TYPE_CHECKING:
    from needlefit.studies.run import Run

Status = Literal["pass", "warn", "fail"]
STATUSES: tuple[Status, ...] = ("pass", "warn", "fail")
"""From the best to the worst."""

VERDICTS_KEY = "verdicts"
"""Of `--json`."""


@dataclass(frozen=True)
class Verdict:
    """The answer for one group of insertions, or for a whole run.

    Attributes
    ----------
    sentence : str
        The answer, with its most important numbers.
    status : "pass", "warn" or "fail"
        Whether the result can be relied on, only with care, or not.
    group : str
        What it is about, such as "phantom 1, 3 layers"; empty: the whole run.
    numbers : mapping
        The numbers behind the sentence, by name with unit; None where one is not known.
    """

    sentence: str
    status: Status = "pass"
    group: str = ""
    numbers: Mapping[str, float | str | None] = field(default_factory=dict)


def judge_run(result: "Run") -> tuple[Verdict, ...]:
    """Return the verdicts of a run, one for each group, from its stored tables alone.

    A run that was interrupted, or in which something did not converge, passes nowhere.
    """
    from needlefit.studies.kind import find_kind  # late: kinds import this module

    verdicts = find_kind(result.kind).report.judge(result)
    if result.interrupted:
        return tuple(qualify(one, f"INTERRUPTED: the best found so far. {one.sentence}") for one in verdicts)
    if result.faults:
        return tuple(qualify(one, f"NOT CONVERGED. {one.sentence}") for one in verdicts)
    return tuple(verdicts)


MAX_FLOOR_RATIO = 2.0
"""Tip error over its noise floor up to which predictions are as exact as the measurements."""


@dataclass(frozen=True)
class BestBaseline:
    """The baseline with the smallest tip error: in words, its error (mm), and how it compares with the fit.

    `verdict` is "better", "worse", or "tie" where the difference is not significant.
    """

    description: str
    error_mm: float | None
    verdict: Literal["better", "worse", "tie"]


def judge_errors(
    where: str, error_mm: float, floor_ratio: float | None, best: BestBaseline | None
) -> Verdict:
    """Judge the mean tip error of predictions on `where` beside the noise floor and the best baseline.

    Errors within the noise floor pass: below it differences between predictions are not significant.
    """
    status: Status
    errors = f"TE {format_tip_error(error_mm)} on {where}{format_floor_ratio(floor_ratio)}"
    if best is None or (floor_ratio is not None and floor_ratio <= 1) or best.verdict == "worse":
        accurate = floor_ratio is None or floor_ratio <= MAX_FLOOR_RATIO
        opening, status = ("Generalises", "pass") if accurate else ("Generalises in part", "warn")
        compared = f"; best baseline: {best.description}, {format_tip_error(best.error_mm)}" if best else ""
    elif best.verdict == "better":
        opening, status = "Does not generalise", "fail"
        compared = f"; {best.description} does better ({format_tip_error(best.error_mm)})"
    else:
        opening, status = "Not shown to generalise", "warn"
        compared = f"; no significant difference from {best.description} ({format_tip_error(best.error_mm)})"
    return Verdict(f"{opening}: {errors}{compared}", status)


def format_tip_error(error_mm: float | None) -> str:
    """Return an error with its unit, small ones with three decimals."""
    return f"{format_mm(error_mm, 3 if error_mm is not None and error_mm < 0.1 else 2)} mm"


def format_floor_ratio(ratio: float | None) -> str:
    """Return an error over its noise floor as the end of a phrase; empty where it is not known."""
    return "" if ratio is None else f", {ratio:.2g} × the noise floor"


def qualify(verdict: Verdict, sentence: str) -> Verdict:
    """Return a verdict in other words that does not pass: "warn" at best."""
    return replace(verdict, sentence=sentence, status=worst_status([verdict, Verdict("", "warn")]))


def worst_status(verdicts: Sequence[Verdict]) -> Status:
    """Return the worst status of several verdicts; "pass" of none."""
    return max((one.status for one in verdicts), key=STATUSES.index, default="pass")


def verdicts_to_json(verdicts: Sequence[Verdict]) -> list[dict[str, object]]:
    """Return verdicts as JSON values."""
    return [asdict(one) for one in verdicts]
