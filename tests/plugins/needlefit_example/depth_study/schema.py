"""The study file of a depth study."""

from typing import Literal

from needlefit.schemas.analyses import AnalysisRecord


class DepthRecord(AnalysisRecord):
    """`studies/<name>.toml` with `kind = "depth_study"`."""

    kind: Literal["depth_study"]
    dataset: str
