"""The studies on many twins: how every cell of the paper's tables is distributed over seeds."""

from typing import Literal

from pydantic import Field

from needlefit.project.limits import MAX_REPLICATES, MAX_RESAMPLES, MAX_STARTS
from needlefit.project.records.inquiry import InquiryRecord


class SeedsRecord(InquiryRecord):
    """`studies/<name>.toml` with `kind = "seeds"`.

    `studies` (in `studies/`) and `fits` (in `configs/fits/`) are carried out on `seeds` twins, of seeds
    `first`, `first` + 1, ...; `generalising` names the studies that, in the paper, foretell what they hold
    out. `starts` replaces the recipe's. Intervals are of `resamples` bootstrap resamples.
    """

    kind: Literal["seeds"]
    studies: tuple[str, ...] = Field(min_length=1)
    fits: tuple[str, ...] = ()
    generalising: tuple[str, ...] = ()
    seeds: int = Field(default=20, ge=2, le=MAX_REPLICATES)
    first: int = Field(default=1, ge=0)
    starts: int | None = Field(default=None, ge=1, le=MAX_STARTS)
    resamples: int = Field(default=2000, ge=100, le=MAX_RESAMPLES)
