"""Find which parameters the data determine."""

from needlefit.studies.kind import StudyKind
from needlefit.studies.kinds.identification.schema import IdentificationRecord

KIND = StudyKind("identification", IdentificationRecord, __name__)
"""What `needlefit identify` runs, or a study file."""
