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
            "check": _word_check(check),
            "check_found": _word_check(check, "_found"),
            "check_required": _word_check(check, "_required"),
            "passed": "–" if check.passed is None else check.passed,
        }
        for check in checks
    ]
    return CHECKS.lay_out(Table("checks", rows, ("check", "check_found", "check_required", "passed")), {})


def _word_check(finding: Finding, part: str = "") -> str:
    """Return the question of a check, or what was "_found" or is "_required"."""
    hanging, named = (words.split(", ") if words else [] for words in (finding.hangs_on, finding.named))
    return CHECKS.sentence(
        f"{finding.check}{part}",
        {
            **vars(finding),
            "missed": finding.missed,
            "equals_noise": finding.equals_noise,
            "pattern": finding.pattern,
            "hanging": hanging,
            "few_hang": len(hanging) <= MAX_NAMED_NEEDLES,
            "values": list(finding.values.items()),
            "doubts": [name_doubt(kind) for kind in named] if finding.check is Check.DATA else [],
        },
    )


def _word_failure(check: Finding) -> str:
    result, required = (_word_check(check, part) for part in ("_found", "_required"))
    return f"{_word_check(check)} ({result}; required: {required})"


def list_failed(checks: Sequence[Finding]) -> list[str]:
    """Return the failed checks, each with what was found."""
    return [_word_failure(check) for check in checks if check.passed is False]


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
