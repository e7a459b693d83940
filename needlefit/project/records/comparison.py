"""Which model foretells best what it was not fitted to."""

from typing import Literal, Self

from pydantic import Field, model_validator

from needlefit.project.records.dataset import NoiseRecord
from needlefit.project.records.fit import Reading, SelectionRecord
from needlefit.project.records.inquiry import InquiryRecord
from needlefit.project.records.record import Record
from needlefit.project.records.scene import NeedleRecord

Candidate = Literal["ogden", "linear", "neo_hookean", "constant_curvature", "linear_curvature", "straight"]


class MadeNeedleRecord(Record):
    """One insertion that is simulated; the base moves across once the needle is in."""

    depth_mm: float = Field(gt=0)
    side: Literal[1, -1] = 1
    base_moved_mm: float = 0.0


class MadeRecord(Record):
    """Data made for the study: the medium at these `values` (Pa, mm), needles, and errors of measurement."""

    title: str
    values: dict[str, float]
    needle: NeedleRecord
    noise: NoiseRecord
    pose_angle_sd_deg: float = Field(default=0.0, ge=0)
    depth_sd_mm: float = Field(default=0.0, ge=0)
    insertions: tuple[MadeNeedleRecord, ...] = Field(min_length=2)


class ComparisonRecord(InquiryRecord):
    """`studies/<name>.toml` with `kind = "comparison"`.

    Every candidate is fitted to all folds but one and foretells that one, in turn. Laws of the tissue
    take the layers and bounds of `medium`; a law that does not use alpha has it fixed. `reference` is what
    the others are measured against. With `must_win` the study is a positive control: unless the reference is
    ahead of every other candidate, the comparison itself is at fault.
    """

    kind: Literal["comparison"]
    dataset: str | None = None
    made: MadeRecord | None = None
    medium: str
    recipe: str = "default"
    reading: Reading = "listed"
    insertions: SelectionRecord = SelectionRecord()
    candidates: tuple[Candidate, ...] = (
        "ogden",
        "linear",
        "neo_hookean",
        "linear_curvature",
        "constant_curvature",
        "straight",
    )
    reference: Candidate = "ogden"
    folds: int = Field(default=4, ge=2)
    must_win: bool = False

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if self.dataset is None and self.made is None:
            raise ValueError("neither dataset nor [made] is given: give one of them")
        if self.dataset is not None and self.made is not None:
            raise ValueError("both dataset and [made] are given: give one of them")
        if self.reference not in self.candidates:
            raise ValueError(f"the reference {self.reference} is not among the candidates")
        return self
