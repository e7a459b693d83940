"""Datasets: the files and columns of measured needle shapes or of tip tracks."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from needlefit.schemas.base import FileRecord, Name, Record, RigidRows
from needlefit.schemas.limits import MAX_LAYERS, MAX_SEED
from needlefit.schemas.origin import Origin
from needlefit.schemas.scene import NeedleRecord

Scalar = str | float | int


class FrameRecord(Record):
    """Coordinate frame of the measured points."""

    name: Name = "world"
    """Name of the coordinate frame."""
    pose: Literal["known", "free"] = "known"
    """"known": world coordinates, with an entry pose for each insertion. "free": shapes up to a rigid
    motion, aligned before they are compared."""
    drop_proximal_mm: float = Field(default=0.0, ge=0)
    """Length at the base that is not compared (`pose = "free"`)."""
    lps_to_world: RigidRows | None = None
    """Rigid motion from patient coordinates (LPS) to the world: rotation and shift (mm) side by side, three
    rows of four."""


#: usual SD of the slope of a tracker's frame (degrees), 0.2 rad: registrations err by less
SESSION_SLOPE_SD_DEG = 11.459
MIN_SD_MM = 1e-6  #: smallest SD (mm) of a stated noise: covariances of less cannot be inverted


class NoiseRecord(Record):
    """Measurement errors as the data's authors state them; they determine the noise floor."""

    registration_mean_mm: float = Field(default=0.0, ge=0, le=1e3)
    """Mean registration error; 0: not known."""
    point_sd_mm: float = Field(default=0.0, ge=0, le=1e3)
    """Standard deviation of the independent error of a point; 0: not known."""
    correlated_sd_mm: float = Field(default=0.0, ge=0, le=1e3)
    """Standard deviation of the error that neighbouring points share; 0: not known."""
    correlation_length_mm: float = Field(default=5.0, gt=0, le=1e6)
    """Length along the needle over which that error falls to 1/e."""
    heading_sd_deg: float = Field(default=0.0, ge=0, le=45)
    """Tip tracks: standard deviation of a heading; 0: headings are not used."""
    slope_sd_deg: float = Field(default=0.0, ge=0, le=45)
    """Tip tracks: spread of the slope of the tracker's frame between runs into one specimen, above 0."""
    session_slope_sd_deg: float = Field(default=SESSION_SLOPE_SD_DEG, gt=0, le=45)
    """Tip tracks: standard deviation of the slope that all runs into one specimen share, less where the
    direction of insertion is known in the tracker's frame."""
    note: str = ""
    """Where the numbers come from."""

    @model_validator(mode="after")
    def _large_enough(self) -> Self:
        for name in ("registration_mean_mm", "point_sd_mm", "correlated_sd_mm"):
            value = getattr(self, name)
            if 0 < value < MIN_SD_MM:
                raise ValueError(f"{name} is {value:g}: write 0 (not known), or at least {MIN_SD_MM:g}")
        return self


Operator = Literal["none", "spline", "gaussian", "unknown"]


class MeasurementRecord(Record):
    """Smoothing of the shapes before their points were stored (docs/inference.md). Each operator needs its
    own keys.
    """

    operator: Operator = "none"
    """What was done to the shape before its points were stored: nothing, a smoothing spline, a Gaussian
    mean, or an unknown smooth bias."""
    sections: str | None = None
    """spline: files of the cross-sections that it was drawn through, with `{id}`."""
    knot_spacing_mm: float | None = Field(default=None, ge=1, le=200)
    """spline, without `sections`: distance between its knots."""
    width_mm: float | None = Field(default=None, gt=0, le=100)
    """gaussian: standard deviation of its weights along the needle; at most a quarter of the length
    compared."""
    bias_sd_mm: float | None = Field(default=None, gt=0, le=10)
    """unknown: standard deviation of the bias, which all insertions share."""
    bias_length_mm: float | None = Field(default=None, ge=1, le=200)
    """unknown: length over which the bias changes."""
    note: str = ""
    """Free text."""

    @model_validator(mode="after")
    def _complete(self) -> Self:
        keys = ("sections", "knot_spacing_mm", "width_mm", "bias_sd_mm", "bias_length_mm")
        if tuple(key for key in keys if getattr(self, key) is not None) not in _OPERATOR_KEYS[self.operator]:
            wanted = " or ".join(map(" and ".join, _OPERATOR_KEYS[self.operator]))
            raise ValueError(f"operator {self.operator} needs {wanted or 'nothing'}, and no other key")
        if self.sections is not None and "{id}" not in self.sections:
            raise ValueError("sections must hold {id}, e.g. sections/{id}.toml")
        return self


