"""Leave groups of insertions out in turn and score the fit to the others."""

from needlefit.studies.kind import StudyKind
from needlefit.studies.kinds.left_out.schema import LeftOutRecord

KIND = StudyKind("left_out", LeftOutRecord, __name__)
