"""How many insertions into a new specimen a model of another one needs."""

from typing import Literal

from pydantic import Field

from needlefit.project.limits import MAX_REPLICATES
from needlefit.project.records.fit import Reading, SelectionRecord
from needlefit.project.records.inquiry import InquiryRecord
from needlefit.project.records.record import Record


class SideRecord(Record):
    """The medium that is fitted, and the insertions that there are into it."""

    medium: str
    insertions: SelectionRecord


class NewSideRecord(SideRecord):
    """The same of what is new; `held_out` are the insertions that score, and never teach."""

    held_out: tuple[str, ...] = Field(min_length=1)


class BetweenRecord(Record):
    """How far media differ: standard deviations of ln mu, ln b and alpha between them, and whence known."""

    ln_mu_sd: float = Field(ge=0)
    ln_bevel_sd: float = Field(ge=0)
    alpha_sd: float = Field(default=0.0, ge=0)
    source: str


class AdaptationRecord(InquiryRecord):
    """`studies/<name>.toml` with `kind = "adaptation"`.

    Insertions of `new` that are not held out are learned from in `orders` random orders, the first n of each
    for every n of `counts` (without: every one). A curve is as good as a target from where on it stays within
    `margin_mm` of it.
    """

    kind: Literal["adaptation"]
    dataset: str
    recipe: str = "default"
    reading: Reading = "listed"
    old: SideRecord
    new: NewSideRecord
    between: BetweenRecord
    orders: int = Field(default=6, ge=1, le=MAX_REPLICATES)
    counts: tuple[int, ...] | None = None
    margin_mm: float = Field(default=0.1, gt=0)