_OPERATOR_KEYS: dict[Operator, tuple[tuple[str, ...], ...]] = {
    "none": ((),),
    "spline": (("sections",), ("knot_spacing_mm",)),
    "gaussian": (("width_mm",),),
    "unknown": (("bias_sd_mm", "bias_length_mm"),),
}

MIN_SECTIONS, MAX_SECTIONS = 8, 5000  #: smallest and largest number of cross-sections of one needle

Values = Annotated[tuple[float, ...], Field(min_length=MIN_SECTIONS, max_length=MAX_SECTIONS)]


class SectionsRecord(FileRecord):
    """`sections/<id>.toml`: cross-sections of one needle from base to tip, and the spline through them."""

    q_mm: Values
    """Parameter of the spline at each cross-section."""
    s_mm: Values
    """Arc length from first contact; negative outside the tissue."""
    points_mm: Annotated[
        tuple[tuple[float, float, float], ...], Field(min_length=MIN_SECTIONS, max_length=MAX_SECTIONS)
    ]
    """Points where the axis crosses the cross-sections, in the world."""
    weights: Values
    """Final weight of each cross-section in the spline."""
    knots_mm: Annotated[tuple[float, ...], Field(min_length=8, max_length=MAX_SECTIONS)]
    """Knots of the clamped cubic spline, in q."""
    sigma_mm: float = Field(ge=MIN_SD_MM, le=10)
    """Standard deviation of a cross-section of weight 1 in one direction across the needle."""
    shared_sd_mm: float = Field(default=0.0, ge=0, le=10)
    """Standard deviation of an error that neighbouring cross-sections share."""
    shared_along_mm: tuple[float, float, float] | None = None
    """What they share along one direction alone, as the normal of thick slices: that direction in the world,
    times its standard deviation."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if len({len(self.q_mm), len(self.s_mm), len(self.points_mm), len(self.weights)}) > 1:
            raise ValueError("q_mm, s_mm, points_mm and weights must be of one length")
        for name in ("q_mm", "s_mm"):
            if any(b <= a for a, b in pairwise(getattr(self, name))):
                raise ValueError(f"{name} must increase, from the base to the tip")
        knots = self.knots_mm
        if any(b < a for a, b in pairwise(knots)) or knots[0] != knots[3] or knots[-1] != knots[-4]:
            raise ValueError("knots_mm must not decrease, and begin and end with one value four times")
        if not knots[0] <= self.q_mm[0] < self.q_mm[-1] <= knots[-1]:
            raise ValueError("q_mm must lie between the first and the last of knots_mm")
        if min(self.weights) < 0:
            raise ValueError("weights must not be negative")
        if sum(weight > 0 for weight in self.weights) < len(knots) - 4:
            raise ValueError("fewer sections of positive weight than the spline has coefficients")
        return self


class InsertionsRecord(Record):
    """The table of insertions."""

    file: str | None = None
    """Table with one row for each insertion; without it, insertions are the groups of the centreline
    table."""
    id_template: str | None = None
    """Name of an insertion, made of the group columns: "{medium}-{run}"."""
    columns: dict[str, str] = {}
    """Names of needlefit's columns in your table, where they differ."""
    constants: dict[str, Scalar] = {}
    """Values that hold for every row, by column."""
    turns: str | None = None
    """Table of the bevel's turns during insertions, with columns id, depth_mm and bevel_roll_deg: from that
    depth on the bevel has that roll."""
    curvature: str | None = None
    """Table of curvatures along needles, as optical fibres measure them, with columns id, s_mm (from the
    tip), kappa_y_1_per_mm, kappa_z_1_per_mm and sd_1_per_mm."""


class CenterlinesRecord(Record):
    """The centrelines: one file each (`pattern`), or one long table (`file`, `group_by`)."""

    pattern: str | None = None
    """One file for each insertion, with `{id}` in its name."""
    file: str | None = None
    """One long table of all insertions."""
    group_by: tuple[str, ...] = ()
    """Columns of the long table that distinguish insertions."""
    columns: dict[str, str] = {}
    """Names of needlefit's columns in your table, where they differ."""

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if (self.pattern is None) == (self.file is None):
            raise ValueError("give either pattern (one file per insertion) or file (one long table)")
        if self.pattern is not None and "{id}" not in self.pattern:
            raise ValueError("pattern must hold {id}, e.g. centerlines/{id}.csv")
        if (self.file is not None) != bool(self.group_by):
            raise ValueError(
                "file and group_by belong together: group_by names the columns that distinguish insertions"
            )
        return self


