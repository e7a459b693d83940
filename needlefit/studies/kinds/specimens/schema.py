"""The study file of a study of the spread between specimens."""

from typing import Literal

from pydantic import Field, NonNegativeFloat

from needlefit.schemas.analyses import TunedAnalysisRecord
from needlefit.schemas.base import Record
from needlefit.schemas.limits import (
    MAX_REPLICATES,
)


class RecoveryRecord(Record):
    """Simulated specimens with a known spread between them."""

    specimens: int = Field(ge=3, le=MAX_REPLICATES)
    """Simulated specimens."""
    replicates: int = Field(ge=1, le=MAX_REPLICATES)
    """Repetitions."""
    spreads: tuple[NonNegativeFloat, ...] = Field(min_length=1)
    """True spreads between specimens, each in turn (SD of the logarithm; of alpha itself)."""
    mean: dict[str, float]
    """Mean parameters of the specimens, by name."""


class SpecimensRecord(TunedAnalysisRecord):
    """`kind = "specimens"`: the spread of the parameters between specimens."""

    kind: Literal["specimens"]
    groups: tuple[Literal["specimen", "insertion"], ...] = ("specimen",)
    """What counts as a specimen, each in turn."""
    spread_prior_sd: float = Field(default=1.0, gt=0)
    """Standard deviation of the half-normal prior of a spread."""
    recovery: RecoveryRecord | None = None
    """Simulation study: is a known spread recovered?"""
