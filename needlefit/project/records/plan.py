"""Where and how to enter so that the tip comes to a target."""

import math
from typing import Literal, Self

from pydantic import Field, PositiveFloat, model_validator

from needlefit.project.records.record import Name, Record
from needlefit.project.records.tuned import TunedInquiryRecord

Range = tuple[float, float]
Point = tuple[float, float]
Vector = tuple[float, float, float]


class EntranceRecord(Record):
    """The plane of the plan and what may be chosen in it, each within [low, high].

    `direction` is x of the plane, `across` (the part of it normal to x) its y, `place_mm` its origin; in the
    world. The needle enters at x = 0, y = offset, turned from x by the angle toward y.
    """

    place_mm: Vector = (0.0, 0.0, 0.0)
    direction: Vector = (1.0, 0.0, 0.0)
    across: Vector = (0.0, 1.0, 0.0)
    offset_mm: Range
    angle_deg: Range
    depth_mm: Range

    @model_validator(mode="after")
    def _ranges(self) -> Self:
        for name in ("offset_mm", "angle_deg", "depth_mm"):
            low, high = getattr(self, name)
            if not low < high:
                raise ValueError(f"{name} must be [low, high] with low < high, got [{low:g}, {high:g}]")
        return self


class ObstacleRecord(Record):
    """A circle in the plane that the needle shall pass by, with `margin_mm` to spare."""

    name: Name
    centre_mm: Point
    radius_mm: float = Field(gt=0)
    margin_mm: float = Field(default=0.0, ge=0)


class PlanRecord(TunedInquiryRecord):
    """`studies/<name>.toml` with `kind = "plan"`.

    `like` names the insertion whose stated errors of entry, depth and layers the planned one would have;
    `target_mm`, x and y, lies in the plane of `entrance`.
    """

    kind: Literal["plan"]
    like: str
    target_mm: Point
    tolerances_mm: tuple[PositiveFloat, ...] = Field(default=(1.0, 2.0), min_length=1)
    entrance: EntranceRecord
    obstacles: tuple[ObstacleRecord, ...] = ()

    @model_validator(mode="after")
    def _within_reach(self) -> Self:
        """Refuse what no needle of these depths reaches, however it bends."""
        (x, y), (low, high), deepest = self.target_mm, self.entrance.offset_mm, self.entrance.depth_mm[1]
        away = math.hypot(x, y - min(max(y, low), high))
        if x <= 0:
            raise ValueError(f"target_mm lies before the entrance, x = 0: x is {x:g} mm")
        if away > deepest + max(self.tolerances_mm):
            raise ValueError(
                f"target_mm is {away:.1f} mm from the nearest entry that offset_mm allows; depth_mm ends "
                f"at {deepest:g} mm"
            )
        return self