class TipTracksRecord(Record):
    """The table of tracked tips, one row for each reading."""

    file: str
    """Table with one row for each reading."""
    columns: dict[str, str] = {}
    """Names of needlefit's columns in your table, where they differ."""
    constants: dict[str, Scalar] = {}
    """Values that hold for every row, by column."""
    depth_zero: Literal["first_reading", "tissue"] = "first_reading"
    """Where depths count from: each run's first reading (a stage), or the surface of the tissue."""


class SurfaceRecord(Record):
    """A boundary between layers, as a surface."""

    file: str
    """Surface (STL, PLY or OBJ); with `{id}`, one for each insertion."""
    kind: Literal["sheet", "solid"]
    """Crossing a "sheet" leads into layer `into`; the inside of a "solid" is layer `into`."""
    into: int = Field(ge=1, le=MAX_LAYERS)
    """Number of the layer."""

    @property
    def own(self) -> bool:
        """Whether every insertion has a file of its own."""
        return "{id}" in self.file

    def file_of(self, id_: str) -> str:
        """Return the file for one insertion."""
        return self.file.replace("{id}", id_)


class DatasetMediumRecord(Record):
    """Layers of a medium: as surfaces, or as depths along the needle."""

    surfaces: tuple[SurfaceRecord, ...] = ()
    """Boundaries between the layers, as surfaces."""
    boundaries_mm: tuple[float, ...] | None = Field(default=None, max_length=MAX_LAYERS - 1)
    """Depths of the boundaries along the needle, of every insertion whose row states none of its own."""
    layers: tuple[int, ...] = (1,)
    """Tip tracks: layers of the tissue model that are met, in their order; `[2]`: its second layer alone."""
    specimen: Name = ""
    """Tip tracks: specimen that was punctured, where several media are parts of one."""
    note: str = ""
    """Free text."""

    @property
    def sequence(self) -> tuple[int, ...]:
        """The layers that a track meets."""
        if self.layers != (1,):
            return self.layers
        return tuple(range(1, len(self.boundaries_mm or ()) + 2))

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        depths = self.boundaries_mm
        if depths is not None and self.surfaces:
            raise ValueError("give either surfaces or boundaries_mm, not both")
        if not self.layers or min(self.layers) < 1:
            raise ValueError(f"layers must name at least one layer, from 1, got {list(self.layers)}")
        if len(self.sequence) != len(depths or ()) + 1:
            raise ValueError(
                f"{len(self.layers)} layers have {len(self.layers) - 1} boundaries between them, "
                f"got boundaries_mm = {list(depths or ())}"
            )
        if depths is not None and (fault := boundaries_fault(depths)):
            raise ValueError(f"boundaries_mm {fault}")
        return self


def boundaries_fault(depths: Sequence[float]) -> str:
    """Return why depths, mm, cannot be those of boundaries; empty if they can."""
    if all(a < b for a, b in pairwise((0.0, *depths))):
        return ""
    return f"must be positive and increase, got {list(depths)}"


class ImportRecord(Record):
    """What a dataset was made from."""

    files: dict[str, str] = {}
    """SHA-256 of the imported files, by name."""
    confirmed: dict[str, str] = {}
    """What a person has confirmed of a scan, as `entry of SCAN`, and what was doubted."""
    mapping: str | None = None
    """File that states how they were read, and what was assumed (`needlefit explain mapping`)."""
    examples: tuple[Name, ...] = ()
    """Insertions that are simulated examples of the workbook, among others."""


