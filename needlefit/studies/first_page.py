"""The first page of a result: one record for terminal, HTML, PDF, JSON and the combined report.

A kind of study fills in what it found (`StudyReport.first_page`); `Run.first_page` adds what every run has.
Its words are made once: a renderer chooses what it shows and where, and composes no sentence.
"""

import re
import shlex
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Literal

import pandas as pd

from needlefit.inference.draws import Draws
from needlefit.metrics import METRICS, TE
from needlefit.project.help_pages import read_sections
from needlefit.project.locate import format_path
from needlefit.project.result_warnings import ResultWarning
from needlefit.reporting.table import Table, TableLayout
from needlefit.reporting.text import KindText

# ---- what a run found

Status = Literal["none", "pass", "warn", "fail"]
#: statuses from the best to the worst; "none" where nothing was tested, as of a prediction: it has no badge
STATUSES: tuple[Status, ...] = ("none", "pass", "warn", "fail")

MAX_NAMED_NEEDLES = 3  #: largest number of needles that are named where a verdict depends on any one of them


@dataclass(frozen=True)
class Verdict:
    """The answer of a run."""

    sentence: str  #: the answer, with its most important numbers
    #: whether the result can be relied on, only with care, or not; "none" where this was not tested
    status: Status = "pass"
    #: the numbers behind the sentence, by name with unit; None where one is not known
    numbers: Mapping[str, float | str | None] = field(default_factory=dict)
    word: str = ""  #: the answer in tables: "closer than both"

    @property
    def opening(self) -> str:
        """The sentence up to its numbers."""
        return re.split(r"[:.] ", self.sentence)[0]


class FaultKind(StrEnum):
    """Why a result is not to be trusted; the value is the headline."""

    NOT_CONVERGED = "NOT CONVERGED"
    NOT_CERTIFIED = "NOT CERTIFIED"


@dataclass(frozen=True)
class RunFault:
    """Something in a result that is not to be trusted."""

    kind: FaultKind
    what: str

    def __str__(self) -> str:
        return self.what


def find_fault_kind(draws: Draws) -> FaultKind:
    """Return of which kind the faults of draws are: of a sampler, or of weights of importance sampling."""
    return FaultKind.NOT_CONVERGED if draws.source == "posterior" else FaultKind.NOT_CERTIFIED


class Outcome(StrEnum):
    """How our predictions compare with curves without mechanics; the value is what tables print.

    The first six are of few trials, compared with two references; the last three are tested.
    """

    status: Status
    passed: bool | None  #: of the check that the model is closer; None: cannot be decided
    advice: str  #: what it found, a key of `COMMANDS`; "" where there is nothing to do

    CLOSER = "closer than both", "pass", True, ""
    CLOSER_BY_ONE_NEEDLE = "closer by one needle", "warn", None, "one_needle_decides"
    BEND_TOO_LITTLE = "bend too little", "warn", None, "bend_too_little"
    AS_CLOSE = "as close", "warn", None, "curve_as_good"
    WORSE = "worse than one", "fail", False, "curve_closer"
    UNDECIDED = "undecided", "warn", None, "margin_unstated"
    GENERALISES = "generalises", "pass", True, ""
    NOT_SHOWN = "not shown", "warn", None, "closer_undecided"
    DOES_NOT_GENERALISE = "does not generalise", "fail", False, "curve_closer"

    def __new__(cls, word: str, status: Status, passed: bool | None, advice: str) -> "Outcome":
        member = str.__new__(cls, word)
        member._value_ = word
        member.status, member.passed, member.advice = status, passed, advice
        return member


class Check(StrEnum):
    """A question to a result that is answered by yes or no."""

    HELD_OUT = "held_out"  #: of a fit: whether insertions that it has not seen were predicted
    CURVES = "closer_than_curves"
    NOISE = "within_noise"
    INTERVALS = "intervals_95"  #: whether tips lie in their 95 % intervals
    WIDTH = "interval_width"  #: whether these are narrow enough to aim with
    COVERAGE_50 = "coverage_50"
    SAME = "same_without"  #: whether the verdict is the same without single needles
    DATA = "data_as_stated"


