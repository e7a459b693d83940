"""Repeat fits under changed assumptions and compare the results."""

from needlefit.studies.kind import StudyKind
from needlefit.studies.kinds.sensitivity.schema import SensitivityRecord

KIND = StudyKind("sensitivity", SensitivityRecord, __name__)
