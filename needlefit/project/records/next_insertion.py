"""Which insertion to make next: where it could enter, at what angle, how deep."""

from typing import Literal, Self

from pydantic import Field, model_validator

from needlefit.project.limits import MAX_CANDIDATES, MAX_LAYERS, MAX_NEEDLE_LENGTH_MM
from needlefit.project.records.record import Name, Record
from needlefit.project.records.tuned import TunedInquiryRecord

Vector = tuple[float, float, float]


class EntryRecord(Record):
    """A place at which candidates enter.

    `direction` is that of the needle at angle 0, `bending` the one across it that the bevel faces; both in
    the world, as `place_mm`. An angle turns the first toward the second. The layers met are those of the
    dataset's surfaces, along the planned path, unless `layers` lists them, with the depths between them in
    `boundaries_mm`: then place and angle tell nothing, and there is one angle.
    """

    name: Name
    place_mm: Vector = (0.0, 0.0, 0.0)
    direction: Vector = (1.0, 0.0, 0.0)
    bending: Vector = (0.0, 1.0, 0.0)
    angles_deg: tuple[float, ...] = Field(default=(0.0,), min_length=1, max_length=MAX_CANDIDATES)
    depths_mm: tuple[float, ...] | None = Field(default=None, max_length=MAX_CANDIDATES)
    layers: tuple[int, ...] | None = Field(default=None, max_length=MAX_LAYERS)
    boundaries_mm: tuple[float, ...] = ()

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
    """The tip's deflection of an insertion at an entry: what one may wish to know."""

    name: Name
    entry: str
    depth_mm: float = Field(gt=0, le=MAX_NEEDLE_LENGTH_MM)
    angle_deg: float = 0.0


class NextInsertionRecord(TunedInquiryRecord):
    """`studies/<name>.toml` with `kind = "next_insertion"`.

    `like` names the insertion whose errors of pose, depths and points a new one would have.
    """

    kind: Literal["next_insertion"]
    like: str
    depths_mm: tuple[float, ...] = Field(min_length=1, max_length=MAX_CANDIDATES)
    entries: tuple[EntryRecord, ...] = Field(min_length=1, max_length=MAX_CANDIDATES)
    quantities: tuple[QuantityRecord, ...] = ()

    @model_validator(mode="after")
    def _names(self) -> Self:
        names = [entry.name for entry in self.entries]
        if len(set(names)) < len(names):
            raise ValueError("two entries have one name")
        lost = [q.entry for q in self.quantities if q.entry not in names]
        if lost:
            raise ValueError(f"quantities name no entry: {', '.join(lost)}")
        return self
