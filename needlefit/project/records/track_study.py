"""A study of tip tracks: fit to these runs, foretell those."""

from typing import Literal, Self

from pydantic import Field, model_validator

from needlefit.project.records.record import FileName, FileRecord, Record


class RunsRecord(Record):
    """Which runs of the dataset: every given key must match; `guided` says whether the guide moved."""

    media: tuple[str, ...] = ()
    runs: tuple[str, ...] = ()
    guided: bool | None = None


class TrackFitRecord(Record):
    """One fit, of the runs that `tune` selects, and the runs that are foretold from it."""

    name: FileName
    medium: str
    tune: RunsRecord
    validate_: RunsRecord = Field(alias="validate")


class TrackStudyRecord(FileRecord):
    """`studies/<name>.toml` with `observes = "tip tracks"`.

    `placed_by_mm` is the depth up to which a foretold run's own readings say how it lies in the tracker's
    frame; the deeper ones are scored. `same_specimen = true` says that foretold runs go into specimens that
    are fitted to, on purpose.
    """

    observes: Literal["tip tracks"]
    title: str = ""
    question: str = ""
    note: str = ""
    dataset: str
    recipe: str = "default"
    placed_by_mm: float = Field(gt=0)
    same_specimen: bool = False
    fits: tuple[TrackFitRecord, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _named_apart(self) -> Self:
        names = [fit.name for fit in self.fits]
        if len(set(names)) < len(names):
            raise ValueError(f"every one of [[fits]] needs a name of its own, got {', '.join(names)}")
        return self
