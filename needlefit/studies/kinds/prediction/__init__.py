"""Predict insertions from the posterior draws of a run."""

from needlefit.studies.kind import StudyKind
from needlefit.studies.kinds.prediction.schema import PredictionRecord

KIND = StudyKind("prediction", PredictionRecord, __name__)
"""What `needlefit predict` runs, or a study file."""
