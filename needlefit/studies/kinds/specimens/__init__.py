"""Estimate how much parameters vary between specimens."""

from needlefit.studies.kind import StudyKind
from needlefit.studies.kinds.specimens.schema import SpecimensRecord

KIND = StudyKind("specimens", SpecimensRecord, __name__)
