"""The study file of an adaptation study."""

from typing import Literal

from pydantic import Field

from needlefit.schemas.analyses import AnalysisRecord
from needlefit.schemas.base import Record
from needlefit.schemas.limits import (
    MAX_REPLICATES,
)
from needlefit.schemas.study import LayerCountRule, SelectionRecord


class KnownMediumRecord(Record):
    """A medium and the insertions into it."""

    medium: str
    """Name of the tissue model."""
    insertions: SelectionRecord
    """Insertions into it."""


class NewMediumRecord(KnownMediumRecord):
    """The new medium, its insertions, and those that are held out."""

    held_out: tuple[str, ...] = Field(min_length=1)
    """Insertions, by id, that are predicted and never fitted."""


class BetweenMediaRecord(Record):
    """How far the parameters of two media differ."""

    ln_mu_sd: float = Field(ge=0)
    """Standard deviation of ln mu between media."""
    ln_bevel_sd: float = Field(ge=0)
    """Standard deviation of the logarithm of the bevel parameter (b or θ) between media."""
    alpha_sd: float = Field(default=0.0, ge=0)
    """Standard deviation of alpha between media."""
    source: str
    """Where these numbers come from."""


class AdaptationRecord(AnalysisRecord):
    """`kind = "adaptation"`: how many insertions a new medium needs, with and without the posterior of an
    earlier one.
    """

    kind: Literal["adaptation"]
    dataset: str
    """Name of a dataset in `data/`, or the path of its folder."""
    recipe: str = "default"
    """Name of a recipe in `configs/recipes/`, or the path of its file."""
    layer_count_rule: LayerCountRule = "listed"
    """Number of layers of an insertion that ends at a boundary: as its row lists it, or the other count."""
    old: KnownMediumRecord
    """The medium whose posterior is the prior of the new one."""
    new: NewMediumRecord
    """The new medium."""
    between_media: BetweenMediaRecord
    """How far media differ."""
    orders: int = Field(default=6, ge=1, le=MAX_REPLICATES)
    """Random orders in which the new insertions are added."""
    counts: tuple[int, ...] | None = None
    """Numbers of insertions that are fitted; without it, every number."""
    margin_mm: float = Field(default=0.1, gt=0)
    """Two errors within this margin count as equal."""
