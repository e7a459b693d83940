"""Choose the next insertion: which one would reduce the uncertainty most."""

from needlefit.studies.kind import StudyKind
from needlefit.studies.kinds.next_insertion.schema import NextInsertionRecord

KIND = StudyKind("next_insertion", NextInsertionRecord, __name__)
