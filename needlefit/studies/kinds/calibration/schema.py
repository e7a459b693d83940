"""The study file of a calibration, or the options of `needlefit calibrate`."""

from typing import Literal, Self, get_args

from pydantic import Field, model_validator

from needlefit.schemas.analyses import TargetRecord
from needlefit.schemas.limits import MAX_REPLICATES

Control = Literal["sigma", "prior", "pose", "shuffled"]

CONTROLS: tuple[Control, ...] = get_args(Control)

TruthSource = Literal["prior", "synthetic"]

DEFAULT_REPLICATES, DEFAULT_SAMPLED_REPLICATES, DEFAULT_SYNTHETIC_REPLICATES = 500, 100, 50
"""By importance sampling, by MCMC, and of synthetic truths: about 20 minutes each on two cores."""


class CalibrationRecord(TargetRecord):
    """`kind = "calibration"`: are the uncertainties calibrated? Ranks of known true parameters in their
    posteriors.
    """

    kind: Literal["calibration"]
    replicates: int = Field(default=DEFAULT_REPLICATES, ge=1, le=MAX_REPLICATES)
    """Simulated datasets; default 500, with `sampled` 100, with `truth = "synthetic"` 50."""
    control: Control | None = None
    """Negative control: a part of the likelihood that is made wrong on purpose."""
    sampled: bool = False
    """Whether every posterior is sampled by MCMC (three insertions at most) in place of importance
    sampling."""
    truth: TruthSource = "prior"
    """True parameters from the prior, or synthetic datasets of a model that is not the fitted one."""
    ct: bool = False
    """Whether synthetic datasets are measured through simulated CT volumes."""

    @model_validator(mode="before")
    @classmethod
    def _set_default_replicates(cls, keys: object) -> object:
        if not isinstance(keys, dict) or "replicates" in keys:
            return keys
        count = DEFAULT_SAMPLED_REPLICATES if keys.get("sampled") is True else DEFAULT_REPLICATES
        synthetic = keys.get("truth") == "synthetic"
        return {**keys, "replicates": DEFAULT_SYNTHETIC_REPLICATES if synthetic else count}

    @model_validator(mode="after")
    def _check_truth(self) -> Self:
        if self.ct and self.truth != "synthetic":
            raise ValueError('ct = true needs truth = "synthetic": draws of the prior are not scanned')
        if self.truth == "synthetic" and (self.control or self.sampled):
            raise ValueError('control and sampled need truth = "prior": they test the computation')
        return self
