"""A fit: which insertions tune which medium by which recipe."""

from typing import Literal

from pydantic import Field

from needlefit.project.records.record import FileRecord, Record

Reading = Literal["listed", "alternative"]


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

    `reading` decides an insertion that ends at a boundary: as its row lists it, or the other way.
    `priors` gives layers, by number, what a compression test says of them: a file that `needlefit material`
    wrote, as in `{ 1 = "reports/material-gel/prior.toml" }`.
    `hand_tuned` names a row of the paper's parameter table to stand beside the fit (never a start).
    """

    title: str = ""
    note: str = ""
    dataset: str
    medium: str
    recipe: str = "default"
    reading: Reading = "listed"
    hand_tuned: str | None = None
    priors: dict[str, str] = {}
    tune: SelectionRecord = Field(default=SelectionRecord())
