"""The study file of a planned insertion."""

import math
from typing import Literal, Self

from pydantic import Field, PositiveFloat, model_validator

from needlefit.schemas.analyses import TunedAnalysisRecord
from needlefit.schemas.base import Name, Record

Range = tuple[float, float]
PlanePoint = tuple[float, float]
Vector = tuple[float, float, float]


class EntryPlaneRecord(Record):
    """The plane of the plan, and the range of each choice in it."""

    position_mm: Vector = (0.0, 0.0, 0.0)
    """Origin of the plane, in the world."""
    direction: Vector = (1.0, 0.0, 0.0)
    """x of the plane, in the world."""
    across: Vector = (0.0, 1.0, 0.0)
    """y of the plane: the part of this vector normal to x."""
    offset_mm: Range
    """Range of the entry along y, `[low, high]`."""
    angle_deg: Range
    """Range of the angle from x toward y."""
    depth_mm: Range
    """Range of the insertion depth."""

    @model_validator(mode="after")
    def _ranges(self) -> Self:
        for name in ("offset_mm", "angle_deg", "depth_mm"):
            low, high = getattr(self, name)
            if not low < high:
                raise ValueError(f"{name} must be [low, high] with low < high, got [{low:g}, {high:g}]")
        return self


class ObstacleRecord(Record):
    """A circle in the plane that the needle must avoid."""

    name: Name
    """Name of the obstacle in tables."""
    centre_mm: PlanePoint
    """Centre of the circle, x and y in the plane."""
    radius_mm: float = Field(gt=0)
    """Radius."""
    margin_mm: float = Field(default=0.0, ge=0)
    """Smallest distance of the needle from the circle."""


class PlanRecord(TunedAnalysisRecord):
    """`kind = "plan"`: the entry that brings the predicted tip to a target."""

    kind: Literal["plan"]
    template_insertion: str
    """Insertion whose stated errors of entry, depth and layers the planned one would have."""
    target_mm: PlanePoint
    """Target, x and y in the plane."""
    tolerances_mm: tuple[PositiveFloat, ...] = Field(default=(1.0, 2.0), min_length=1)
    """Distances for which the probability of a hit is reported."""
    entry_plane: EntryPlaneRecord
    """The plane and what may be chosen in it."""
    obstacles: tuple[ObstacleRecord, ...] = ()
    """Circles that the needle must avoid."""
    specimen: Literal["new", "same"] | None = None
    """Whether the plan is for a specimen that was not fitted ("new") or one that was ("same"); without it,
    as the template."""

    @model_validator(mode="after")
    def _within_reach(self) -> Self:
        """Refuse what no needle of these depths reaches, however it bends."""
        (x, y), (low, high), deepest = (
            self.target_mm,
            self.entry_plane.offset_mm,
            self.entry_plane.depth_mm[1],
        )
        away = math.hypot(x, y - min(max(y, low), high))
        if x <= 0:
            raise ValueError(f"target_mm lies before the entrance, x = 0: x is {x:g} mm")
        if away > deepest + max(self.tolerances_mm):
            raise ValueError(
                f"target_mm is {away:.1f} mm from the nearest entry that offset_mm allows; depth_mm ends "
                f"at {deepest:g} mm"
            )
        return self
