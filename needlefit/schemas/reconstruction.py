"""A reconstruction recipe: what was scanned, and how needle, markers, entry and layers are found."""

from typing import ClassVar, Self

from pydantic import Field, model_validator

from needlefit.schemas.base import FileRecord, Name, Record
from needlefit.schemas.limits import MAX_NEEDLE_DIAMETER_MM


class ScannedNeedleRecord(Record):
    """The needle that was scanned."""

    name: Name = ""
    """Name of the needle."""
    length_mm: float = Field(default=150.0, gt=0)
    """Length from the base to the tip."""
    diameter_mm: float = Field(default=1.27, gt=0, le=MAX_NEEDLE_DIAMETER_MM)
    """Outer diameter."""
    inner_diameter_mm: float = Field(default=0.0, ge=0)
    """Inner diameter; 0 for a solid needle."""
    youngs_modulus_gpa: float = Field(default=80.0, gt=0)
    """Young's modulus."""
    note: str = ""
    """Free text."""
    bevel_deg: float = Field(default=30.0, ge=10, le=90)
    """Angle of the bevel's face to the axis."""
    bevel_sd_deg: float = Field(default=3.0, gt=0)
    """Standard deviation of that angle."""


class CenterlineRecord(Record):
    """Which end of the axis is the tip."""

    entry_direction: tuple[float, float, float] | None = None
    """Direction from base to tip (LPS), where it cannot be derived from the scan."""
    placed_tip_sd_mm: float = Field(default=0.3, gt=0)
    """Standard deviation, along the needle, of a tip placed by hand."""

    @model_validator(mode="after")
    def _directed(self) -> Self:
        if self.entry_direction is not None and not any(self.entry_direction):
            raise ValueError("entry_direction is zero: give the way from base to tip (LPS)")
        return self


class MarkersRecord(Record):
    """Radiopaque markers: spheres of one diameter."""

    diameter_mm: float = Field(default=3.0, gt=0)
    """Diameter of the marker spheres."""
    threshold_hu: float | None = None
    """Threshold; without it, taken from the volume."""
    max_misfit: float = Field(default=0.15, gt=0, le=1)
    """Largest misfit of the model of a ball, besides noise, in parts of the ball's brightness."""
    reference_sd_mm: float = Field(default=0.1, gt=0)
    """Standard deviation of the markers' stated positions."""
    fiducial_sd_mm: float = Field(default=0.3, gt=0)
    """Standard deviation of the markers' positions in the scan."""


class ReconstructionEntryRecord(Record):
    """Entry pose."""

    entry_shift_sd_mm: float = Field(default=0.3, gt=0)
    """Standard deviation of the shift of the needle at the entry against its straight shaft outside."""
    entry_tilt_sd_deg: float = Field(default=2.0, gt=0)
    """Standard deviation of its tilt there."""
    placed_contact_sd_mm: float = Field(default=0.3, gt=0)
    """Standard deviation, along the needle, of a first contact placed by hand."""


class GuidePlateRecord(Record):
    """A plate, template or wall of any material through which the needle is guided to the tissue."""

    thickness_mm: float | None = Field(default=None, ge=0)
    """Its thickness along the needle; 0: there is none. Asked for where soft material begins twice, or begins
    with what is no soft tissue; a scan that does not show it is refused."""


class LayersRecord(Record):
    """Surfaces of the layers."""

    surface_sd_mm: float = Field(default=0.1, ge=0)
    """Standard deviation of a surface's distance from the true boundary."""


class ReconstructionRecord(FileRecord):
    """`configs/reconstruction/<name>.toml`: how needles are found in scans."""

    SCHEMA: ClassVar[int] = 2

    title: str = ""
    """What the recipe is for."""
    needle: ScannedNeedleRecord = ScannedNeedleRecord()
    """The needle that was scanned; diameter and bevel also enter the model of the tip's edge."""
    centerline: CenterlineRecord = CenterlineRecord()
    """Which end of the axis is the tip."""
    markers: MarkersRecord = MarkersRecord()
    """Radiopaque markers."""
    entry: ReconstructionEntryRecord = ReconstructionEntryRecord()
    """Entry pose."""
    guide: GuidePlateRecord = GuidePlateRecord()
    """What guides the needle to the tissue."""
    layers: LayersRecord = LayersRecord()
    """Surfaces of the layers."""
