"""Studies with a `kind`: adaptation, left_out, seeds, sensitivity, specimens and comparison.

Each kind of analysis is a record with its own keys; all share those of `AnalysisRecord`.
"""

from typing import Any, ClassVar, Literal, Self

from pydantic import Field, NonNegativeFloat, model_validator

from needlefit.schemas.base import FileRecord, Name, Record
from needlefit.schemas.dataset import NoiseRecord
from needlefit.schemas.limits import (
    MAX_CONSTRAINT_SPACING_MM,
    MAX_REPLICATES,
    MAX_RESAMPLES,
    MAX_STARTS,
    MIN_ELEMENT_MM,
)
from needlefit.schemas.scene import NeedleRecord
from needlefit.schemas.study import FitRecord, LayerCountRule, SelectionRecord


class AnalysisRecord(FileRecord):
    """`studies/<name>.toml` with `kind = "..."`; every kind is a record of its own, with its own keys.

    `same_specimen = true` says that insertions are held out whose specimens are fitted to, on purpose.
    """

    SCHEMA: ClassVar[int] = 2

    kind: Any
    title: str = ""
    question: str = ""
    note: str = ""
    same_specimen: bool = False


class TunedAnalysisRecord(AnalysisRecord):
    """The keys of a fit, as in `configs/fits/<name>.toml`, beside those of the question."""

    dataset: str
    medium: str
    recipe: str = "default"
    layer_count_rule: LayerCountRule = "listed"
    paper_parameters: str | None = None
    tune: SelectionRecord = Field(default=SelectionRecord())

    def tuning(self) -> FitRecord:
        """Return the fit that this analysis begins with."""
        keys = self.model_dump(by_alias=True, include=set(FitRecord.model_fields))
        return FitRecord.model_validate(keys)


class KnownMediumRecord(Record):
    """The medium that is fitted, and the insertions that there are into it."""

    medium: str
    insertions: SelectionRecord


class NewMediumRecord(KnownMediumRecord):
    """The same of what is new; `held_out` are the insertions that score, and never teach."""

    held_out: tuple[str, ...] = Field(min_length=1)


class BetweenMediaRecord(Record):
    """How far media differ: standard deviations of ln mu, ln b and alpha between them, and whence known."""

    ln_mu_sd: float = Field(ge=0)
    ln_bevel_sd: float = Field(ge=0)
    alpha_sd: float = Field(default=0.0, ge=0)
    source: str


class AdaptationRecord(AnalysisRecord):
    """`studies/<name>.toml` with `kind = "adaptation"`.

    Insertions of `new` that are not held out are learned from in `orders` random orders, the first n of each
    for every n of `counts` (without: every one). A curve is as good as a target from where on it stays within
    `margin_mm` of it.
    """

    kind: Literal["adaptation"]
    dataset: str
    recipe: str = "default"
    layer_count_rule: LayerCountRule = "listed"
    old: KnownMediumRecord
    new: NewMediumRecord
    between_media: BetweenMediaRecord
    orders: int = Field(default=6, ge=1, le=MAX_REPLICATES)
    counts: tuple[int, ...] | None = None
    margin_mm: float = Field(default=0.1, gt=0)


class LeftOutRecord(AnalysisRecord):
    """`studies/<name>.toml` with `kind = "left_out"`.

    `fits` names what is tuned, in `configs/fits/`; of each, every group of its insertions is left out in
    turn, and scored by a fit to the others. `groups` says what goes together.
    """

    kind: Literal["left_out"]
    fits: tuple[str, ...] = Field(min_length=1)
    groups: tuple[Literal["insertion", "specimen"], ...] = ("insertion", "specimen")


class SeedsRecord(AnalysisRecord):
    """`studies/<name>.toml` with `kind = "seeds"`.

    `studies` (in `studies/`) and `fits` (in `configs/fits/`) are carried out on `seeds` twins, of seeds
    `first_seed`, `first_seed` + 1, ...; `generalization_studies` names the studies that, in the paper,
    foretell what they hold out. `starts` replaces the recipe's. Intervals are of `resamples` bootstrap
    resamples.
    """

    kind: Literal["seeds"]
    studies: tuple[str, ...] = Field(min_length=1)
    fits: tuple[str, ...] = ()
    generalization_studies: tuple[str, ...] = ()
    seeds: int = Field(default=20, ge=2, le=MAX_REPLICATES)
    first_seed: int = Field(default=1, ge=0)
    starts: int | None = Field(default=None, ge=1, le=MAX_STARTS)
    resamples: int = Field(default=2000, ge=100, le=MAX_RESAMPLES)


