"""A reconstruction recipe: what was scanned, and how needle, markers, entry and layers are found."""

from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from needlefit.schemas.base import FileRecord, Name, Record
from needlefit.schemas.limits import MAX_NEEDLE_DIAMETER_MM


class ScannedNeedleRecord(Record):
    """The needle that was scanned; diameter and bevel are also what the tip's edge model takes."""

    name: Name = ""
    length_mm: float = Field(default=150.0, gt=0)
    diameter_mm: float = Field(default=1.27, gt=0, le=MAX_NEEDLE_DIAMETER_MM)
    inner_diameter_mm: float = Field(default=0.0, ge=0)
    youngs_modulus_gpa: float = Field(default=80.0, gt=0)
    note: str = ""
    bevel_deg: float = Field(default=30.0, ge=10, le=90)
    bevel_sd_deg: float = Field(default=3.0, gt=0)


class SegmentationRecord(Record):
    """Which voxels are needle; thresholds left out are taken from the volume."""

    threshold_low_hu: float | None = None
    threshold_high_hu: float | None = None
    min_length_mm: float = Field(default=20.0, gt=0)
    min_elongation: float = Field(default=6.0, gt=1)
    max_widening: float = Field(default=2.5, ge=1)
    join_gap_mm: float = Field(default=15.0, ge=0)

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        low, high = self.threshold_low_hu, self.threshold_high_hu
        if low is not None and high is not None and low > high:
            raise ValueError("threshold_low_hu lies above threshold_high_hu")
        return self


class CenterlineRecord(Record):
    """How the axis is drawn, and which end is the tip."""

    station_spacing_mm: float = Field(default=0.5, ge=0.05, le=5)
    patch_width_mm: float = Field(default=2.4, ge=0.5, le=20)
    knot_spacing_mm: float = Field(default=15.0, ge=2, le=200)
    entry_direction: tuple[float, float, float] | None = None

    @model_validator(mode="after")
    def _directed(self) -> Self:
        if self.entry_direction is not None and not any(self.entry_direction):
            raise ValueError("entry_direction is zero: give the way from base to tip (LPS)")
        return self


class MarkersRecord(Record):
    """The radiopaque markers: balls of one diameter, and how well their places are known."""

    diameter_mm: float = Field(default=3.0, gt=0)
    threshold_hu: float | None = None
    reference_sd_mm: float = Field(default=0.1, gt=0)
    fiducial_sd_mm: float = Field(default=0.3, gt=0)


class ReconstructionEntryRecord(Record):
    """Entry pose and bending plane.

    `entry_shift_sd_mm`, `entry_tilt_sd_deg`: how far the tissue may move and turn the needle at the entry
    (standard deviations), where the pose comes from the shaft outside. `plane` is used where no bevel
    direction is stated.
    """

    entry_shift_sd_mm: float = Field(default=0.3, gt=0)
    entry_tilt_sd_deg: float = Field(default=2.0, gt=0)
    plane: Literal["bevel", "shape"] = "shape"


class LayersRecord(Record):
    """The layers' surfaces: how far one may lie from the boundary that it stands for."""

    surface_sd_mm: float = Field(default=0.1, ge=0)


class ReconstructionRecord(FileRecord):
    """`configs/reconstruction/<name>.toml`."""

    SCHEMA: ClassVar[int] = 2

    title: str = ""
    needle: ScannedNeedleRecord = ScannedNeedleRecord()
    segmentation: SegmentationRecord = SegmentationRecord()
    centerline: CenterlineRecord = CenterlineRecord()
    markers: MarkersRecord = MarkersRecord()
    entry: ReconstructionEntryRecord = ReconstructionEntryRecord()
    layers: LayersRecord = LayersRecord()
