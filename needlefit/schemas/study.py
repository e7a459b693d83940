"""Fits and studies: which insertions (or tip tracks) are tuned on, and which are scored."""

from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from needlefit.schemas.base import FileName, FileRecord, Record

LayerCountRule = Literal["listed", "alternative"]


class SelectionRecord(Record):
    """Which insertions of the dataset: every given key must match; no key at all takes every insertion."""

    medium: str | None = None
    layers: tuple[int, ...] | None = None
    specimens: tuple[str, ...] | None = None
    insertions: tuple[str, ...] | None = None
    depth_min_mm: float | None = None
    depth_max_mm: float | None = None


class FitRecord(FileRecord):
    """`configs/fits/<name>.toml`.

    `layer_count_rule` decides an insertion that ends at a boundary: as its row lists it, or the other way.
    `priors` gives layers, by number, what a compression test says of them: a file that `needlefit material`
    wrote, as in `{ 1 = "reports/material-gel/prior.toml" }`.
    `paper_parameters` names a row of the paper's parameter table to stand beside the fit (never a start).
    """

    SCHEMA: ClassVar[int] = 2

    title: str = ""
    note: str = ""
    dataset: str
    medium: str
    recipe: str = "default"
    layer_count_rule: LayerCountRule = "listed"
    paper_parameters: str | None = None
    priors: dict[str, str] = {}
    tune: SelectionRecord = Field(default=SelectionRecord())


class StudyRecord(FitRecord):
    """`studies/<name>.toml`: a fit, and what is validated with it.

    Either `validate` lists selections to score, or `leave_out` names what is left out in turn
    (each insertion or specimen of `tune` is scored by a fit to the others).
    `same_specimen = true` says that held-out insertions go into specimens of the tuning on purpose: without,
    that is a warning. `paper_study` is the row of the paper's validation table to stand beside the result.
    """

    question: str = ""
    paper_study: int | None = Field(default=None, ge=1, le=5)
    validate_: tuple[SelectionRecord, ...] = Field(default=(), alias="validate")
    leave_out: Literal["insertion", "specimen"] | None = None
    same_specimen: bool = False

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if bool(self.validate_) == (self.leave_out is not None):
            raise ValueError("a study has either [[validate]] selections or leave_out, exactly one of them")
        return self

    def tuning(self) -> FitRecord:
        """Return the fit that this study begins with."""
        return FitRecord.model_validate(self.model_dump(by_alias=True, include=set(FitRecord.model_fields)))


class TrackSelectionRecord(Record):
    """Which runs of the dataset: every given key must match; `guided` says whether the guide moved."""

    media: tuple[str, ...] = ()
    runs: tuple[str, ...] = ()
    guided: bool | None = None


class TrackFitRecord(Record):
    """One fit, of the runs that `tune` selects, and the runs that are predicted from it."""

    name: FileName
    medium: str
    tune: TrackSelectionRecord
    validate_: TrackSelectionRecord = Field(alias="validate")


class TrackStudyRecord(FileRecord):
    """`studies/<name>.toml` with `observable = "tip tracks"`.

    `registration_depth_mm` is the depth up to which a predicted run's own readings determine how it lies in
    the tracker's frame; the deeper ones are scored. `same_specimen = true` says that predicted runs go into
    specimens that are fitted to, on purpose.
    """

    SCHEMA: ClassVar[int] = 2

    observable: Literal["tip tracks"]
    title: str = ""
    question: str = ""
    note: str = ""
    dataset: str
    recipe: str = "default"
    registration_depth_mm: float = Field(gt=0)
    same_specimen: bool = False
    fits: tuple[TrackFitRecord, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _named_apart(self) -> Self:
        names = [fit.name for fit in self.fits]
        if len(set(names)) < len(names):
            raise ValueError(f"every one of [[fits]] needs a name of its own, got {', '.join(names)}")
        return self
