"""Read `.fcsv`, the older point lists of 3D Slicer: one point a line, mm."""

import csv
import re
from pathlib import Path

import numpy as np

from needlefit.datasets.markups import (
    EXPECTED_SYSTEM,
    Markups,
    make_markups_format,
    parse_position,
    parse_system,
    require_points,
)
from needlefit.errors import DataError
from needlefit.geometry.frames import to_lps
from needlefit.project.input_files import read_text

# Columns of a file that does not name them; from Slicer 5 on one follows with the status of the point.
FCSV_COLUMNS = ("id", "x", "y", "z", "ow", "ox", "oy", "oz", "vis", "sel", "lock", "label", "desc", "node")
DEFINED_STATUS = "2"  # of a point that was placed
MAX_LINE_CHARS = 10_000  # longer cells are no numbers
_HEADER_LINE = re.compile(r"#\s*([^=]*?)\s*=\s*(.*?)\s*$")


def read_fcsv(path: Path) -> Markups:
    """Read the points of a `.fcsv` file of Slicer 4 or later.

    DataError if the file is missing, does not say its coordinate system, or a line holds no position.
    """
    header: dict[str, str] = {}
    columns: tuple[str, ...] = FCSV_COLUMNS
    labels, positions, numbers, unset = list[str](), list[list[float]](), list[int](), list[str]()
    for number, line in enumerate(read_text(path).split("\n"), start=1):
        if match := _HEADER_LINE.match(line):
            header.setdefault(match[1].lower(), match[2])
            columns = tuple(header.get("columns", ",".join(FCSV_COLUMNS)).replace(" ", "").split(","))
        if not line.strip() or line.startswith("#"):
            continue
        cells = [cell.strip() for cell in next(csv.reader([line.replace("\0", "")[:MAX_LINE_CHARS]]))]
        named = dict(zip(columns, cells, strict=False))
        if cells[len(FCSV_COLUMNS) : len(FCSV_COLUMNS) + 1] not in ([], [""], [DEFINED_STATUS]):
            unset.append(named.get("label", ""))
            continue
        texts = [named.get(axis, "") for axis in "xyz"]
        positions.append(parse_position([_to_float(text) for text in texts], f"{path}:{number}"))
        labels.append(named.get("label", ""))
        numbers.append(number)
    if "coordinatesystem" not in header:
        expected = f"a line `# CoordinateSystem = LPS` above the points: {EXPECTED_SYSTEM}"
        what, fix = "does not say its coordinate system", "add the line, or save the list again in Slicer"
        raise DataError(what, where=str(path), expected=expected, fix=fix)
    system = parse_system(header["coordinatesystem"], str(path))
    points = to_lps(np.array(positions, dtype=np.float64).reshape(-1, 3), system)
    lines = np.array(numbers, dtype=np.int64)
    return require_points(
        Markups(path, path.stem, "Fiducial", tuple(labels), points, system, tuple(unset), lines)
    )


def _to_float(text: str) -> float | str:
    """Return a cell as a number; or the cell itself if it is not a number, for the message."""
    try:
        return float(text)
    except ValueError:
        return text


FCSV = make_markups_format("fcsv", (".fcsv",), lambda path: (read_fcsv(path),))
