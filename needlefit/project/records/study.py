"""A study: tune on these insertions, score on those."""

from typing import Literal, Self

from pydantic import Field, model_validator

from needlefit.project.records.fit import FitRecord, SelectionRecord


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
