"""A dataset of tip tracks: where its readings stand, in which columns, and what the needle went into."""

from itertools import pairwise
from typing import Self

from pydantic import Field, model_validator

from needlefit.project.records.dataset import NoiseRecord, Scalar, SourceRecord
from needlefit.project.records.record import Name, Record
from needlefit.project.records.scene import NeedleRecord


class TipTracksRecord(Record):
    """`[tip_tracks]`: one long table, a row per reading.

    `columns` maps our names to columns, `constants` gives a value to every row.
    """

    file: str
    columns: dict[str, str] = {}
    constants: dict[str, Scalar] = {}


class TrackMediumRecord(Record):
    """`[media.<name>]`: the layers met, and at which depths the boundaries between them lie.

    `layers` are numbers of the medium's configuration, from the entry on: `[2]` is its second layer alone.
    `specimen` names the piece that was punctured, if several media are parts of one.
    """

    layers: tuple[int, ...] = (1,)
    boundaries_mm: tuple[float, ...] = ()
    specimen: Name = ""
    note: str = ""

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if not self.layers or min(self.layers) < 1:
            raise ValueError(f"layers must name at least one layer, from 1, got {list(self.layers)}")
        if len(self.boundaries_mm) != len(self.layers) - 1:
            raise ValueError(
                f"{len(self.layers)} layers have {len(self.layers) - 1} boundaries between them, "
                f"got boundaries_mm = {list(self.boundaries_mm)}"
            )
        if any(b <= a for a, b in pairwise((0.0, *self.boundaries_mm))):
            raise ValueError(f"boundaries_mm must be positive and increase, got {list(self.boundaries_mm)}")
        return self


class TrackDatasetRecord(SourceRecord):
    """`data/<name>/dataset.toml` of needles whose tips were tracked."""

    needle: NeedleRecord
    noise: NoiseRecord = NoiseRecord()
    tip_tracks: TipTracksRecord
    media: dict[Name, TrackMediumRecord] = Field(min_length=1)
    checksums: dict[str, str] = {}
