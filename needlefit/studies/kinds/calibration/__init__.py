"""Check by simulation that the computed uncertainty is right if the model is."""

from needlefit.studies.kind import StudyKind
from needlefit.studies.kinds.calibration.schema import CalibrationRecord

KIND = StudyKind("calibration", CalibrationRecord, __name__)
"""What `needlefit calibrate` runs, or a study file."""
