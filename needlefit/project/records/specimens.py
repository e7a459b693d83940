"""How much the specimens of one medium differ."""

from typing import Literal

from pydantic import Field, NonNegativeFloat

from needlefit.project.limits import MAX_REPLICATES
from needlefit.project.records.record import Record
from needlefit.project.records.tuned import TunedInquiryRecord


class RecoveryRecord(Record):
    """Specimens made up, of which the spread is known, to see whether it is found again.

    The insertions that the study selects are made anew into each of `specimens` specimens, with errors as the
    dataset states them. Free parameters vary between specimens by each of `spreads` in turn (standard
    deviation of the logarithm, of alpha itself) about `mean`; all of this `replicates` times.
    """

    specimens: int = Field(ge=3, le=MAX_REPLICATES)
    replicates: int = Field(ge=1, le=MAX_REPLICATES)
    spreads: tuple[NonNegativeFloat, ...] = Field(min_length=1)
    mean: dict[str, float]


class SpecimensRecord(TunedInquiryRecord):
    """`studies/<name>.toml` with `kind = "specimens"`.

    `groups` says what counts as a specimen, each in turn; `spread_prior_sd` is the standard deviation of the
    half-normal prior of a spread.
    """

    kind: Literal["specimens"]
    groups: tuple[Literal["specimen", "insertion"], ...] = ("specimen",)
    spread_prior_sd: float = Field(default=1.0, gt=0)
    recovery: RecoveryRecord | None = None
