"""Fit to some insertions and score the others: the paper's studies."""

from needlefit.schemas.run_metadata import FitMetadata
from needlefit.schemas.study import StudyRecord
from needlefit.studies.kind import StudyKind

KIND = StudyKind("cross_validation", StudyRecord, __name__, FitMetadata)
