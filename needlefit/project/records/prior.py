"""What is known of parameters before any needle is seen: beside a medium's bounds, or in a file."""

from typing import Self

from pydantic import Field, model_validator

from needlefit.project.records.record import FileRecord, Record


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
            said = ", ".join(sorted(given)) or "nothing"
            raise ValueError(f"a prior is mean and sd (normal), or median and factor (lognormal); got {said}")
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
