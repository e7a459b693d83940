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

# Columns of a file that has a version, where it does not name them.
FCSV_COLUMNS = (
    *("id", "x", "y", "z", "ow", "ox", "oy", "oz"),
    *("vis", "sel", "lock", "label", "desc", "associatedNodeID"),
)
OLD_FCSV_COLUMNS = ("label", "x", "y", "z", "sel", "vis")  # columns of a file without a version: Slicer 3
DEFINED_STATUS = "2"  # status of a point that was placed; since Slicer 5 it follows the columns named
_HEADER_LINE = re.compile(r"#\s*([^=]*?)\s*=\s*(.*?)\s*$")


def read_fcsv(path: Path) -> Markups:
    """Read the points of a `.fcsv` file, of any version of Slicer.

    DataError if the file is missing, does not say its coordinate system, or a line holds no position.
    """
    header: dict[str, str] = {}
    rows: list[tuple[int, list[str]]] = []
    for number, line in enumerate(read_text(path).split("\n"), start=1):
        if not line.strip():
            continue
        if not line.startswith("#"):
            rows.append((number, _split_cells(line, f"{path}:{number}")))
        elif match := _HEADER_LINE.match(line):
            header.setdefault(match[1].lower(), match[2])
    versioned = any(key.startswith("markups fiducial file version") for key in header)
    if "coordinatesystem" not in header:
        raise DataError(
            "does not say its coordinate system",
            where=str(path),
            expected=f"a line `# CoordinateSystem = LPS` above the points: {EXPECTED_SYSTEM}",
            fix="add the line"
            + ("" if versioned else " (lists of Slicer 3 are RAS)")
            + ", or save the list again in Slicer",
        )
    system = parse_system(header["coordinatesystem"], str(path))
    columns = _find_columns(path, header.get("columns"), versioned)
    defined, unset = [], []
    for number, cells in rows:
        named = dict(zip(columns, cells, strict=False))
        label = named.get("label", "")
        if (
            columns == FCSV_COLUMNS
            and len(cells) > len(FCSV_COLUMNS)
            and cells[len(FCSV_COLUMNS)] not in (DEFINED_STATUS, "")
        ):
            unset.append(label)
            continue
        position = parse_position([_to_float(named.get(axis, "")) for axis in "xyz"], f"{path}:{number}")
        defined.append((label, position, number))
    points = np.array([position for _, position, _ in defined], dtype=np.float64).reshape(-1, 3)
    lines = np.array([number for _, _, number in defined], dtype=np.int64)
    labels = tuple(label for label, _, _ in defined)
    return require_points(
        Markups(path, path.stem, "Fiducial", labels, to_lps(points, system), system, tuple(unset), lines)
    )


def _find_columns(path: Path, named: str | None, versioned: bool) -> tuple[str, ...]:
    if named is None:
        return FCSV_COLUMNS if versioned else OLD_FCSV_COLUMNS
    columns = tuple(name.strip() for name in named.split(","))
    missing = [axis for axis in "xyz" if axis not in columns]
    if missing:
        what = f"its columns, {named!r}, lack {', '.join(missing)}"
        fix = "correct the line, or save the list again in Slicer"
        raise DataError(what, where=str(path), expected=f"# columns = {','.join(FCSV_COLUMNS)}", fix=fix)
    return columns


def _split_cells(line: str, where: str) -> list[str]:
    try:
        (cells,) = csv.reader([line])
    except (csv.Error, ValueError) as error:
        raise DataError(
            f"cannot be read: {error}", where=where, expected="cells between commas", fix="fix the line"
        ) from None
    return [cell.strip() for cell in cells]


def _to_float(text: str) -> float | str:
    """Return a cell as a number; or the cell itself if it is not a number, for the message."""
    try:
        return float(text)
    except ValueError:
        return text


FCSV = make_markups_format(
    "fcsv", (".fcsv",), "the point list of a .fcsv of 3D Slicer (LPS)", lambda path: (read_fcsv(path),)
)
