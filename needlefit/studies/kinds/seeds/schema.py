"""The study file of a study on many synthetic data sets."""

from typing import Literal

from pydantic import Field

from needlefit.schemas.analyses import AnalysisRecord
from needlefit.schemas.limits import (
    MAX_REPLICATES,
    MAX_RESAMPLES,
    MAX_STARTS,
)


class SeedsRecord(AnalysisRecord):
    """`kind = "seeds"`: studies repeated on synthetic datasets of many seeds."""

    kind: Literal["seeds"]
    studies: tuple[str, ...] = Field(min_length=1)
    """Studies that are repeated."""
    fits: tuple[str, ...] = ()
    """Fits that are repeated."""
    generalization_studies: tuple[str, ...] = ()
    """Studies that, in the paper, generalise to their held-out insertions."""
    seeds: int = Field(default=20, ge=2, le=MAX_REPLICATES)
    """Number of synthetic datasets."""
    first_seed: int = Field(default=1, ge=0)
    """Seed of the first dataset; the others follow."""
    starts: int | None = Field(default=None, ge=1, le=MAX_STARTS)
    """Random starting points, in place of the recipe's."""
    resamples: int = Field(default=2000, ge=100, le=MAX_RESAMPLES)
    """Bootstrap resamples of the intervals."""
