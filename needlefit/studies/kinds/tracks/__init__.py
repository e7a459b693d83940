"""Studies of tip tracks: fit to some runs, and predict others reading by reading."""

from needlefit.schemas.tracks import TrackStudyRecord
from needlefit.studies.kind import StudyKind

KIND = StudyKind("tracks", TrackStudyRecord, __name__)
