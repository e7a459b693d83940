"""Studies that plan: which insertion to make next, and where to enter to reach a target."""

import math
from typing import Literal, Self

from pydantic import Field, PositiveFloat, model_validator

from needlefit.schemas.analyses import TunedAnalysisRecord
from needlefit.schemas.base import Name, Record
from needlefit.schemas.limits import MAX_CANDIDATES, MAX_LAYERS, MAX_NEEDLE_LENGTH_MM

Range = tuple[float, float]
PlanePoint = tuple[float, float]
Vector = tuple[float, float, float]


class EntryPlaneRecord(Record):
    """The plane of the plan and what may be chosen in it, each within [low, high].

    `direction` is x of the plane, `across` (the part of it normal to x) its y, `position_mm` its origin; in
    the world. The needle enters at x = 0, y = offset, turned from x by the angle toward y.
    """

    position_mm: Vector = (0.0, 0.0, 0.0)
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
    centre_mm: PlanePoint
    radius_mm: float = Field(gt=0)
    margin_mm: float = Field(default=0.0, ge=0)


class PlanRecord(TunedAnalysisRecord):
    """`studies/<name>.toml` with `kind = "plan"`.

    `template_insertion` names the insertion whose stated errors of entry, depth and layers the planned one
    would have; `target_mm`, x and y, lies in the plane of `entry_plane`.
    """

    kind: Literal["plan"]
    template_insertion: str
    target_mm: PlanePoint
    tolerances_mm: tuple[PositiveFloat, ...] = Field(default=(1.0, 2.0), min_length=1)
    entry_plane: EntryPlaneRecord
    obstacles: tuple[ObstacleRecord, ...] = ()

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


class CandidateEntryRecord(Record):
    """A place at which candidates enter.

    `direction` is that of the needle at angle 0, `bending_direction` the one across it that the bevel faces;
    both in the world, as `position_mm`. An angle turns the first toward the second. The layers met are those
    of the dataset's surfaces, along the planned path, unless `layers` lists them, with the depths between
    them in `boundaries_mm`: then place and angle tell nothing, and there is one angle.
    """

    name: Name
    position_mm: Vector = (0.0, 0.0, 0.0)
    direction: Vector = (1.0, 0.0, 0.0)
    bending_direction: Vector = (0.0, 1.0, 0.0)
    angles_deg: tuple[float, ...] = Field(default=(0.0,), min_length=1, max_length=MAX_CANDIDATES)
    depths_mm: tuple[float, ...] | None = Field(default=None, max_length=MAX_CANDIDATES)
    layers: tuple[int, ...] | None = Field(default=None, max_length=MAX_LAYERS)
    boundaries_mm: tuple[float, ...] = ()

    @model_validator(mode="after")
    def _layers_whole(self) -> Self:
        if self.layers is None and self.boundaries_mm:
            raise ValueError("boundaries_mm parts the layers that `layers` lists; there are none")
        if self.layers is not None and len(self.layers) != len(self.boundaries_mm) + 1:
            raise ValueError("n layers are parted by n - 1 depths in boundaries_mm")
        if self.layers is not None and len(self.angles_deg) != 1:
            raise ValueError("angles need surfaces: with `layers` there is one, and it changes nothing")
        return self


class QuantityRecord(Record):
    """The tip's deflection of an insertion at an entry: what one may wish to know."""

    name: Name
    entry: str
    depth_mm: float = Field(gt=0, le=MAX_NEEDLE_LENGTH_MM)
    angle_deg: float = 0.0


class NextInsertionRecord(TunedAnalysisRecord):
    """`studies/<name>.toml` with `kind = "next_insertion"`.

    `template_insertion` names the insertion whose errors of pose, depths and points a new one would have.
    """

    kind: Literal["next_insertion"]
    template_insertion: str
    depths_mm: tuple[float, ...] = Field(min_length=1, max_length=MAX_CANDIDATES)
    entries: tuple[CandidateEntryRecord, ...] = Field(min_length=1, max_length=MAX_CANDIDATES)
    quantities: tuple[QuantityRecord, ...] = ()

    @model_validator(mode="after")
    def _names(self) -> Self:
        names = [entry.name for entry in self.entries]
        if len(set(names)) < len(names):
            raise ValueError("two entries have one name")
        lost = [q.entry for q in self.quantities if q.entry not in names]
        if lost:
            raise ValueError(f"quantities name no entry: {', '.join(lost)}")
        return self