@dataclass(frozen=True)
class Finding:
    """What a check found."""

    check: Check
    passed: bool | None  #: None: cannot be decided
    value: float | None = None  #: what is compared with the threshold, in the unit of the check
    threshold: float | None = None
    named: str = ""  #: the curve that is compared, or the kinds of the warnings about the data, with commas
    trials: int | None = None  #: independent ones, of comparisons and coverages
    #: difference of errors that counts as none, in the unit of the score
    margin_mm: float | None = None
    needles: int | None = None  #: compared with a reference
    closer: int | None = None  #: of these, on which the model is closer
    hangs_on: str = ""  #: needles of which, if one is left out, the outcome is another, with commas
    left_out: str = ""  #: needles in doubt, with commas
    outcome: str = ""  #: without these
    #: by parameter its value with these and without them, Pa and mm
    values: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    unjudged: str = ""  #: why no needle was compared with the others
    tips: int | None = None  #: that have an interval
    missing: int = 0  #: held-out tips that have none
    deflection_mm: float | None = None  #: median of the tips' deflections
    beyond: int | None = None  #: tips that deflect more than the middle of their intervals, the median
    score: str = TE.name  #: the metric of the verdict

    @property
    def missed(self) -> str:
        """What an error is of: "tips" or "curvatures"."""
        return METRICS[self.score].missed

    @property
    def is_below(self) -> bool:
        """Whether the value is below the threshold."""
        return self.value is not None and self.threshold is not None and self.value < self.threshold

    @property
    def equals_noise(self) -> bool:
        """Whether an error over that of the noise is one, as far as it is printed."""
        return self.value is not None and is_printed_as_one(self.value)

    @property
    def pattern(self) -> str:
        """How predicted tips lie about their intervals."""
        if self.passed is False and not self.is_below:
            return "too_wide"
        if self.tips and self.tips > 1 and self.beyond in (0, self.tips):
            return "all_more" if self.beyond else "all_less"
        return "too_narrow" if self.passed is False else "as_predicted"


def is_printed_as_one(ratio: float) -> bool:
    """Return whether a ratio is 1 in the digits that are printed."""
    return f"{ratio:.2g}" == "1"


RESULTS = "reports"  #: folder that holds the folders of results, unless a command states another


@dataclass(frozen=True)
class Advice:
    """What to do next."""

    finding: str  #: what it follows from: a key of `COMMANDS`
    words: str  #: a sentence without its stop
    command: tuple[str, ...] = ()  #: words of the command that does it; empty if there is none
    results: str = RESULTS  #: the folder of folders of results in these words

    @property
    def sentence(self) -> str:
        """The words with what ends them: the command follows a colon."""
        return f"{self.words}{':' if self.command else '.'}"

    def format_command(self, results: Path | None = None) -> str:
        """Return the command as it is typed where the folders of results are in `results`."""
        here, words = f"{self.results}/", list(self.command)
        if results is not None:
            placed = {word: results / word.removeprefix(here) for word in words if word.startswith(here)}
            # a folder of this one needs its ./, else it is a name
            paths = {
                word: str(path) if len(path.parts) > 1 else format_path(path) for word, path in placed.items()
            }
            words = [paths.get(word, word) for word in words]
        return shlex.join(words)


def tabulate_checks(findings: Sequence[Finding]) -> pd.DataFrame:
    """Return one row per check."""
    columns = [name for name in Finding.__dataclass_fields__ if name != "values"]  # stand in run.json
    return pd.DataFrame([asdict(finding) for finding in findings], columns=columns)


#: beginnings of the last paragraphs of a first page
WHAT_TO_DO, METHOD = "What to do.", "Method."

VERDICTS_KEY, CHECKS_KEY = "verdicts", "checks"  #: keys of the output of `--json`


# ---- what to do: of what was found the first row here is the advice, in the words of `advice.md.j2`

ADVICE = KindText("advice")

COMMANDS: Mapping[str, str] = {
    # of every run
    "not_converged": "explain not-converged",
    # of fits and cross-validations; doubts about the data forbid a good word as they forbid a bad one
    "dataset_doubtful": "check {dataset}",
    "result_doubtful": "explain {doubt}",
    "other_medium_missed": "",
    "curve_closer": "explain closer-than-curves",
    "curve_as_good": "explain closer-than-curves",
    "one_needle_decides": "explain closer-than-curves",
    "bend_too_little": "explain closer-than-curves",
    "closer_undecided": "explain closer-than-curves",
    "margin_unstated": "explain closer-than-curves",
    "intervals_miss": "explain coverage",
    "intervals_wide": "tune {run} --design",
    "beyond_noise": "explain within-noise",
    "values_assumed": "check {dataset}",
    "parameters_undetermined": "tune {run} --design",
    "predictable": "predict {run}",
    # of predictions
    "study_unvalidated": "validate {target}",
    "fit_untested": "explain held-out",
    "prediction_wide": "tune {run} --design",
    "tip_predicted": "plan {run} --target {tip}",
    # of designs
    "repeat_best": "",
    "insertion_best": "",
    # of reconstructions
    "scan_unregistered": "predict phantom1 --scene {run}/scenes/{scan}.toml",
    "scans_reconstructed": "check {run}",
}
"""Words of the command by finding, the most urgent finding first; "" where there is none to run."""


