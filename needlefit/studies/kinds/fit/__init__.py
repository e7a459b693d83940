"""A fit: a cross-validation that scores the insertions fitted to."""

from needlefit.schemas.run_metadata import FitMetadata
from needlefit.schemas.study import FitRecord
from needlefit.studies.kind import StudyKind

KIND = StudyKind("fit", FitRecord, "needlefit.studies.kinds.cross_validation", FitMetadata)
