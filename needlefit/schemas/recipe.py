"""A recipe: how to search (starts, budget), what to minimise, how to sample."""

from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from needlefit.schemas.base import FileRecord, Record
from needlefit.schemas.limits import MAX_DENSITIES, MAX_EVALUATIONS, MAX_SEED, MAX_STARTS, MAX_WALKERS

ObjectiveName = Literal["posterior", "metric"]


class WeightsRecord(Record):
    """The error-minimising objective: a weighted mean over insertions of IPE, TE (mm) and EDP (mm per 100
    %).
    """

    ipe: float = Field(default=1.0, ge=0)
    """Weight of the in-plane error (IPE)."""
    te: float = Field(default=1.0, ge=0)
    """Weight of the tip error (TE)."""
    edp: float = Field(default=0.1, ge=0)
    """Weight of the error-to-deflection percentage (EDP), per 100 %."""
    edp_floor_mm: float = Field(default=0.2, gt=0)
    """Smallest deflection by which a tip error is divided."""

    @model_validator(mode="after")
    def _something(self) -> Self:
        if self.ipe == self.te == self.edp == 0:
            raise ValueError("ipe, te and edp are all 0: there is nothing to minimise")
        return self


class TrackErrorsRecord(Record):
    """Errors of tip tracks beside the noise that the dataset states; 0: none. A group of runs: those into
    one medium with the guide at rest, or with the guide moved.
    """

    gain_sd: float = Field(default=0.0, ge=0, le=1)
    """Relative standard deviation of the tip's response to each move of the guide."""
    carried_sd: float = Field(default=0.0, ge=0, le=1)
    """Standard deviation of the share of the guide's displacement that the tissue follows in a set-up."""
    slope_sd_deg: float = Field(default=0.0, ge=0, le=45)
    """Standard deviation of the slope of a group of runs in the tracker's frame, where the dataset states
    that of a run."""
    roll_sd_deg: float = Field(default=0.0, ge=0, le=45)
    """Of tips tracked in space: standard deviation of the bevel's roll in a run."""
    entry_sd_mm: float = Field(default=0.0, ge=0)
    """Standard deviation of the tip at first contact, where the tissue yields."""
    entry_yield: float = Field(default=0.0, ge=0)
    """The same as a part of the guide's move until then."""
    entry_length_mm: float = Field(default=10.0, gt=0)
    """Depth over which both fade by a factor of e."""

    @model_validator(mode="after")
    def _carried_with_gain(self) -> Self:
        if self.carried_sd and not self.gain_sd:
            raise ValueError(
                "carried_sd is given without gain_sd: the response to the guide is uncertain too"
            )
        return self


class LikelihoodRecord(Record):
    """How the likelihood treats the stated errors (docs/inference.md)."""

    noise: Literal["correlated", "independent"] = "correlated"
    """"correlated": neighbouring points share errors, and all points share those of the pose.
    "independent": every point errs by itself."""
    depths: Literal["fixed", "linear"] = "linear"
    """Errors of layer depths and insertion depth: ignored, or linearised."""
    measurement: Literal["stored", "points", "curvature"] = "stored"
    """"stored": the smoothing that the dataset states is applied to the simulation too. "points": stored
    points are compared as they are. "curvature": curvatures alone are compared, and no points."""
    noise_scale: Annotated[float, Field(gt=0)] | Literal["estimated"] = 1.0
    """Factor on the standard deviations of the points, or "estimated" with the parameters."""
    bevel_spread: float = Field(default=0.1, ge=0, le=1)
    """Standard deviation of the half-normal prior of the relative standard deviation of the bevel
    parameter (b or theta) between insertions; 0 gives all insertions the same."""
    tip_tracks: TrackErrorsRecord = TrackErrorsRecord()
    """Further errors of tip tracks."""


class SampleRecord(Record):
    """How `tune` samples: an ensemble of walkers, from draws by importance, until it has enough draws."""

    sampler: str = "emcee"
    """The sampler: emcee, another of `inference/sampling/samplers`, or one of a plugin."""
    walkers: int = Field(default=64, ge=8, le=MAX_WALKERS, multiple_of=2)
    """Walkers of the ensemble; at least twice the free parameters are taken."""
    independent_draws: int = Field(default=400, ge=1)
    """Independent draws of every parameter, of all walkers together, at which sampling ends."""
    densities: int = Field(default=20000, ge=1, le=MAX_DENSITIES)
    """Largest number of densities that are evaluated."""


class BetweenSpecimensRecord(Record):
    """Prior knowledge of how much specimens differ: half-normal priors of the spread of each parameter,
    a uniform one of their correlation, and a Gaussian factor of the spread of tips that these imply.
    """

    modulus_factor: float = Field(default=2.0, ge=1)
    """Factor by which moduli of two specimens differ, at one standard deviation."""
    bevel_factor: float = Field(default=1.8, ge=1)
    """The same of the bevel parameter (b or theta)."""
    tip_factor: float = Field(default=2.0, ge=1.01)
    """The same of the tip deflection, where the other two imply more: about 1.1 for specimens of one
    batch, 2 for tissue."""


class RecipeRecord(FileRecord):
    """`configs/recipes/<name>.toml`: how to search, what to minimise, how to sample."""

    SCHEMA: ClassVar[int] = 3

    title: str = ""
    """What the recipe is for."""
    preliminary: bool = False
    """Whether verdicts state that results of this recipe are preliminary."""
    minimize: ObjectiveName = "posterior"
    """Objective: the negative log posterior, or the weighted errors of `[weights]`."""
    metric: bool = False
    """Whether a second fit minimises the weighted errors; it is reported beside the first."""
    starts: int = Field(default=16, ge=1, le=MAX_STARTS)
    """Random starting points of the search."""
    seed: int = Field(default=1, ge=0, le=MAX_SEED)
    """Seed of all random numbers."""
    evaluations: int = Field(default=600, ge=1, le=MAX_EVALUATIONS)
    """Largest number of evaluations of one start, with or without derivatives."""
    tolerance: float = Field(default=1e-4, gt=0)
    """Relative tolerance of convergence."""
    weights: WeightsRecord = WeightsRecord()
    """Weights of the errors."""
    likelihood: LikelihoodRecord = LikelihoodRecord()
    """Options of the likelihood."""
    sample: SampleRecord = SampleRecord()
    """Options of the sampler."""
    specimens: BetweenSpecimensRecord = BetweenSpecimensRecord()
    """Prior of the spread between specimens."""
    aiming_width_mm: float = Field(default=2.0, gt=0)
    """Width of the 95 % interval of a tip up to which the checks of a result call it narrow enough."""
