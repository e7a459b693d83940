"""The report of a depth study."""

from pathlib import Path

from needlefit.reporting import document
from needlefit.reporting.document import Block
from needlefit.reporting.table import Table
from needlefit.reporting.table_files import to_records
from needlefit.reporting.table_layout import TableLayout
from needlefit.studies.report import FigurePaths, StudyReport
from needlefit.studies.run import Run


def lay_out(result: Run) -> list[TableLayout]:
    columns = ("medium", "insertions", "depth_mm")
    rows = to_records(result.frames["depths"])
    return [Table("depths", "Depths of the insertions.", rows, columns).lay_out()]


def draw(result: Run, folder: Path) -> dict[str, Path]:
    return {}


def compose(result: Run, figures: FigurePaths) -> list[Block]:
    return [document.table(table) for table in lay_out(result)]


REPORT = StudyReport(lambda result: ["The insertions end at these depths."], lay_out, draw, compose)
