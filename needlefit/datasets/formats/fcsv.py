"""`.fcsv`, the older point lists of 3D Slicer: commented header, one point a line, mm."""

import csv
import re
from pathlib import Path

import numpy as np

from needlefit.datasets.formats.markups import (
    EXPECTED_SYSTEM,
    Markups,
    position_of,
    require_points,
    system_of,
)
from needlefit.errors import DataError
from needlefit.geometry.patient import lps
from needlefit.project.input_files import read_text

COLUMNS = (
    *("id", "x", "y", "z", "ow", "ox", "oy", "oz"),
    *("vis", "sel", "lock", "label", "desc", "associatedNodeID"),
)
"""Columns of a file that has a version, where it does not name them."""

OLD_COLUMNS = ("label", "x", "y", "z", "sel", "vis")
"""Columns of a file without a version: Slicer 3."""

DEFINED = "2"
"""Status of a point that was placed; since Slicer 5 it follows the columns named."""

_SAYS = re.compile(r"#\s*([^=]*?)\s*=\s*(.*?)\s*$")


def read_fcsv(path: Path) -> Markups:
    """Read the points of a `.fcsv` file, of any version of Slicer.

    Raises
    ------
    DataError
        If the file is missing, does not say its coordinate system, or a line holds no position.
    """
    header: dict[str, str] = {}
    rows: list[tuple[int, list[str]]] = []
    for number, line in enumerate(read_text(path).split("\n"), start=1):
        if not line.strip():
            continue
        if not line.startswith("#"):
            rows.append((number, _cells(line, f"{path}:{number}")))
        elif said := _SAYS.match(line):
            header.setdefault(said[1].lower(), said[2])
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
    system = system_of(header["coordinatesystem"], str(path))
    columns = _columns(path, header.get("columns"), versioned)
    placed, unset = [], []
    for number, cells in rows:
        named = dict(zip(columns, cells, strict=False))
        label = named.get("label", "")
        if columns == COLUMNS and len(cells) > len(COLUMNS) and cells[len(COLUMNS)] not in (DEFINED, ""):
            unset.append(label)
            continue
        position = position_of([_float(named.get(axis, "")) for axis in "xyz"], f"{path}:{number}")
        placed.append((label, position, number))
    points = np.array([position for _, position, _ in placed], dtype=np.float64).reshape(-1, 3)
    lines = np.array([number for _, _, number in placed], dtype=np.int64)
    labels = tuple(label for label, _, _ in placed)
    return require_points(
        Markups(path, path.stem, "Fiducial", labels, lps(points, system), system, tuple(unset), lines)
    )


def _columns(path: Path, named: str | None, versioned: bool) -> tuple[str, ...]:
    if named is None:
        return COLUMNS if versioned else OLD_COLUMNS
    columns = tuple(name.strip() for name in named.split(","))
    missing = [axis for axis in "xyz" if axis not in columns]
    if missing:
        raise DataError(
            f"its columns, {named!r}, lack {', '.join(missing)}",
            where=str(path),
            expected=f"# columns = {','.join(COLUMNS)}",
            fix="correct the line, or save the list again in Slicer",
        )
    return columns


def _cells(line: str, where: str) -> list[str]:
    try:
        (cells,) = csv.reader([line])
    except (csv.Error, ValueError) as error:
        raise DataError(
            f"cannot be read: {error}", where=where, expected="cells between commas", fix="fix the line"
        ) from None
    return [cell.strip() for cell in cells]


def _float(text: str) -> float | str:
    """Return a cell as a number, or the cell where it is none: the message shows it."""
    try:
        return float(text)
    except ValueError:
        return text
