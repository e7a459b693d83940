"""The study file of a planned insertion."""

import math
from typing import Literal, Self

from pydantic import Field, PositiveFloat, model_validator

from needlefit.schemas.analyses import TunedAnalysisRecord
from needlefit.schemas.planning import EntryPlaneRecord, ObstacleRecord, PlanePoint


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
