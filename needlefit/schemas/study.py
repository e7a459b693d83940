"""Fits and studies: which insertions (or tip tracks) are tuned on, and which are scored.

Studies with a `kind` share some keys; those of one kind are in its folder.
"""

from typing import Any, ClassVar, Literal, Self

from pydantic import Field, field_validator, model_validator

from needlefit.schemas.base import Compared, FileName, FileRecord, Record
from needlefit.schemas.medium import spell_parameter

LayerCountRule = Literal["listed", "alternative"]


class SelectionRecord(Record):
    """Insertions of the dataset that match every given key; without keys, all insertions."""

    medium: str | tuple[str, ...] | None = None
    """Insertions into this medium, or into one of these, as the dataset names them."""
    layers: tuple[int, ...] | None = None
    """Insertions through these numbers of layers: `[2, 3]` takes those through two or three."""
    specimens: tuple[str, ...] | None = None
    """Insertions into these specimens."""
    insertions: tuple[str, ...] | None = None
    """These insertions, by id."""
    depth_min_mm: float | None = None
    """Insertions at least this deep."""
    depth_max_mm: float | None = None
    """Insertions at most this deep."""
    guided: bool | None = None
    """Tip tracks whose guide moved (`true`) or stayed at rest (`false`)."""


class FitRecord(FileRecord):
    """`configs/fits/<name>.toml`: insertions that are fitted, with a tissue model and a recipe."""

    SCHEMA: ClassVar[int] = 2
    KIND: ClassVar[str] = "fit"

    title: str = ""
    """Heading of the report."""
    note: str = ""
    """Free text for readers of the file; it changes no result."""
    dataset: str
    """Name of a dataset in `data/`, or the path of its folder, relative to this file."""
    medium: str
    """Name of a tissue model in `configs/media/`, or the path of its file."""
    recipe: str = "default"
    """Name of a recipe in `configs/recipes/`, or the path of its file."""
    layer_count_rule: LayerCountRule = "listed"
    """Number of layers of an insertion that ends at a boundary: as its row lists it, or the other count."""
    paper_parameters: str | None = None
    """Row of the paper's parameter table that is reported beside the fit. The search never starts there."""
    priors: dict[str, str] = {}
    """Measured priors by number of layer: files that `needlefit.write_prior` wrote."""
    free: tuple[str, ...] = ()
    """Parameters that are searched although the tissue model fixes or ties them, or their posterior is
    their prior: `["alpha1"]`, or `["alpha"]` of every layer. Their bounds are in docs/fitting.md."""
    fix: dict[str, float] = {}
    """Parameters that are held at a value (Pa, mm, degrees): `{ alpha1 = 2.0 }`."""
    compared: Compared | None = None
    """Where needles are simulated and compared: in the "plane" of x and the bevel at contact, or in "space".
    Without it, in space if any needle was turned out of its plane, or left it by more than its errors."""
    tune: SelectionRecord = Field(default=SelectionRecord())
    """Insertions that are fitted."""
    specimens: Literal["others", "training only"] = "others"
    """Parameters differ between specimens ("others"), or are the same in all ("training only", as in the
    paper)."""
    margin_mm: float | None = Field(default=None, gt=0)
    """Difference of mean tip errors that does not matter, in a comparison of one fit with a straight line and
    constant curvature. Without it, the noise floor of the tip error."""
    margin_for: str = ""
    """What that margin is for, such as a biopsy of lesions of 5 mm; printed with it."""
    same_specimen: bool = False
    """Whether predicted insertions go on purpose into specimens that are fitted. Without it, that is a
    warning of a study, and `needlefit predict` predicts a new specimen."""

    @field_validator("free")
    @classmethod
    def _spell_free(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(dict.fromkeys(map(spell_parameter, names)))

    @field_validator("fix")
    @classmethod
    def _spell_fixed(cls, values: dict[str, float]) -> dict[str, float]:
        return {spell_parameter(name): value for name, value in values.items()}

    @model_validator(mode="after")
    def _free_or_fixed(self) -> Self:
        both = [name for name in self.free if name in self.fix]
        if both:
            raise ValueError(f"{', '.join(both)} cannot be in `free` and in `fix`")
        return self

    @model_validator(mode="after")
    def _margin_with_purpose(self) -> Self:
        if (self.margin_mm is None) != (not self.margin_for):
            raise ValueError("`margin_mm` and `margin_for`, what it is for, need each other")
        return self


class FoldsRecord(Record):
    """Insertions that are fitted, and some that are predicted by fits to all others of them."""

    name: FileName
    """Name of the fit in tables and files; with `parts`, NAME-1, NAME-2 and so on."""
    tune: SelectionRecord = SelectionRecord()
    """Insertions that are fitted."""
    validate_: SelectionRecord = Field(alias="validate")
    """Insertions that are predicted; they are not fitted to."""
    parts: int | None = Field(default=None, ge=2)
    """Groups into which those of `validate` are divided, as many as insertions at most; each is predicted by
    a fit to all others."""


class StudyRecord(FitRecord):
    """`studies/<name>.toml`: a fit and its validation, by `[[validate]]`, `leave_out` or `[[folds]]`."""

    KIND: ClassVar[str] = "cross_validation"

    question: str = ""
    """What the study answers; printed at the head of its report."""
    paper_study: int | None = Field(default=None, ge=1, le=5)
    """Row of the paper's validation table that is printed beside the result."""
    validate_: tuple[SelectionRecord, ...] = Field(default=(), alias="validate")
    """Held-out insertions: one `[[validate]]` table for each group that is scored by itself."""
    leave_out: Literal["insertion", "specimen"] | None = None
    """Cross-validation in place of `[[validate]]`: every insertion or specimen of `tune` is predicted by a
    fit to the others."""
    folds: tuple[FoldsRecord, ...] = ()
    """Cross-validation with a selection of its own for each fit, in place of `tune`."""
    registration_depth_mm: float | None = Field(default=None, gt=0)
    """Tip tracks: depth up to which a predicted run's own readings place it in the tracker's frame; deeper
    ones are scored."""

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        ways = (bool(self.validate_), self.leave_out is not None, bool(self.folds))
        if sum(ways) != 1:
            raise ValueError(
                "a study has [[validate]] selections, leave_out or [[folds]], exactly one of them"
            )
        if self.folds and self.tune != SelectionRecord():
            raise ValueError("each of [[folds]] has its own tune: remove that of the study")
        names = [fold.name for fold in self.folds]
        if len(set(names)) < len(names):
            raise ValueError(f"every one of [[folds]] needs a name of its own, got {', '.join(names)}")
        return self

    def tuning(self, folds: FoldsRecord | None = None) -> FitRecord:
        """Return the fit that this study, or one of its folds, begins with."""
        table = self.model_dump(by_alias=True, include=set(FitRecord.model_fields))
        part = "fit to all insertions" if self.leave_out else ""
        if folds is not None:
            part, table["tune"] = folds.name, folds.tune.model_dump()
        if self.title and part:
            table["title"] = f"{self.title}: {part}"
        return FitRecord.model_validate(table)


# ---- studies with a `kind`


class QuestionRecord(FileRecord):
    """`studies/<name>.toml`: the keys that all studies but those of one fit share."""

    SCHEMA: ClassVar[int] = 2

    title: str = ""
    """Heading of the report."""
    question: str = ""
    """What the study answers; printed at the head of its report."""
    note: str = ""
    """Free text for readers of the file; it changes no result."""
    same_specimen: bool = False
    """Whether held-out insertions go on purpose into specimens that are fitted. Without it, that is a
    warning."""


class AnalysisRecord(QuestionRecord):
    """`studies/<name>.toml` with `kind = "..."`: the keys that all kinds share."""

    kind: Any
    """Kind of study."""


class TargetRecord(AnalysisRecord):
    """A study of the insertions that another study or fit is tuned on."""

    target: str
    """Study or fit whose insertions are analysed: its name, or the path of its file."""
