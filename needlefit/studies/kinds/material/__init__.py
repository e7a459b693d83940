"""Fit a tissue law to a compression test."""

from needlefit.studies.kind import StudyKind
from needlefit.studies.kinds.material.schema import CompressionRecord

KIND = StudyKind("material", CompressionRecord, __name__)
"""What `needlefit material` runs, or a study file."""
