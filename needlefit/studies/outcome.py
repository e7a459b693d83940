"""What a judgement says: its outcome, from which status, check and advice follow wherever it is reported."""

from enum import StrEnum

from needlefit.studies.answer import Status


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

    @property
    def is_tested(self) -> bool:
        """Whether it is of a test of several trials."""
        return self in (self.GENERALISES, self.NOT_SHOWN, self.DOES_NOT_GENERALISE)
