"""Tabulate how deep the insertions of a dataset go, and report it."""

import pandas as pd

from needlefit.datasets.read import read
from needlefit.project.locate import find_file
from needlefit.reporting.table import Table
from needlefit.reporting.table_files import to_records
from needlefit.reporting.text import KindText
from needlefit.schemas.run_metadata import RunMetadata
from needlefit.studies.job import Settings
from needlefit.studies.report import StudyReport
from needlefit.studies.run import Run
from needlefit_example.depth_study import DepthRecord

FRAMES = {"depths": ("medium", "insertions", "depth_mm")}


def run(name: str, record: DepthRecord, settings: Settings) -> Run:
    """Return the number of insertions and their mean depth, by medium."""
    dataset = read(find_file("dataset", record.dataset))
    rows = pd.DataFrame([{"medium": one.medium, "depth_mm": one.depth} for one in dataset.insertions])
    table = rows.groupby("medium", sort=False)["depth_mm"].agg(insertions="size", depth_mm="mean")
    return Run(
        kind="depth_study",
        name=name,
        record=record,
        origin=dataset.origin,
        dataset_title=dataset.title,
        frames={"depths": table.reset_index()},
        metadata=RunMetadata(name=name, study=record.model_dump(mode="json", by_alias=True)),
        timing={},
    )


def describe(result: Run) -> dict[str, object]:
    return {"deepest_mm": float(result.frames["depths"]["depth_mm"].max())}


def tabulate(result: Run) -> list[Table]:
    return [Table("depths", to_records(result.frames["depths"]), FRAMES["depths"])]


REPORT = StudyReport(KindText("depth_study", "needlefit_example.depth_study"), describe, tabulate)
