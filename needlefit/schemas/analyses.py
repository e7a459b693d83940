"""The keys that studies with a `kind` share; the keys of each kind are in its folder."""

from typing import Any, ClassVar, Literal

from pydantic import Field

from needlefit.schemas.base import FileRecord, Record
from needlefit.schemas.dataset import NoiseRecord
from needlefit.schemas.scene import NeedleRecord


class QuestionRecord(FileRecord):
    """`studies/<name>.toml`: the keys that all studies but those of one fit share."""

    SCHEMA: ClassVar[int] = 2

    title: str = ""
    """Heading of the report."""
    question: str = ""
    """What the study answers; printed at the head of its report."""
    note: str = ""
    """Free text for readers of the file; it changes no result."""
    same_specimen: bool = False
    """Whether held-out insertions go on purpose into specimens that are fitted. Without it, that is a
    warning."""


class AnalysisRecord(QuestionRecord):
    """`studies/<name>.toml` with `kind = "..."`: the keys that all kinds share."""

    kind: Any
    """Kind of study."""


class TargetRecord(AnalysisRecord):
    """A study of the insertions that another study or fit is tuned on."""

    target: str
    """Study or fit whose insertions are analysed: its name, or the path of its file."""


class SyntheticInsertionRecord(Record):
    """One simulated insertion; the base moves across once the needle is in."""

    depth_mm: float = Field(gt=0)
    """Insertion depth."""
    side: Literal[1, -1] = 1
    """Side that the bevel faces: 1 toward y > 0, -1 toward y < 0."""
    base_moved_mm: float = 0.0
    """How far the base moves across after the insertion."""


class SyntheticDataRecord(Record):
    """Data simulated for the study: true parameters, needle, and measurement errors."""

    title: str
    """Name of the data in the report."""
    values: dict[str, float]
    """True parameters, by the names that the tissue model gives them."""
    needle: NeedleRecord
    """The needle that is simulated."""
    noise: NoiseRecord
    """Measurement errors that are added."""
    pose_angle_sd_deg: float = Field(default=0.0, ge=0)
    """Standard deviation of the error of the entry direction."""
    depth_sd_mm: float = Field(default=0.0, ge=0)
    """Standard deviation of the error of the insertion depth."""
    insertions: tuple[SyntheticInsertionRecord, ...] = Field(min_length=2)
    """The insertions, at least two."""
