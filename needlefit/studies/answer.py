"""What a run found, as records: outcome, verdict, checks, faults, advice, of which its first page is made."""

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Literal

import pandas as pd

from needlefit.inference.predict import Draws
from needlefit.metrics import METRICS, TE
from needlefit.project.locate import format_path

Status = Literal["none", "pass", "warn", "fail"]
#: from the best to the worst; "none" where nothing was tested, as of a prediction: it has no badge
STATUSES: tuple[Status, ...] = ("none", "pass", "warn", "fail")

MAX_NAMED_NEEDLES = 3  #: on any one of which a verdict hangs; of more their number is printed


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
    advice: str  #: what it found, a row of the table in `studies/advice.py`; "" where there is nothing to do

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


RESULTS = "reports"  #: the folder that holds the folders of results, unless a command states another


@dataclass(frozen=True)
class Advice:
    """What to do next."""

    finding: str  #: what it follows from: a row of the table in `studies/advice.py`
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