class VariationRecord(Record):
    """One change of the model or of what it is given; `factor` says of what, `name` how; what is left out
    stays.

    `constraint_switch`, `tangent_part`, `constraint_spacing_mm`, `first_cell_mm` and `thickness_mm` replace
    those of every medium; `rigidity_factor` multiplies EI, `inner_diameter_mm` makes the needle a tube;
    `boundary_shift_sd` moves all layers by so many of their deviations at once.
    """

    factor: str
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
        if all(
            getattr(self, key) is None for key in type(self).model_fields if key not in ("factor", "name")
        ):
            raise ValueError(f"variation `{self.name}` changes nothing: give one of its keys")
        return self


class SensitivityRecord(AnalysisRecord):
    """`studies/<name>.toml` with `kind = "sensitivity"`.

    `studies` and `fits` are carried out as they stand, then under every variation: tuned again, from
    `starts` random starts and the fit as it stood, and with the parameters kept.
    """

    kind: Literal["sensitivity"]
    studies: tuple[str, ...] = Field(min_length=1)
    fits: tuple[str, ...] = ()
    starts: int = Field(default=4, ge=1, le=MAX_STARTS)
    variations: tuple[VariationRecord, ...] = Field(min_length=1)


class RecoveryRecord(Record):
    """Specimens made up, of which the spread is known, to see whether it is found again.

    The insertions that the study selects are made anew into each of `specimens` specimens, with errors as the
    dataset states them. Free parameters vary between specimens by each of `spreads` in turn (standard
    deviation of the logarithm, of alpha itself) about `mean`; all of this `replicates` times.
    """

    specimens: int = Field(ge=3, le=MAX_REPLICATES)
    replicates: int = Field(ge=1, le=MAX_REPLICATES)
    spreads: tuple[NonNegativeFloat, ...] = Field(min_length=1)
    mean: dict[str, float]


class SpecimensRecord(TunedAnalysisRecord):
    """`studies/<name>.toml` with `kind = "specimens"`.

    `groups` says what counts as a specimen, each in turn; `spread_prior_sd` is the standard deviation of the
    half-normal prior of a spread.
    """

    kind: Literal["specimens"]
    groups: tuple[Literal["specimen", "insertion"], ...] = ("specimen",)
    spread_prior_sd: float = Field(default=1.0, gt=0)
    recovery: RecoveryRecord | None = None


CandidateName = Literal[
    "ogden", "linear", "neo_hookean", "constant_curvature", "linear_curvature", "straight"
]


class SyntheticInsertionRecord(Record):
    """One insertion that is simulated; the base moves across once the needle is in."""

    depth_mm: float = Field(gt=0)
    side: Literal[1, -1] = 1
    base_moved_mm: float = 0.0


class SyntheticDataRecord(Record):
    """Data made for the study: the medium at these `values` (Pa, mm), needles, and errors of measurement."""

    title: str
    values: dict[str, float]
    needle: NeedleRecord
    noise: NoiseRecord
    pose_angle_sd_deg: float = Field(default=0.0, ge=0)
    depth_sd_mm: float = Field(default=0.0, ge=0)
    insertions: tuple[SyntheticInsertionRecord, ...] = Field(min_length=2)


class ComparisonRecord(AnalysisRecord):
    """`studies/<name>.toml` with `kind = "comparison"`.

    Every candidate is fitted to all folds but one and foretells that one, in turn. Laws of the tissue
    take the layers and bounds of `medium`; a law that does not use alpha has it fixed. `reference` is what
    the others are measured against. With `positive_control` the study is a positive control: unless the
    reference is ahead of every other candidate, the comparison itself is at fault.
    """

    kind: Literal["comparison"]
    dataset: str | None = None
    synthetic: SyntheticDataRecord | None = None
    medium: str
    recipe: str = "default"
    layer_count_rule: LayerCountRule = "listed"
    insertions: SelectionRecord = SelectionRecord()
    candidates: tuple[CandidateName, ...] = (
        "ogden",
        "linear",
        "neo_hookean",
        "linear_curvature",
        "constant_curvature",
        "straight",
    )
    reference: CandidateName = "ogden"
    folds: int = Field(default=4, ge=2)
    positive_control: bool = False

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if self.dataset is None and self.synthetic is None:
            raise ValueError("neither dataset nor [synthetic] is given: give one of them")
        if self.dataset is not None and self.synthetic is not None:
            raise ValueError("both dataset and [synthetic] are given: give one of them")
        if self.reference not in self.candidates:
            raise ValueError(f"the reference {self.reference} is not among the candidates")
        return self
