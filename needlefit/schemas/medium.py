"""A medium: its layers, which of their parameters are free, their bounds and their priors."""

import re
from typing import Literal, Self

from pydantic import Field, model_validator

from needlefit.schemas.base import FileRecord, Record
from needlefit.schemas.limits import MAX_LAYERS
from needlefit.schemas.scene import AdvanceRecord


class PriorRecord(Record):
    """A prior: of shape parameters of a law normal (`mean`, `sd`); of all others, which are positive,
    log-normal (`median`, `factor`), gamma (`mean`, `sd`) or half-normal (`sd`).
    """

    mean: float | None = None
    """Mean of a normal or gamma prior."""
    sd: float | None = Field(default=None, gt=0)
    """Standard deviation of a normal or gamma prior; without a mean, of the half-normal one's normal."""
    median: float | None = Field(default=None, gt=0)
    """Median of a log-normal prior, in the parameter's unit."""
    factor: float | None = Field(default=None, gt=1)
    """Spread of a log-normal prior: 2 means within a factor of 2 at one standard deviation."""
    correlation: float = Field(default=0.0, gt=-1, lt=1)
    """Correlation of ln mu with the alpha of the same layer, which then needs a prior too."""

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        given = {key for key in ("mean", "sd", "median", "factor") if getattr(self, key) is not None}
        if given not in ({"mean", "sd"}, {"median", "factor"}, {"sd"}):
            stated = ", ".join(sorted(given)) or "nothing"
            raise ValueError(
                "a prior is mean and sd (normal, or gamma), median and factor (log-normal), or sd "
                f"(half-normal); got {stated}"
            )
        return self


class MaterialRecord(FileRecord):
    """Priors of a layer, as from a compression test: `needlefit.write_prior` writes them."""

    title: str = ""
    """What was tested."""
    note: str = ""
    """Free text."""
    sha256: str = ""
    """Checksum of the measured table."""
    alpha: PriorRecord | None = None
    """Prior of alpha."""
    mu_pa: PriorRecord | None = None
    """Prior of the model's foundation modulus (not of the material's shear modulus)."""


class ParameterRecord(Record):
    """One parameter: exactly one of `bounds` (free), `fixed` and `tie`."""

    bounds: tuple[float, float] | None = None
    """Bounds of a free parameter, `[low, high]`, in the unit of its name."""
    fixed: float | None = None
    """Value of a parameter that is not estimated."""
    tie: str | None = None
    """Ties the parameter to another one: its name, or a multiple of it."""
    spread: float | None = Field(default=None, ge=1, le=100)
    """Factor, at one standard deviation, by which a tied modulus or length may differ; 1 is an exact
    tie. Without it 1.2 for a modulus that is tied to another one without a factor, else 1."""
    prior: PriorRecord | Literal["uniform"] | None = None
    """Prior of a free parameter; without one it is flat within the bounds (of the logarithm, except for
    shape parameters), by "uniform" flat in the parameter itself. A shape parameter with a prior is searched
    where it moves measured points, else drawn from its prior (docs/fitting.md)."""

    @model_validator(mode="after")
    def _exactly_one(self) -> Self:
        given = [k for k in ("bounds", "fixed", "tie") if getattr(self, k) is not None]
        if len(given) != 1:
            raise ValueError(f"give exactly one of bounds, fixed, tie; got {', '.join(given) or 'none'}")
        if self.bounds is not None and not self.bounds[0] < self.bounds[1]:
            raise ValueError(f"bounds must be [low, high] with low < high, got {list(self.bounds)}")
        if self.prior is not None and self.bounds is None:
            raise ValueError(f"a prior is for a free parameter, this one is {given[0]}: give bounds instead")
        if self.spread is not None and self.tie is None:
            raise ValueError("a spread is of a tie: give tie too, or leave the spread out")
        return self


class MediumRecord(FileRecord, AdvanceRecord):
    """`configs/media/<name>.toml`: a tissue model, its layers and parameters."""

    title: str = ""
    """What the medium is."""
    note: str = ""
    """Free text for readers of the file."""
    layers: int = Field(ge=1, le=MAX_LAYERS)
    """Number of layers."""
    law: str = "ogden"
    """Tissue law: ogden, another of docs/model.md, or one of a plugin."""
    thickness_mm: float = Field(default=40.0, gt=0)
    """Thickness h of the tissue that supports the needle on each side."""
    torsional_friction_n: float = Field(default=0.0, ge=0)
    """Torque per length (N mm / mm) that a turning shaft overcomes: the tip's roll stays behind the hub's. It
    is not fitted."""
    parameters: dict[str, ParameterRecord]
    """Parameters by name: `mu1_pa`, ... of each layer; shape parameters of the law, such as `alpha1`, free
    with their usual bounds and prior if left out; `bevel_mm` (with `advance = "path_angle"`:
    `cut_angle_deg`); optionally `guide_distance_mm`."""

    @property
    def bevel_parameter(self) -> str:
        """Name of the parameter that determines how strongly the bevel turns the cut."""
        return "cut_angle_deg" if self.advance == "path_angle" else "bevel_mm"


#: bounds of the bevel's parameter, in mm or degrees, where only a start is needed
BEVEL_BOUNDS: dict[str, tuple[float, float]] = {"bevel_mm": (1e-3, 1.0), "cut_angle_deg": (0.05, 44.0)}


_PRINTED_NAMES = {
    "b": "bevel_mm",
    "theta": "cut_angle_deg",
    "θ": "cut_angle_deg",
    "guide_distance": "guide_distance_mm",
}


def spell_parameter(name: str) -> str:
    """Return the key of a parameter that is given as tables print it: `mu1_pa` for mu1, `bevel_mm` for b."""
    return _PRINTED_NAMES.get(name, f"{name}_pa" if re.fullmatch(r"mu\d+", name) else name)


#: widest bounds of an angle (degrees) that takes the place of b
MIN_CUT_ANGLE_DEG, MAX_CUT_ANGLE_DEG = 0.01, 44.0
