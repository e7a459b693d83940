"""The first page of a result: one record for terminal, HTML, PDF, JSON and the combined report.

A kind of study fills in what it found (`StudyReport.first_page`); `Run.first_page` adds what every run has.
Its words are made once: a renderer chooses what it shows and where, and composes no sentence.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from needlefit.project.result_warnings import ResultWarning
from needlefit.reporting.table import Table, TableLayout
from needlefit.reporting.text import KindText
from needlefit.studies.advice import name_doubt
from needlefit.studies.answer import MAX_NAMED_NEEDLES, Advice, Check, Finding, RunFault, Verdict

#: how the last paragraphs of a first page begin
WHAT_TO_DO, METHOD = "What to do.", "Method."

VERDICTS_KEY, CHECKS_KEY = "verdicts", "checks"  #: of `--json`


@dataclass(frozen=True)
class FirstPage:
    """The parts of a first page, in the order in which they are read."""

    verdict: Verdict  #: the answer
    about: str = ""  #: what was fitted and what was predicted
    #: what was found; then the fitted parameters, with what limits them
    tables: Sequence[TableLayout] = ()
    figures: Sequence[str] = ()  #: names of the figures that stand here
    checks: Sequence[Finding] = ()  #: whether it can be relied on
    advice: Advice | None = None  #: what to do
    method: str = ""  #: how it was computed
    # what every run has
    title: str = ""
    question: str = ""  #: that the study asks; a terminal leaves it out
    origin_mark: str = ""  #: that data were not measured; else ""
    origin_note: str = ""  #: what such data show
    interrupted: bool = False
    faults: Sequence[RunFault] = ()
    warnings: Sequence[ResultWarning] = ()  #: that touch the verdict

    @property
    def introduction(self) -> str:
        """The question, then what was fitted and predicted."""
        return " ".join(filter(None, (self.question, self.about)))

    @property
    def answer(self) -> str:
        """The verdict, after what a reader must know of the data."""
        mark = f"{self.origin_mark}. " if self.origin_mark else ""
        return f"{mark}{self.verdict.sentence}."

    def to_json(self) -> dict[str, Any]:
        """Return what `--json` has of it: the verdict and the checks."""
        checks = [{**asdict(check), "check": str(check.check)} for check in self.checks]
        return {VERDICTS_KEY: [asdict(self.verdict)], CHECKS_KEY: checks}


# ---- the words of checks: a table of all, and a line for those that passed, failed or are not decided

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
