"""Studies of tip tracks: fit to some runs, and predict others reading by reading."""

from needlefit.studies.kind import StudyKind
from needlefit.studies.kinds.tracks.schema import TrackStudyRecord

KIND = StudyKind("tracks", TrackStudyRecord, __name__)
