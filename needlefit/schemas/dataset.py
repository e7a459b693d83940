"""Datasets: the files and columns of measured needle shapes or of tip tracks."""

from itertools import pairwise
from typing import Literal, Self

from pydantic import Field, model_validator

from needlefit.schemas.base import FileRecord, Name, Record, RigidRows
from needlefit.schemas.limits import MAX_LAYERS
from needlefit.schemas.scene import NeedleRecord

Scalar = str | float | int


class FrameRecord(Record):
    """What the coordinates mean.

    `pose = "known"`: world coordinates and an entry pose per insertion.
    `pose = "free"`: shapes known only up to a rigid motion; they are compared after alignment, by arc
    length from the tip, without the proximal `drop_proximal_mm`.
    `lps_to_world` is the rigid motion from the patient coordinates (LPS) of the scans to the world, rotation
    and shift (mm) side by side; without it the two are one.
    """

    name: Name = "world"
    pose: Literal["known", "free"] = "known"
    drop_proximal_mm: float = Field(default=0.0, ge=0)
    lps_to_world: RigidRows | None = None


MIN_SD_MM = 1e-6
"""Of a noise that is stated: covariances of less cannot be inverted."""


class NoiseRecord(Record):
    """What the data's makers state of their errors (all mm, 0: not known); they set the noise floor."""

    registration_mean_mm: float = Field(default=0.0, ge=0, le=1e3)
    point_sd_mm: float = Field(default=0.0, ge=0, le=1e3)
    correlated_sd_mm: float = Field(default=0.0, ge=0, le=1e3)
    correlation_length_mm: float = Field(default=5.0, gt=0, le=1e6)
    note: str = ""

    @model_validator(mode="after")
    def _large_enough(self) -> Self:
        for name in ("registration_mean_mm", "point_sd_mm", "correlated_sd_mm"):
            value = getattr(self, name)
            if 0 < value < MIN_SD_MM:
                raise ValueError(f"{name} is {value:g}: write 0 (not known), or at least {MIN_SD_MM:g}")
        return self


class InsertionsRecord(Record):
    """The table of insertions.

    Without `file`, insertions are the groups of the centreline table, named by `id_template` over the
    group columns. `columns` maps our names to columns, `constants` gives a value to every row.
    """

    file: str | None = None
    id_template: str | None = None
    columns: dict[str, str] = {}
    constants: dict[str, Scalar] = {}


class CenterlinesRecord(Record):
    """The centrelines: one file each (`pattern` with `{id}`), or one long table (`file`, `group_by`)."""

    pattern: str | None = None
    file: str | None = None
    group_by: tuple[str, ...] = ()
    columns: dict[str, str] = {}

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if (self.pattern is None) == (self.file is None):
            raise ValueError("give either pattern (one file per insertion) or file (one long table)")
        if self.pattern is not None and "{id}" not in self.pattern:
            raise ValueError("pattern must hold {id}, e.g. centerlines/{id}.csv")
        if (self.file is not None) != bool(self.group_by):
            raise ValueError(
                "file and group_by belong together: group_by names the columns that tell insertions apart"
            )
        return self


class SurfaceRecord(Record):
    """A boundary: crossing a `sheet` leads into layer `into`; a `solid` is layer `into` wherever it is.

    With `{id}` in `file` every insertion has a file of its own, as where layers were segmented in each scan.
    """

    file: str
    kind: Literal["sheet", "solid"]
    into: int = Field(ge=1, le=MAX_LAYERS)

    @property
    def own(self) -> bool:
        """Whether every insertion has a file of its own."""
        return "{id}" in self.file

    def file_of(self, id_: str) -> str:
        """Return the file for one insertion."""
        return self.file.replace("{id}", id_)


class DatasetMediumRecord(Record):
    """The layers of a medium: as surfaces, or as depths along the needle, the same for every insertion."""

    surfaces: tuple[SurfaceRecord, ...] = ()
    boundaries_mm: tuple[float, ...] | None = Field(default=None, max_length=MAX_LAYERS - 1)
    note: str = ""

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        depths = self.boundaries_mm
        if depths is not None and self.surfaces:
            raise ValueError("give either surfaces or boundaries_mm, not both")
        if depths and (depths[0] <= 0 or any(b <= a for a, b in pairwise(depths))):
            raise ValueError(f"boundaries_mm must be positive and increase, got {list(depths)}")
        return self


class SourceRecord(FileRecord):
    """What was measured, by whom, under what terms, and where it lies: the head of every `dataset.toml`."""

    name: Name
    title: str = ""
    origin: Literal["measured", "synthetic"]
    license: str
    source: str
    how_to_get: str = ""
    units: Literal["mm"] = "mm"
    root: str | None = None
    notes: str = ""


class DatasetRecord(SourceRecord):
    """`data/<name>/dataset.toml` of needles whose shapes were measured."""

    frame: FrameRecord = FrameRecord()
    needle: NeedleRecord
    noise: NoiseRecord = NoiseRecord()
    insertions: InsertionsRecord
    centerlines: CenterlinesRecord
    media: dict[Name, DatasetMediumRecord] = {}
    checksums: dict[str, str] = {}

    @model_validator(mode="after")
    def _has_insertions(self) -> Self:
        if self.insertions.file is None and self.centerlines.file is None:
            raise ValueError("without insertions.file the insertions must be the groups of centerlines.file")
        if self.insertions.file is None and self.insertions.id_template is None:
            raise ValueError("without insertions.file, insertions.id_template must name the insertions")
        if self.frame.pose == "free" and any(medium.surfaces for medium in self.media.values()):
            raise ValueError('surfaces stand in the world: with frame.pose = "free" give boundaries_mm')
        return self


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
