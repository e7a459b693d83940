"""The first page of a result: one record for terminal, HTML, PDF, JSON and the combined report.

A kind of study fills in what it found (`StudyReport.first_page`); `Run.first_page` adds what every run has.
Its words are made once: a renderer chooses what it shows and where, and composes no sentence.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from needlefit.project.result_warnings import ResultWarning
from needlefit.reporting.table import TableLayout
from needlefit.studies.answer import Advice, Finding, RunFault, Verdict

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
