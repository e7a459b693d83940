"""The study file of a study that chooses the next insertion."""

from typing import Literal, Self

from pydantic import Field, model_validator

from needlefit.schemas.analyses import TunedAnalysisRecord
from needlefit.schemas.base import Name, Record
from needlefit.schemas.limits import MAX_CANDIDATES, MAX_LAYERS, MAX_NEEDLE_LENGTH_MM
from needlefit.schemas.planning import Vector


class CandidateEntryRecord(Record):
    """An entry position of candidate insertions."""

    name: Name
    """Name of the entry in tables."""
    position_mm: Vector = (0.0, 0.0, 0.0)
    """Position in the world."""
    direction: Vector = (1.0, 0.0, 0.0)
    """Direction of the needle at angle 0, in the world."""
    bending_direction: Vector = (0.0, 1.0, 0.0)
    """Direction across it that the bevel faces, in the world."""
    angles_deg: tuple[float, ...] = Field(default=(0.0,), min_length=1, max_length=MAX_CANDIDATES)
    """Candidate angles, from `direction` toward `bending_direction`."""
    depths_mm: tuple[float, ...] | None = Field(default=None, max_length=MAX_CANDIDATES)
    """Candidate depths at this entry, in place of those of the study."""
    layers: tuple[int, ...] | None = Field(default=None, max_length=MAX_LAYERS)
    """Layers that are met, in place of those of the dataset's surfaces; then there is one angle."""
    boundaries_mm: tuple[float, ...] = ()
    """Depths of the boundaries between `layers`."""

    @model_validator(mode="after")
    def _layers_whole(self) -> Self:
        if self.layers is None and self.boundaries_mm:
            raise ValueError("boundaries_mm parts the layers that `layers` lists; there are none")
        if self.layers is not None and len(self.layers) != len(self.boundaries_mm) + 1:
            raise ValueError("n layers are parted by n - 1 depths in boundaries_mm")
        if self.layers is not None and len(self.angles_deg) != 1:
            raise ValueError("angles need surfaces: with `layers` there is one, and it changes nothing")
        return self


class QuantityRecord(Record):
    """The tip deflection of an insertion, as a quantity of interest."""

    name: Name
    """Name of the quantity in tables."""
    entry: str
    """Entry of the insertion whose tip deflection is predicted."""
    depth_mm: float = Field(gt=0, le=MAX_NEEDLE_LENGTH_MM)
    """Its depth."""
    angle_deg: float = 0.0
    """Its angle."""


class NextInsertionRecord(TunedAnalysisRecord):
    """`kind = "next_insertion"`: the insertion with the largest expected information gain."""

    kind: Literal["next_insertion"]
    template_insertion: str
    """Insertion whose errors of pose, depths and points a new one would have."""
    depths_mm: tuple[float, ...] = Field(min_length=1, max_length=MAX_CANDIDATES)
    """Candidate depths."""
    entries: tuple[CandidateEntryRecord, ...] = Field(min_length=1, max_length=MAX_CANDIDATES)
    """Candidate entries."""
    quantities: tuple[QuantityRecord, ...] = ()
    """Tip deflections whose uncertainty is to be reduced; without it, the parameters'."""

    @model_validator(mode="after")
    def _names(self) -> Self:
        names = [entry.name for entry in self.entries]
        if len(set(names)) < len(names):
            raise ValueError("two entries have one name")
        lost = [q.entry for q in self.quantities if q.entry not in names]
        if lost:
            raise ValueError(f"quantities name no entry: {', '.join(lost)}")
        return self
