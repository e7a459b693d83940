"""Fit one tissue model to each specimen of many datasets."""

from needlefit.studies.kind import StudyKind
from needlefit.studies.kinds.cohort.schema import CohortRecord

KIND = StudyKind("cohort", CohortRecord, __name__)