def advise(
    findings: Iterable[str], values: Mapping[str, Any], name: str = "", results: str = RESULTS
) -> Advice | None:
    """Return the advice on what a run found, whose text and command take `values`; None if nothing has any.

    The command takes `results/name`, the folder of a run, too, unless `values` state another `run`.
    """
    listed = set(findings)
    finding = next((command for command in COMMANDS if command in listed), None)
    if finding is None:
        return None
    values_of_run = {"run": f"{results}/{name}", **values}
    words = [word.format_map(values_of_run) for word in COMMANDS[finding].split()]
    command = ("needlefit", *words) if words else ()
    return Advice(finding, ADVICE.sentence(finding, values), command, results)


#: kinds of warnings about data that cannot all be right: no verdict on them is one on the model
CONTRADICTIONS = ("axis_unit", "bevel_side", "copy", "examples", "reversed")
#: kinds of warnings that `needlefit check` prints, of a dataset alone; the others are about a result
_OF_DATASETS = (
    *CONTRADICTIONS,
    *("point_outlier", "entry_offset"),
    *("curvature", "interpolated", "no_noise", "noise", "spelling", "surfaces"),
)
#: kinds of warnings that are no doubt: a text that reports print, and the choice of a point of a distribution
_NO_DOUBTS = ("placeholder", "predictive_median")
#: kinds of warnings that explain others, the most urgent first; and those that explain least
_FIRST_DOUBTS, ASSUMED = (*CONTRADICTIONS, "needle_outlier"), "assumed"


def list_doubts(warnings: Iterable[ResultWarning]) -> list[ResultWarning]:
    """Return the warnings that cast doubt on the data, the model or a parameter, the first of each kind.

    The most urgent one stands first: a needle that differs explains errors above the noise floor.
    """
    first: dict[str, ResultWarning] = {}
    for warning in warnings:
        first.setdefault(warning.kind, warning)
    doubts = [warning for kind, warning in first.items() if kind not in _NO_DOUBTS]
    return sorted(doubts, key=lambda doubt: (doubt.kind == ASSUMED, doubt.kind not in _FIRST_DOUBTS))


def list_contradictions(warnings: Iterable[ResultWarning], left_out: Collection[str] = ()) -> list[str]:
    """Return the kinds of warnings by which the data contradict themselves without the needles left out."""
    kinds = {
        warning.kind
        for warning in warnings
        if not warning.insertions or not set(warning.insertions) <= set(left_out)
    }
    return [kind for kind in CONTRADICTIONS if kind in kinds]


def classify_doubt(doubt: ResultWarning) -> str:
    """Return what a doubt found; "" of the model's limits, which no command removes."""
    if doubt.kind == "validity":
        return ""
    if doubt.kind == ASSUMED:
        return "values_assumed"
    return "dataset_doubtful" if doubt.kind in _OF_DATASETS else "result_doubtful"


def name_doubt(kind: str) -> str:
    """Return what a kind of warning is about, as its section of the help is titled."""
    section = read_sections().get(kind.replace("_", "-"))
    title = kind.replace("_", " ") if section is None else section.title
    return title[:1].lower() + title[1:]


def find_failures(checks: Mapping[Check, Finding], comparison: str, other_medium: bool) -> list[str]:
    """Return what failed checks of fits and predictions found.

    `comparison`: what the comparison with curves found, the `advice` of a judgement. `other_medium`: whether
    the insertions are into a medium that was not fitted.
    """
    failed = {check for check, finding in checks.items() if finding.passed is False}
    failures = [comparison] if comparison else []
    if other_medium and failed & {Check.CURVES, Check.NOISE}:
        failures.append("other_medium_missed")
    if Check.INTERVALS in failed or (Check.COVERAGE_50 in failed and checks[Check.COVERAGE_50].is_below):
        failures.append("intervals_miss")
    elif Check.WIDTH in failed:
        failures.append("intervals_wide")
    if Check.NOISE in failed:
        failures.append("beyond_noise")
    return failures


# ---- the page


@dataclass(frozen=True)
class FirstPage:
    """The parts of a first page, in the order in which they are read."""

    verdict: Verdict  #: the answer
    about: str = ""  #: what was fitted and what was predicted
    #: what was found; then the fitted parameters, with what limits them
    tables: Sequence[TableLayout] = ()
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
