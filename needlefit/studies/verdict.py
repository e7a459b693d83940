"""The answer of a run, one sentence for each group: what terminal, report and `Run.verdicts` show first."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from needlefit.reporting.text import KindText
from needlefit.studies.kind import find_kind

if TYPE_CHECKING:
    from needlefit.studies.run import Run

Status = Literal["none", "pass", "warn", "fail"]
STATUSES: tuple[Status, ...] = ("none", "pass", "warn", "fail")
"""From the best to the worst; "none" where nothing was tested, as of a prediction: it has no badge."""

VERDICTS_KEY = "verdicts"  #: of `--json`


@dataclass(frozen=True)
class Verdict:
    """The answer for one group of insertions, or for a whole run."""

    sentence: str  #: the answer, with its most important numbers
    #: whether the result can be relied on, only with care, or not; "none" where this was not tested
    status: Status = "pass"
    group: str = ""  #: what it is about, such as "phantom 1, 3 layers"; empty: the whole run
    #: the numbers behind the sentence, by name with unit; None where one is not known
    numbers: Mapping[str, float | str | None] = field(default_factory=dict)


NOT_CONVERGED = "NOT CONVERGED"


def headline_fault(fault: str) -> str:
    """Return what stands before the verdicts of a run with this fault."""
    if "not certified" in fault:
        return "NOT CERTIFIED"
    return "INCOMPLETE" if fault.endswith(("could not be predicted", "have no density")) else NOT_CONVERGED


def mark_faults(faults: Sequence[str], headline: Callable[[str], str] = headline_fault) -> str:
    """Return the headlines of faults, each once, as sentences that stand before a result; "" without any."""
    return "".join(dict.fromkeys(f"{head}. " for head in map(headline, faults) if head))


def judge_run(result: "Run") -> tuple[Verdict, ...]:
    """Return the verdicts of a run, one for each group, from its stored tables alone.

    A run that was interrupted, or that has faults, passes nowhere; the headlines of its faults come first.
    Those of a preliminary recipe are marked.
    """
    report = find_kind(result.kind).report
    verdicts = report.judge(result)
    if (result.run.get("recipe") or {}).get("preliminary"):
        recipe = Path(str(getattr(result.record, "recipe", ""))).stem
        mark = f"; preliminary (recipe {recipe})" if recipe else "; preliminary"
        verdicts = [replace(one, sentence=f"{one.sentence}{mark}") for one in verdicts]
    if result.interrupted:
        return tuple(qualify(one, f"INTERRUPTED: the best found so far. {one.sentence}") for one in verdicts)
    if result.faults:
        heads = mark_faults(result.faults, report.headline)
        return tuple(qualify(one, f"{heads}{one.sentence}") for one in verdicts)
    return tuple(verdicts)


MAX_FLOOR_RATIO = 2.0
"""Tip error over its noise floor up to which predictions are as exact as the measurements."""


MIN_INSERTIONS = 3
"""Held-out insertions with which a verdict can pass: the mean of one or two says little about others."""


@dataclass(frozen=True)
class BestBaseline:
    """The baseline with the smallest tip error: in words, its error (mm), and how it compares with the fit.

    `verdict` is "better", "worse", or "tie" where the difference is not significant.
    """

    description: str
    error_mm: float | None
    verdict: Literal["better", "worse", "tie"]


def judge_errors(
    where: str,
    error_mm: float,
    floor_ratio: float | None,
    best: BestBaseline | None,
    insertions: int,
    *,
    reliable: bool = True,
) -> Verdict:
    """Judge the mean tip error of predictions on `where` beside the noise floor and the best baseline.

    Only `MIN_INSERTIONS` held out, with no baseline closer, can pass; and only `reliable` results, those of a
    run that is complete and without faults.
    """
    few = insertions < MIN_INSERTIONS
    opening, compared = _compare(error_mm, floor_ratio, best)
    if (few or not reliable) and opening != "fail":
        opening = "open"
    values = {"opening": opening, "compared": compared, "error_mm": error_mm, "floor_ratio": floor_ratio}
    values |= {"where": where, "insertions": insertions, "few": few, "best": best}
    status: Status = opening if opening in ("pass", "fail") else "warn"
    return Verdict(KindText("verdicts").sentence("errors", values), status)


Opening = Literal["pass", "part", "open", "fail"]  #: generalises; in part; not shown to; does not


def _compare(error_mm: float, floor_ratio: float | None, best: BestBaseline | None) -> tuple[Opening, str]:
    """Return the opening of a verdict, and how the best baseline compares.

    Within the noise floor a difference is not significant, whatever its standard error.
    """
    better_than_all: Opening = "pass" if floor_ratio is None or floor_ratio <= MAX_FLOOR_RATIO else "part"
    if best is None:
        return better_than_all, ""
    within_floor = floor_ratio is not None and floor_ratio <= 1
    if best.verdict == "better" and not within_floor:
        return "fail", "better"
    if best.error_mm is not None and best.error_mm < error_mm:
        return "open", "within floor" if best.verdict == "better" else "closer"
    return (better_than_all, "worse") if best.verdict == "worse" or within_floor else ("open", "tie")


def qualify(verdict: Verdict, sentence: str) -> Verdict:
    """Return a verdict in other words that does not pass: "warn" at best."""
    return replace(verdict, sentence=sentence, status=worst_status([verdict, Verdict("", "warn")]))


def worst_status(verdicts: Sequence[Verdict]) -> Status:
    """Return the worst status of several verdicts; "pass" of none."""
    return max((one.status for one in verdicts), key=STATUSES.index, default="pass")


def verdicts_to_json(verdicts: Sequence[Verdict]) -> list[dict[str, object]]:
    """Return verdicts as JSON values."""
    return [asdict(one) for one in verdicts]
