"""What a model makes of insertions that its fit never saw: each left out in turn."""

from typing import Literal

from pydantic import Field

from needlefit.project.records.inquiry import InquiryRecord


class LeftOutRecord(InquiryRecord):
    """`studies/<name>.toml` with `kind = "left_out"`.

    `fits` names what is tuned, in `configs/fits/`; of each, every group of its insertions is left out in
    turn, and scored by a fit to the others. `groups` says what goes together.
    """

    kind: Literal["left_out"]
    fits: tuple[str, ...] = Field(min_length=1)
    groups: tuple[Literal["insertion", "specimen"], ...] = ("insertion", "specimen")