class SourceRecord(FileRecord):
    """Origin of a dataset: the head of every `dataset.toml`."""

    name: Name
    """Name of the dataset."""
    title: str = ""
    """Heading in reports."""
    origin: Origin
    """Whether all needles were measured, or some are the `example` of the workbook, or otherwise simulated;
    reports state it."""
    license: str
    """Terms of use."""
    source: str
    """Who measured, where it is published."""
    truth_seed: int | None = Field(default=None, ge=0, le=MAX_SEED)
    """Of synthetic data: seed of `make_twin` (`studies/synthetic`), from which the true parameters follow."""
    truth_population: bool = False
    """Whether these were drawn from the population that `make_twin(..., population=True)` states."""
    truth: dict[str, float] = {}
    """Of other synthetic data: the true parameters by name, such as `mu1_pa`, in Pa and mm."""
    how_to_get: str = ""
    """How to obtain files that are not shipped."""
    units: Literal["mm"] = "mm"
    """Unit of all lengths."""
    root: str | None = None
    """Folder of the files, where it is not that of `dataset.toml`; `$NAME` stands for an environment
    variable."""
    notes: str = ""
    """Free text."""


NeedleName = Annotated[Name, Field(min_length=1)]


def _name_needles(needle: NeedleRecord, needles: dict[str, NeedleRecord]) -> dict[str, NeedleRecord]:
    """Return all needles; tables that state no name of their own name a needle by its key."""
    default = NeedleRecord.model_fields["name"].default
    named = {
        key: needle.model_copy(update={"name": key}) if needle.name == default else needle
        for key, needle in needles.items()
    }
    return {"": needle, **named}


class DatasetRecord(SourceRecord):
    """`data/<name>/dataset.toml`: insertions, measured as shapes, tips, curvatures or tip tracks."""

    frame: FrameRecord = FrameRecord()
    """Coordinates."""
    needle: NeedleRecord
    """The needle of every insertion whose cell of column `needle` is empty."""
    needles: dict[NeedleName, NeedleRecord] = {}
    """Further needles, by the name in column `needle`."""
    noise: NoiseRecord = NoiseRecord()
    """Measurement errors."""
    insertions: InsertionsRecord = InsertionsRecord()
    """Table of insertions, but for tip tracks."""
    tip_tracks: TipTracksRecord | None = None
    """Table of the readings of tip tracks."""
    centerlines: CenterlinesRecord | None = None
    """Measured shapes. Of an insertion without one, its tip (`tip_y_mm` of the table of insertions) or its
    curvatures are compared."""
    measurement: MeasurementRecord | None = None
    """Smoothing that the measurement did."""
    media: dict[Name, DatasetMediumRecord] = {}
    """Layers of each medium, by the name in column `medium`."""
    import_: ImportRecord | None = Field(default=None, alias="import")
    """Decisions of `needlefit import`, and what a person confirmed at `needlefit reconstruct`."""
    checksums: dict[str, str] = {}
    """SHA-256 of files, by path; `needlefit check` compares them."""

    @property
    def lists_insertions(self) -> bool:
        """Whether it has others than tip tracks."""
        return self.insertions.file is not None or self.centerlines is not None

    @property
    def all_needles(self) -> dict[str, NeedleRecord]:
        """The needles by what a cell of column `needle` holds; of an empty one `[needle]`."""
        return _name_needles(self.needle, self.needles)

    @model_validator(mode="after")
    def _has_insertions(self) -> Self:
        if self.tip_tracks is not None and not self.lists_insertions:
            return self
        if self.insertions.file is None and (self.centerlines is None or self.centerlines.file is None):
            raise ValueError("without insertions.file the insertions must be the groups of centerlines.file")
        if self.insertions.file is None and self.insertions.id_template is None:
            raise ValueError("without insertions.file, insertions.id_template must name the insertions")
        if self.frame.pose == "free" and self.centerlines is None:
            raise ValueError('tips and curvatures alone need the pose of their needle: frame.pose = "known"')
        if self.measurement is not None and self.centerlines is None:
            raise ValueError("[measurement] is of centrelines, and there are none")
        if self.frame.pose == "free" and any(medium.surfaces for medium in self.media.values()):
            raise ValueError('surfaces stand in the world: with frame.pose = "free" give boundaries_mm')
        if self.frame.pose == "free" and (self.insertions.turns or self.insertions.curvature):
            raise ValueError('turns and curvatures need the pose of their needle: frame.pose = "known"')
        if self.frame.pose == "free" and self.measurement is not None and self.measurement.sections:
            raise ValueError(
                'cross-sections stand in the world: with frame.pose = "free" give measurement.knot_spacing_mm'
            )
        return self


def needle_key(name: str) -> str:
    """Return the key of a needle in `dataset.toml`, by what a cell of column `needle` holds."""
    return f"needles.{name}" if name else "needle"
