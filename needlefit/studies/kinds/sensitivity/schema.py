"""The study file of a sensitivity study."""

from typing import Literal, Self

from pydantic import Field, model_validator

from needlefit.schemas.analyses import AnalysisRecord
from needlefit.schemas.base import Name, Record
from needlefit.schemas.limits import (
    MAX_CONSTRAINT_SPACING_MM,
    MAX_STARTS,
    MIN_ELEMENT_MM,
)


class VariationRecord(Record):
    """One change of the model, of the needle or of the data; keys that are left out stay."""

    factor: str
    """What is varied, in words."""
    name: Name
    """Name of the variation in tables."""
    constraint_switch: float | None = Field(default=None, ge=0, le=1)
    """Replaces `constraint_switch` of every tissue model."""
    tangent_part: float | None = Field(default=None, ge=0, le=1)
    """Replaces `tangent_part`."""
    constraint_spacing_mm: float | None = Field(default=None, ge=MIN_ELEMENT_MM, le=MAX_CONSTRAINT_SPACING_MM)
    """Replaces `constraint_spacing_mm`."""
    first_cell_mm: float | None = Field(default=None, gt=0)
    """Replaces `first_cell_mm`."""
    thickness_mm: float | None = Field(default=None, gt=0)
    """Replaces `thickness_mm`."""
    rigidity_factor: float | None = Field(default=None, gt=0)
    """Factor on the flexural rigidity EI."""
    inner_diameter_mm: float | None = Field(default=None, ge=0)
    """Makes the needle a tube."""
    boundary_shift_sd: float | None = None
    """Shifts all layer boundaries by this many standard deviations of each."""
    advance: Literal["path_angle"] | None = None
    """Replaces the rule of advance; the model is always fitted again."""

    @model_validator(mode="after")
    def _something(self) -> Self:
        if all(
            getattr(self, key) is None for key in type(self).model_fields if key not in ("factor", "name")
        ):
            raise ValueError(f"variation `{self.name}` changes nothing: give one of its keys")
        given = [key for key in ("constraint_switch", "tangent_part") if getattr(self, key) is not None]
        if self.advance and given:
            raise ValueError(f'variation `{self.name}`: leave out `{given[0]}` with advance = "path_angle"')
        return self


class SensitivityRecord(AnalysisRecord):
    """`kind = "sensitivity"`: studies under variations of the model, fitted again and with the parameters
    kept.
    """

    kind: Literal["sensitivity"]
    studies: tuple[str, ...] = Field(min_length=1)
    """Studies that are run under every variation."""
    fits: tuple[str, ...] = ()
    """Fits that are run under every variation."""
    starts: int = Field(default=4, ge=1, le=MAX_STARTS)
    """Random starting points beside the unvaried fit."""
    variations: tuple[VariationRecord, ...] = Field(min_length=1)
    """The variations."""
