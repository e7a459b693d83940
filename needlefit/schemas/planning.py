"""What the needle of a plan must avoid."""

from pydantic import Field

from needlefit.schemas.base import Name, Record


class ObstacleRecord(Record):
    """A circle in the plane, or a sphere in space, that the needle must avoid."""

    name: Name
    """Name of the obstacle in tables."""
    centre_mm: tuple[float, float] | tuple[float, float, float]
    """Centre: x and y in the plane, in space z too."""
    radius_mm: float = Field(gt=0)
    """Radius."""
