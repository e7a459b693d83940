"""The head of a recording of an interactive insertion, and where a measured needle lies."""

from typing import ClassVar

from pydantic import Field

from needlefit.schemas.base import FileRecord, Record, RigidRows
from needlefit.schemas.scene import SceneRecord


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
    `placement` the scene states where the needle lies: in the plane z = 0 of its own world.
    """

    SCHEMA: ClassVar[int] = 2

    needlefit: str
    target: str
    first_cell_mm: float = Field(gt=0)
    placement: PlacementRecord | None = None
    scene: SceneRecord
