"""A medium: its layers, which of their parameters are free, their bounds and their priors."""

from typing import Self

from pydantic import Field, model_validator

from needlefit.schemas.base import FileRecord, Record
from needlefit.schemas.limits import MAX_CONSTRAINT_SPACING_MM, MAX_LAYERS, MIN_ELEMENT_MM


class PriorRecord(Record):
    """Normal: `mean` and `sd` (alpha). Lognormal: `median`, and `factor`, its standard deviation (others).

    `factor = 2` reads: within a factor of 2 with the probability of one standard deviation. `correlation` is
    that of ln mu with the alpha of the same layer, whose prior must be given too.
    """

    mean: float | None = None
    sd: float | None = Field(default=None, gt=0)
    median: float | None = Field(default=None, gt=0)
    factor: float | None = Field(default=None, gt=1)
    correlation: float = Field(default=0.0, gt=-1, lt=1)

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        given = {key for key in ("mean", "sd", "median", "factor") if getattr(self, key) is not None}
        if given not in ({"mean", "sd"}, {"median", "factor"}):
            stated = ", ".join(sorted(given)) or "nothing"
            raise ValueError(
                f"a prior is mean and sd (normal), or median and factor (lognormal); got {stated}"
            )
        return self


class MaterialRecord(FileRecord):
    """`reports/material-<name>/prior.toml`: what a compression test says of a layer, for `priors` of a fit.

    `mu_pa` is of the model's foundation modulus, not of the material's shear modulus.
    """

    title: str = ""
    note: str = ""
    sha256: str = ""
    alpha: PriorRecord | None = None
    mu_pa: PriorRecord | None = None


class ParameterRecord(Record):
    """One parameter: free within `bounds`, `fixed`, or tied to another one (`"mu1_pa"`, `"10 * mu1_pa"`).

    A free one may have a `prior`; without, it is flat within the bounds (of the logarithm, but for alpha).
    """

    bounds: tuple[float, float] | None = None
    fixed: float | None = None
    tie: str | None = None
    prior: PriorRecord | None = None

    @model_validator(mode="after")
    def _exactly_one(self) -> Self:
        given = [k for k in ("bounds", "fixed", "tie") if getattr(self, k) is not None]
        if len(given) != 1:
            raise ValueError(f"give exactly one of bounds, fixed, tie; got {', '.join(given) or 'none'}")
        if self.bounds is not None and not self.bounds[0] < self.bounds[1]:
            raise ValueError(f"bounds must be [low, high] with low < high, got {list(self.bounds)}")
        if self.prior is not None and self.bounds is None:
            raise ValueError(f"a prior is for a free parameter, this one is {given[0]}: give bounds instead")
        return self


class MediumRecord(FileRecord):
    """`configs/media/<name>.toml`: the model of one medium, as a table of parameters by name.

    Names: `mu1_pa`, `alpha1`, ... one pair per layer, `bevel_mm`, and optionally `guide_distance_mm`.
    `constraint_switch`, `tangent_part` and `first_cell_mm` are options of the model (`ModelOptions`)
    that are decided; other values are for studies of how much they matter.
    """

    title: str = ""
    note: str = ""
    layers: int = Field(ge=1, le=MAX_LAYERS)
    law: str = "ogden"
    thickness_mm: float = Field(default=40.0, gt=0)
    constraint_spacing_mm: float = Field(default=1.0, ge=MIN_ELEMENT_MM, le=MAX_CONSTRAINT_SPACING_MM)
    constraint_switch: float = Field(default=0.5, ge=0, le=1)
    tangent_part: float = Field(default=1.0, ge=0, le=1)
    first_cell_mm: float | None = Field(default=None, gt=0)
    parameters: dict[str, ParameterRecord]
