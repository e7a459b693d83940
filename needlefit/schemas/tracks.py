"""The study file of a study of tip tracks."""

from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from needlefit.schemas.analyses import QuestionRecord
from needlefit.schemas.base import FileName, Record
from needlefit.schemas.study import Compared, FitRecord, SelectionRecord


class TrackSelectionRecord(Record):
    """Runs of the dataset that match every given key; without keys, all runs."""

    media: tuple[str, ...] = ()
    """Runs into these media."""
    runs: tuple[str, ...] = ()
    """These runs, by id."""
    guided: bool | None = None
    """Runs whose guide moved (`true`) or stayed at rest (`false`)."""

    def selection(self) -> SelectionRecord:
        """Return the same selection as that of a fit."""
        return SelectionRecord(medium=self.media or None, insertions=self.runs or None, guided=self.guided)


class TrackFitRecord(Record):
    """One fit, and the runs that are predicted from it."""

    name: FileName
    """Name of the fit in tables and files."""
    medium: str
    """Name of a tissue model in `configs/media/`, or the path of its file."""
    priors: dict[str, str] = Field(default={})
    """Measured priors by number of layer: files that `needlefit.write_prior` wrote."""
    tune: TrackSelectionRecord
    """Runs that are fitted."""
    validate_: TrackSelectionRecord = Field(alias="validate")
    """Runs that are predicted; they are not fitted to."""
    compared: Compared | None = None
    """What is fitted: in the "plane", what was tracked along y, or in "space", along y and z. Without it, in
    space if the guide moved along z, or the bevel was turned there. Predicted is all that was tracked."""
    folds: int | None = Field(default=None, ge=2)
    """Groups into which the runs of `validate` are divided, as many as runs at most; each is predicted by a
    fit to all others."""


class TrackStudyRecord(QuestionRecord):
    """`observable = "tip tracks"`: fits to tracked tips, and predictions of further runs."""

    KIND: ClassVar[str] = "tracks"

    observable: Literal["tip tracks"]
    """What was measured."""
    dataset: str
    """Name of a dataset in `data/`, or the path of its folder, relative to this file."""
    recipe: str = "default"
    """Name of a recipe in `configs/recipes/`, or the path of its file."""
    registration_depth_mm: float = Field(gt=0)
    """Depth up to which a predicted run's own readings place it in the tracker's frame; deeper ones are
    scored."""
    fits: tuple[TrackFitRecord, ...] = Field(min_length=1)
    """The fits, at least one."""

    @model_validator(mode="after")
    def _named_apart(self) -> Self:
        names = [fit.name for fit in self.fits]
        if len(set(names)) < len(names):
            raise ValueError(f"every one of [[fits]] needs a name of its own, got {', '.join(names)}")
        return self

    def tuning(self, fit: TrackFitRecord) -> FitRecord:
        """Return one of the fits by itself."""
        return FitRecord(
            schema_=FitRecord.SCHEMA,
            title=f"{self.title}: {fit.name}" if self.title else "",
            note=self.note,
            dataset=self.dataset,
            medium=fit.medium,
            recipe=self.recipe,
            priors=fit.priors,
            compared=fit.compared,
            tune=fit.tune.selection(),
            same_specimen=True,
        )
