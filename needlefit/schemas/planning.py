"""What a plan may choose, and what its needle must avoid, as study files state it."""

from typing import Self

from pydantic import Field, model_validator

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

    @property
    def ranges(self) -> dict[str, Range]:
        """The ranges of offset (mm), angle (degrees) and depth (mm)."""
        return {"offset": self.offset_mm, "angle": self.angle_deg, "depth": self.depth_mm}


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
