"""A recipe: how to search (algorithm, starts, budget), what to minimise, how to sample."""

from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from needlefit.schemas.base import FileRecord, Record
from needlefit.schemas.limits import (
    MAX_ENSEMBLES,
    MAX_EVALUATIONS,
    MAX_SEED,
    MAX_STARTS,
    MAX_STORED_DRAWS,
    MAX_WALKERS,
)

ObjectiveName = Literal["posterior", "metric"]


class WeightsRecord(Record):
    """The metric objective: a weighted mean over insertions of IPE, TE (both mm) and EDP (mm per 100 %)."""

    ipe: float = Field(default=1.0, ge=0)
    te: float = Field(default=1.0, ge=0)
    edp: float = Field(default=0.1, ge=0)
    edp_floor_mm: float = Field(default=0.2, gt=0)

    @model_validator(mode="after")
    def _something(self) -> Self:
        if self.ipe == self.te == self.edp == 0:
            raise ValueError("ipe, te and edp are all 0: there is nothing to minimise")
        return self


class LikelihoodRecord(Record):
    """What the likelihood makes of the stated errors; docs/inference.md says how.

    `noise`: errors of neighbouring points and of the pose are shared by points ("correlated"), or every point
    errs by itself, as much in all ("independent").
    `depths`: errors of layer and insertion depths are ignored ("fixed"), act linearly, or as they do.
    `noise_scale` multiplies the deviations of noise and pose: a number, or "estimated" beside the parameters.
    """

    noise: Literal["correlated", "independent"] = "correlated"
    depths: Literal["fixed", "linear", "quadrature"] = "linear"
    noise_scale: Annotated[float, Field(gt=0)] | Literal["estimated"] = 1.0


class SampleRecord(Record):
    """How to sample: several independent ensembles of walkers, moved until they agree.

    `steps` is the most that each ensemble takes; after every `check_interval` steps the run is kept, and the
    rule of convergence is asked. `moves` are independent, stretch, de, snooker, or several: "de+snooker",
    "0.9*de + 0.1*snooker".
    """

    ensembles: int = Field(default=4, ge=1, le=MAX_ENSEMBLES)
    walkers: int = Field(default=16, ge=8, le=MAX_WALKERS)
    moves: str = "0.6*independent + 0.3*de + 0.1*stretch"
    steps: int = Field(default=20000, ge=2)
    check_interval: int = Field(default=50, ge=2)

    @model_validator(mode="after")
    def _fits_in_memory(self) -> Self:
        draws = self.ensembles * self.walkers * self.steps
        if draws > MAX_STORED_DRAWS:
            raise ValueError(
                f"ensembles x walkers x steps is {draws}: at most {MAX_STORED_DRAWS} draws are kept in memory"
            )
        return self


class RecipeRecord(FileRecord):
    """`configs/recipes/<name>.toml`.

    `minimize` says what the fit is: the negative log posterior, or the metric objective of `weights`.
    `metric` adds a second fit, of the metric objective by `metric_algorithm`, reported beside the first.
    With `approach` starts first go down a posterior that is easier, by least squares, and those that meet
    there go on as one. `evaluations` limits each start; one with derivatives counts as one, as does one
    without.
    """

    SCHEMA: ClassVar[int] = 2

    title: str = ""
    minimize: ObjectiveName = "posterior"
    algorithm: str = "leastsquares"
    metric: bool = False
    metric_algorithm: str = "bobyqa+neldermead"
    starts: int = Field(default=16, ge=1, le=MAX_STARTS)
    approach: bool = True
    seed: int = Field(default=1, ge=0, le=MAX_SEED)
    evaluations: int = Field(default=600, ge=1, le=MAX_EVALUATIONS)
    tolerance: float = Field(default=1e-4, gt=0)
    weights: WeightsRecord = WeightsRecord()
    likelihood: LikelihoodRecord = LikelihoodRecord()
    sample: SampleRecord = SampleRecord()
