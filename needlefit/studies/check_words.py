"""The words of checks: a table of all, and a line for those that passed, failed or are not decided."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from needlefit.metrics import TE
from needlefit.reporting.table import Table, TableLayout
from needlefit.reporting.text import KindText
from needlefit.studies.advice import name_doubt
from needlefit.studies.answer import MAX_NAMED_NEEDLES, Check, Finding

#: of a `Finding`: which words about a check are printed
_CHECK_RULES: Mapping[str, Callable[[Any], object]] = {
    "curves_tested": lambda v: v.needles is None,
    "references_compared": lambda v: v.needles is not None,
    "closer_on": lambda v: v.needles,
    "hangs_on_needles": lambda v: v.hanging,
    "one_of_few": lambda v: len(v.hanging) <= MAX_NAMED_NEEDLES,
    "one_of_many": lambda v: len(v.hanging) > MAX_NAMED_NEEDLES,
    "no_curve": lambda v: not v.named,
    "below_curves": lambda v: v.named and v.needles is None,
    "below_references": lambda v: v.named and v.needles is not None,
    "by_margin": lambda v: v.margin_mm is not None,
    "no_noise": lambda v: v.value is None,
    "equals_noise": lambda v: v.equals_noise,
    "times_noise": lambda v: v.value is not None and not v.equals_noise,
    "missing_tips": lambda v: v.missing,
    "one_trial": lambda v: v.trials == 1,
    "no_intervals": lambda v: v.value is None,
    "intervals_found": lambda v: v.value is not None,
    "nothing_required": lambda v: v.value is None,
    "some_covered": lambda v: v.value is not None and v.trials == 1,
    "share_95": lambda v: v.value is not None and v.trials != 1,
    **dict.fromkeys(("width_limit", "width_found"), lambda v: v.width_mm is not None),
    **dict.fromkeys(("tips_covered", "one_tip"), lambda v: v.missed == TE.missed),
    **dict.fromkeys(("needles_covered", "one_needle"), lambda v: v.missed != TE.missed),
    "tips_missed": lambda v: v.covered is False,
    "and_width": lambda v: v.covered is False and v.is_wide,
    "width_exceeded": lambda v: v.is_wide,
    "none_required": lambda v: v.trials == 1,
    "share_50": lambda v: v.trials != 1,
    "no_doubts": lambda v: v.passed,
    "doubts": lambda v: not v.passed,
}
CHECKS = KindText("checks", rules=_CHECK_RULES)


def lay_out_checks(checks: Sequence[Finding]) -> TableLayout:
    """Return checks as a table: the question, what was found, what is required, yes or no."""
    rows = [
        {
            "check": _word_check(one),
            "check_found": _word_check(one, "_found"),
            "check_required": _word_check(one, "_required"),
            "passed": "–" if one.passed is None else one.passed,
        }
        for one in checks
    ]
    return CHECKS.lay_out(Table("checks", rows, ("check", "check_found", "check_required", "passed")), {})


def _word_check(one: Finding, part: str = "") -> str:
    """Return the question of a check, or what was "_found", is "_required" or "_failed"."""
    doubts = [name_doubt(kind) for kind in one.named.split(", ")] if one.check is Check.DATA else []
    return CHECKS.sentence(
        f"{one.check}{part}",
        {
            **vars(one),
            "missed": one.missed,
            "equals_noise": one.equals_noise,
            "is_wide": one.is_wide,
            "pattern": one.pattern,
            "hanging": one.hangs_on.split(", ") if one.hangs_on else [],
            "doubts": doubts,
        },
    )


def list_failed(checks: Sequence[Finding]) -> list[str]:
    """Return what failed, of a check that asks for two things the one that did."""
    failed = (one for one in checks if one.passed is False)
    return [_word_check(one, "_failed" if CHECKS.has(f"{one.check}_failed") else "") for one in failed]


def summarize_checks(checks: Sequence[Finding]) -> str:
    """Return which checks passed, failed (and what was found), and are not decided."""
    sentences = []
    for opening, passed in (("Passed", True), ("Not passed", False), ("Not decided", None)):
        words = [
            _word_check(one) if passed is not False else f"{_word_check(one)} ({_word_check(one, '_found')})"
            for one in checks
            if one.passed is passed
        ]
        if words:
            sentences.append(f"{opening}: {'; '.join(words)}.")
    return " ".join(sentences)
