"""A kind of study: how deep the insertions of a dataset go."""

from typing import Literal

from needlefit.schemas.study import AnalysisRecord
from needlefit.studies.kind import StudyKind


class DepthRecord(AnalysisRecord):
    """`studies/<name>.toml` with `kind = "depth_study"`."""

    kind: Literal["depth_study"]
    dataset: str


KIND = StudyKind("depth_study", DepthRecord, f"{__name__}.study")
