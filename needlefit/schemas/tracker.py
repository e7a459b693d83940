"""A navigation system that sends tip poses, and recordings of what it sent."""

import re
from typing import Annotated, ClassVar, Self

from pydantic import Field, NonNegativeFloat, PositiveFloat, model_validator

from needlefit.schemas.base import FileRecord, Name, Record, RigidRows, Row4, missing_key
from needlefit.schemas.recipe import BetweenSpecimensRecord
from needlefit.schemas.scene import SceneRecord

Point = tuple[float, float, float]

#: A device has so many characters in OpenIGTLink
DeviceName = Annotated[str, Field(min_length=1, max_length=20)]

MIN_MARKERS = 3  #: markers that determine a rigid registration

MAX_GUIDE_DEVICES = 8


class TrackerMarkerRecord(Record):
    """A marker whose position is known in both frames."""

    name: Name
    """Name of the marker."""
    tracker_mm: Point
    """Its position as the tracker measures it."""
    world_mm: Point
    """Its position in the world of the scene or dataset."""


class TrackerDevicesRecord(Record):
    """Names of the OpenIGTLink devices that are taken; the z axis of a transform points along the needle
    toward its tip.
    """

    tip: DeviceName = "Tip"
    """The needle's tip: depth, and readings for the estimate; its direction is not used."""
    base: DeviceName = "Base"
    """The needle's base: depth, lateral position and slope."""
    stage: DeviceName = "Stage"
    """The stage that carries the base: depth and lateral position, by its travel since its first message."""
    guides: tuple[DeviceName, ...] = Field(default=("Guide",), max_length=MAX_GUIDE_DEVICES)
    """The guides in the order of their numbers: position and slope."""

    @model_validator(mode="after")
    def _differ(self) -> Self:
        names = (self.tip, self.base, self.stage, *self.guides)
        if len(set(names)) < len(names):
            raise ValueError("has the same name twice: give every device its own")
        return self


class TrackerRecord(FileRecord):
    """`needlefit view --tracker FILE`: the registration of a tracker to the patient or phantom, and its
    errors.
    """

    title: str = ""
    """What the tracker is."""
    tracker_to_ras: tuple[Row4, Row4, Row4, Row4] | None = None
    """Registration: rigid motion from the tracker's frame to RAS, mm; the identity for transforms in RAS."""
    markers: tuple[TrackerMarkerRecord, ...] = ()
    """Registration by markers, instead of `tracker_to_ras`: three or more, not on a line."""
    server: str = ""
    """`HOST:PORT` of an OpenIGTLink server to connect to, such as PLUS; empty: senders connect here."""
    devices: TrackerDevicesRecord = TrackerDevicesRecord()
    """Names of devices."""
    tip_sd_mm: PositiveFloat = 0.5
    """Standard deviation of a tip reading across the needle."""
    depth_sd_mm: NonNegativeFloat = 0.5
    """Standard deviation of a tip reading along the needle."""
    shift_sd_mm: PositiveFloat = 0.5
    """Standard deviation of the registration: lateral shift at the entry, the same in all readings."""
    slope_sd: PositiveFloat = 0.01
    """Standard deviation of the registration: slope dy/dx to the entry axis."""
    max_age_s: float = Field(default=0.5, gt=0, le=60)
    """A transform that is older freezes the estimate."""
    max_speed_mm_s: float = Field(default=100.0, gt=0, le=10_000)
    """A device that moves faster has jumped, which freezes the estimate."""
    max_out_of_plane_mm: PositiveFloat = 5.0
    """A tip that is farther from the bending plane freezes the estimate."""
    prior: BetweenSpecimensRecord = BetweenSpecimensRecord()
    """Prior of a scene's moduli and b, as factors at one standard deviation; a run has that of its fit."""

    @model_validator(mode="after")
    def _registered(self) -> Self:
        if self.server and not re.fullmatch(r"\S+:\d{1,5}", self.server):
            raise ValueError(f"has server {self.server!r}: give HOST:PORT")
        if self.tracker_to_ras is None and not self.markers:
            raise missing_key("tracker_to_ras")
        if self.tracker_to_ras is not None and self.markers:
            raise ValueError("has tracker_to_ras and markers: give one of them")
        if self.markers and len(self.markers) < MIN_MARKERS:
            raise ValueError(f"has {len(self.markers)} markers: give {MIN_MARKERS} or more")
        return self


class PlacementRecord(Record):
    """Where a measured needle lies: rigid motions to the world of its dataset.

    `entry_to_world` is that of the constraint frame C, `lps_to_world` that of the patient coordinates (LPS)
    of its scan.
    """

    entry_to_world: RigidRows
    lps_to_world: RigidRows


class RecordingRecord(FileRecord):
    """A scene, whole, and where its first constraint point lies.

    `needlefit` is the version that recorded it, `target` what was opened (see `needlefit view`). Without a
    `placement` the scene says where the needle lies: in the plane z = 0 of its own world.
    """

    SCHEMA: ClassVar[int] = 2

    needlefit: str
    target: str
    first_cell_mm: float = Field(gt=0)
    placement: PlacementRecord | None = None
    scene: SceneRecord
