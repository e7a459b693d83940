"""Which folders making a twin may replace: its own output, and nothing that anybody added to it."""

import csv
from collections.abc import Iterator
from contextlib import contextmanager
from io import StringIO
from pathlib import Path

from needlefit.datasets.formats.csv import MAX_TABLE_BYTES
from needlefit.errors import ConfigError, DataError
from needlefit.project.files import held
from needlefit.project.load import read_toml
from needlefit.project.reading import read_text
from needlefit.project.replace import replacing_own

EXPECTED = "no such folder, an empty one, or one that `needlefit twin {}` wrote and nobody added to"


@contextmanager
def replacing_twin(folder: Path) -> Iterator[Path]:
    """Yield what `replacing` does, for a folder that holds nothing or an earlier twin.

    Raises
    ------
    ConfigError
        If `folder` holds anything that building a twin does not write: no user's file is ever deleted.
    """
    with replacing_own(folder, _no_twin, EXPECTED.format("build")) as fresh:
        yield fresh


@contextmanager
def replacing_scans(folder: Path) -> Iterator[Path]:
    """Yield what `replacing` does, for a folder that holds nothing or earlier scans of the twin.

    Raises
    ------
    ConfigError
        If `folder` holds anything else.
    """
    with replacing_own(folder, _no_scans, EXPECTED.format("ct")) as fresh:
        yield fresh


def _no_twin(folder: Path) -> str:
    """Return why a folder is not, or not only, the output of building a twin; empty if it is."""
    try:
        tables = read_toml(folder / "dataset.toml")
    except ConfigError:
        return "it holds no dataset.toml that can be read"
    if tables.get("name") != "twin" or tables.get("origin") != "synthetic":
        return "its dataset.toml is not a twin's"
    if not (folder / "truth.toml").is_file():
        return "it holds no truth.toml"
    written = {"dataset.toml", "truth.toml", *tables.get("checksums", {})}
    foreign = [name for name in held(folder) if name not in written]
    return f"it holds {foreign[0]}, which a twin does not" if foreign else ""


def _no_scans(folder: Path) -> str:
    """Return why a folder is not, or not only, what rendering the twin wrote; empty if it is."""
    try:
        rows = list(csv.DictReader(StringIO(read_text(folder / "scans.csv", MAX_TABLE_BYTES))))
    except (DataError, csv.Error):
        return "it holds no scans.csv that can be read"
    if not rows or any(row.get("origin") != "synthetic" for row in rows):
        return "its scans.csv does not list synthetic scans"
    written = {"scans.csv", "recipe.toml"}
    for row in rows:
        cells = [row.get("scan"), row.get("markers"), *(row.get("surfaces") or "").split(";")]
        written |= {cell.partition("=")[0] for cell in cells if cell}
    foreign = [name for name in held(folder) if _series(name) not in written and name not in written]
    return f"it holds {foreign[0]}, which scans of the twin do not" if foreign else ""


def _series(name: str) -> str:
    """Return the folder of a slice of a DICOM series; empty for any other file."""
    return name.rpartition("/")[0] if name.endswith(".dcm") else ""
