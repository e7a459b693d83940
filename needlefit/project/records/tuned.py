"""An inquiry that begins with one fit: what it is tuned on, and by which recipe."""

from pydantic import Field

from needlefit.project.records.fit import FitRecord, Reading, SelectionRecord
from needlefit.project.records.inquiry import InquiryRecord


class TunedInquiryRecord(InquiryRecord):
    """The keys of a fit, as in `configs/fits/<name>.toml`, beside those of the question."""

    dataset: str
    medium: str
    recipe: str = "default"
    reading: Reading = "listed"
    hand_tuned: str | None = None
    tune: SelectionRecord = Field(default=SelectionRecord())

    def tuning(self) -> FitRecord:
        """Return the fit that this inquiry begins with."""
        keys = self.model_dump(by_alias=True, include=set(FitRecord.model_fields))
        return FitRecord.model_validate(keys)
