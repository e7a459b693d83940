"""What steers a needle on its way: guides that stand in the world, and the steps of a scene."""

from typing import Literal, Self

from pydantic import Field, model_validator

from needlefit.project.limits import MAX_NEEDLE_LENGTH_MM
from needlefit.project.records.record import Record

NAME = r"^[A-Za-z][A-Za-z0-9_-]*$"
"""What a guide may be called: a bare TOML key that is no number."""


class GuideRecord(Record):
    """A guide or template: its place in the world, the direction of its axis, and whether that holds.

    Without `angle_deg` its axis is the insertion axis. `in_tissue` says that it stands behind the entry;
    `holds = false` that it is there but open, until a step closes it.
    """

    name: str = Field(pattern=NAME)
    x_mm: float
    y_mm: float
    angle_deg: float | None = None
    turns_freely: bool = False
    in_tissue: bool = False
    holds: bool = True


class GuideMoveRecord(Record):
    """What a step changes of a guide."""

    x_mm: float | None = None
    y_mm: float | None = None
    angle_deg: float | None = None
    turns_freely: bool | None = None
    in_tissue: bool | None = None
    holds: bool | None = None


class StepRecord(Record):
    """Where the tip goes next, and what changes before it does; what is not said stays as it was.

    A tracked tip is replaced as a whole: `tip_y_mm` without `tip_slope_deg` leaves its slope free.
    """

    depth_mm: float = Field(ge=0, le=MAX_NEEDLE_LENGTH_MM)
    offset_mm: float | None = Field(default=None, ge=0)
    side: Literal[1, -1] | None = None
    base_y_mm: float | None = None
    base_slope_deg: float | None = Field(default=None, gt=-45, lt=45)
    tip_y_mm: float | None = None
    tip_slope_deg: float | None = Field(default=None, gt=-45, lt=45)
    tip_free: bool = False
    guides: dict[str, GuideMoveRecord] = {}

    @model_validator(mode="after")
    def _one_tip(self) -> Self:
        check_tip(self.tip_y_mm, self.tip_slope_deg)
        if self.tip_free and self.tip_y_mm is not None:
            raise ValueError("tip_free = true lets go of the tip that tip_y_mm holds: give one of the two")
        return self


def check_tip(y_mm: float | None, slope_deg: float | None) -> None:
    """Raise ValueError if a tracked tip has a slope but no place."""
    if slope_deg is not None and y_mm is None:
        raise ValueError("tip_slope_deg needs tip_y_mm beside it: a tracked tip has a place first")
