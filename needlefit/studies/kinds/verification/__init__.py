"""Measure whether the solver solves the model rightly, and report it."""

from needlefit.studies.kind import StudyKind
from needlefit.studies.kinds.verification.schema import VerificationRecord

KIND = StudyKind("verification", VerificationRecord, __name__)
"""What `needlefit verify` runs, or a study file."""
