"""The words of checks: a table of all, and a line for those that passed, failed or are not decided."""

from collections.abc import Sequence

from needlefit.reporting.table import Table, TableLayout
from needlefit.reporting.text import KindText
from needlefit.studies.advice import name_doubt
from needlefit.studies.answer import MAX_NAMED_NEEDLES, Check, Finding

CHECKS = KindText("checks")


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
    hanging, named = (words.split(", ") if words else [] for words in (one.hangs_on, one.named))
    return CHECKS.sentence(
        f"{one.check}{part}",
        {
            **vars(one),
            "missed": one.missed,
            "equals_noise": one.equals_noise,
            "is_wide": one.is_wide,
            "pattern": one.pattern,
            "hanging": hanging,
            "few_hang": len(hanging) <= MAX_NAMED_NEEDLES,
            "values": list(one.values.items()),
            "doubts": [name_doubt(kind) for kind in named] if one.check is Check.DATA else [],
        },
    )


def list_failed(checks: Sequence[Finding]) -> list[str]:
    """Return what failed, of a check that asks for two things the one that did."""
    failed = (one for one in checks if one.passed is False)
    return [_word_check(one, "_failed" if CHECKS.has(f"{one.check}_failed") else "") for one in failed]


def _word_failure(check: Finding) -> str:
    found, required = (_word_check(check, part) for part in ("_found", "_required"))
    return f"{_word_check(check)} ({found}; required: {required})"


def summarize_checks(checks: Sequence[Finding]) -> str:
    """Return which checks passed, failed (and what was found), and are not decided."""
    sentences = []
    for opening, passed in (("Passed", True), ("Not passed", False), ("Not decided", None)):
        words = [
            _word_check(check) if passed is not False else _word_failure(check)
            for check in checks
            if check.passed is passed
        ]
        if words:
            sentences.append(f"{opening}: {'; '.join(words)}.")
    return " ".join(sentences)
