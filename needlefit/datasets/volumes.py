"""Where the scans of a dataset's insertions lie: to look at, nothing is read from them that is fitted to."""

import csv
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from needlefit.datasets.faults import Fault, as_error
from needlefit.datasets.formats.csv import missing_columns, read_table
from needlefit.datasets.insertion import Dataset
from needlefit.project.input_files import is_file

NAME = "volumes.csv"
COLUMNS = ("id", "volume", "series")


@dataclass(frozen=True)
class ScanVolume:
    """The scan of an insertion: a file or folder, and which DICOM series where a folder holds several."""

    path: Path
    series: str | None = None


def write_volumes(folder: Path, volumes: Mapping[str, ScanVolume], home: Path | None = None) -> Path:
    """Write where the scan of each insertion lies, by its id, as seen from the folder of the dataset.

    `home` is that folder where it is not yet in its place; dataset and scans may be moved together.
    """
    seen_from = (home or folder).resolve()
    rows = [(id_, _seen_from(seen_from, one.path), one.series or "") for id_, one in volumes.items()]
    path = folder / NAME
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([COLUMNS, *rows])
    return path


def _seen_from(home: Path, path: Path) -> str:
    try:
        return Path(os.path.relpath(path.resolve(), home)).as_posix()
    except ValueError:  # Windows: another drive
        return str(path.resolve())


def volume_of(dataset: Dataset, id_: str) -> ScanVolume | None:
    """Return the scan of an insertion, None where the dataset does not say; it may not lie there any more.

    Raises
    ------
    DataError
        If the table that says so has a fault.
    """
    path = dataset.path.parent / NAME
    if not is_file(path):
        return None
    table, found = read_table(path), list[Fault]()
    if missing_columns(table, COLUMNS[:2], found):
        raise as_error(found, path)
    cells = table.cells[table.cells["id"] == id_]
    if cells.empty or not cells["volume"].iloc[0]:
        return None
    series = cells["series"].iloc[0] if "series" in cells else ""
    return ScanVolume((path.parent.resolve() / cells["volume"].iloc[0]).resolve(), series or None)
