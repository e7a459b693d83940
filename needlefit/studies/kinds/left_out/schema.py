"""The study file of a study that leaves groups out."""

from typing import Literal

from pydantic import Field

from needlefit.schemas.analyses import AnalysisRecord


class LeftOutRecord(AnalysisRecord):
    """`kind = "left_out"`: leave-one-out cross-validation of several fits."""

    kind: Literal["left_out"]
    fits: tuple[str, ...] = Field(min_length=1)
    """Fits in `configs/fits/` whose insertions are left out in turn."""
    groups: tuple[Literal["insertion", "specimen"], ...] = ("insertion", "specimen")
    """What is left out together."""
