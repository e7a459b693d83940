"""What stands at the head of a recording: the scene that was steered."""

from pydantic import Field

from needlefit.project.records.record import FileRecord
from needlefit.project.records.scene import SceneRecord


class RecordingRecord(FileRecord):
    """A scene, whole, and where its first constraint point lies.

    `needlefit` is the version that recorded it, `subject` what was opened (see `needlefit view`).
    """

    needlefit: str
    subject: str
    first_cell_mm: float = Field(gt=0)
    scene: SceneRecord
