"""Collect the credibility evidence of a run, in the order of ASME V&V 40-2018."""

from needlefit.studies.kind import StudyKind
from needlefit.studies.kinds.credibility.schema import CredibilityRecord

KIND = StudyKind("credibility", CredibilityRecord, __name__)
"""What `needlefit credibility` runs, or a study file."""
