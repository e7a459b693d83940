"""What stands at the head of a recording: the scene that was steered, and where a measured one lies."""

from pydantic import Field

from needlefit.project.records.record import FileRecord, Record
from needlefit.project.records.rigid import RigidRows
from needlefit.project.records.scene import SceneRecord


class PlacementRecord(Record):
    """Where a measured needle lies: rigid motions to the world of its dataset.

    `entry_to_world` is that of the constraint frame C, `lps_to_world` that of the patient coordinates (LPS)
    of its scan.
    """

    entry_to_world: RigidRows
    lps_to_world: RigidRows


class RecordingRecord(FileRecord):
    """A scene, whole, and where its first constraint point lies.

    `needlefit` is the version that recorded it, `subject` what was opened (see `needlefit view`). Without a
    `placement` the scene says where the needle lies: in the plane z = 0 of its own world.
    """

    needlefit: str
    subject: str
    first_cell_mm: float = Field(gt=0)
    placement: PlacementRecord | None = None
    scene: SceneRecord
