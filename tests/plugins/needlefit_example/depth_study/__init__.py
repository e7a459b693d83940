"""A kind of study: how deep the insertions of a dataset go."""

from needlefit.studies.kind import StudyKind
from needlefit_example.depth_study.schema import DepthRecord

KIND = StudyKind("depth_study", DepthRecord, __name__)
