"""How much every table depends on what was decided or is not known well: rules, thickness, needle, depths."""

from typing import Literal, Self

from pydantic import Field, model_validator

from needlefit.project.limits import MAX_CONSTRAINT_SPACING_MM, MAX_STARTS, MIN_ELEMENT_MM
from needlefit.project.records.inquiry import InquiryRecord
from needlefit.project.records.record import Name, Record


class VariationRecord(Record):
    """One change of the model or of what it is given; `of` says of what, `name` how; what is left out stays.

    `constraint_switch`, `tangent_part`, `constraint_spacing_mm`, `first_cell_mm` and `thickness_mm` replace
    those of every medium; `rigidity_factor` multiplies EI, `inner_diameter_mm` makes the needle a tube;
    `boundary_shift_sd` moves all layers by so many of their deviations at once.
    """

    of: str
    name: Name
    constraint_switch: float | None = Field(default=None, ge=0, le=1)
    tangent_part: float | None = Field(default=None, ge=0, le=1)
    constraint_spacing_mm: float | None = Field(default=None, ge=MIN_ELEMENT_MM, le=MAX_CONSTRAINT_SPACING_MM)
    first_cell_mm: float | None = Field(default=None, gt=0)
    thickness_mm: float | None = Field(default=None, gt=0)
    rigidity_factor: float | None = Field(default=None, gt=0)
    inner_diameter_mm: float | None = Field(default=None, ge=0)
    boundary_shift_sd: float | None = None

    @model_validator(mode="after")
    def _something(self) -> Self:
        if all(getattr(self, key) is None for key in type(self).model_fields if key not in ("of", "name")):
            raise ValueError(f"variation `{self.name}` changes nothing: give one of its keys")
        return self


class SensitivityRecord(InquiryRecord):
    """`studies/<name>.toml` with `kind = "sensitivity"`.

    `studies` and `fits` are carried out as they stand, then under every variation: tuned again, from
    `starts` random starts and the fit as it stood, and with the parameters kept.
    """

    kind: Literal["sensitivity"]
    studies: tuple[str, ...] = Field(min_length=1)
    fits: tuple[str, ...] = ()
    starts: int = Field(default=4, ge=1, le=MAX_STARTS)
    variations: tuple[VariationRecord, ...] = Field(min_length=1)
