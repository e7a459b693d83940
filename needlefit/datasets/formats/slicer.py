"""Read files of 3D Slicer by suffix: `.mrk.json`, and `.fcsv` (older lists, one point a line, mm)."""

import csv
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from needlefit.datasets.formats.markups import (
    CURVE_KINDS,
    EXPECTED_SYSTEM,
    Markups,
    parse_position,
    parse_system,
    require_points,
)
from needlefit.datasets.formats.mrk_json import read_mrk_json
from needlefit.datasets.formats.points import Points
from needlefit.errors import DataError
from needlefit.geometry.frames import to_lps
from needlefit.project.input_files import read_text

FCSV_COLUMNS = (
    *("id", "x", "y", "z", "ow", "ox", "oy", "oz"),
    *("vis", "sel", "lock", "label", "desc", "associatedNodeID"),
)
"""Columns of a file that has a version, where it does not name them."""

OLD_FCSV_COLUMNS = ("label", "x", "y", "z", "sel", "vis")
"""Columns of a file without a version: Slicer 3."""

DEFINED_STATUS = "2"
"""Status of a point that was placed; since Slicer 5 it follows the columns named."""

_HEADER_LINE = re.compile(r"#\s*([^=]*?)\s*=\s*(.*?)\s*$")


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
        raise DataError(
            f"its columns, {named!r}, lack {', '.join(missing)}",
            where=str(path),
            expected=f"# columns = {','.join(FCSV_COLUMNS)}",
            fix="correct the line, or save the list again in Slicer",
        )
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


SLICER_SUFFIXES = (".json", ".fcsv")
"""Endings, in lower case, of the files read here; Slicer's own is `.mrk.json`."""


def read_lists(path: Path) -> tuple[Markups, ...]:
    """Read every list of points of a file, in LPS and mm; DataError if it is faulty or of another kind."""
    suffix = path.suffix.lower()
    if suffix == ".json":
        return read_mrk_json(path)
    if suffix == ".fcsv":
        return (read_fcsv(path),)
    raise DataError(
        f"has the ending {path.suffix!r}",
        where=str(path),
        expected=".mrk.json or .fcsv",
        fix="save it as that",
    )


def read_markups(path: Path, name: str | None = None) -> Markups:
    """Read the only list of a file, or the one called `name` if there are several; in LPS and mm.

    Raises
    ------
    DataError
        If the file is faulty, holds several lists, or none of that name.
    """
    lists = read_lists(path)
    found = [one for one in lists if name is None or one.name == name]
    if len(found) == 1:
        return found[0]
    listed = ", ".join(f"`{one.name}` ({one.kind})" for one in lists)
    raise DataError(
        f"holds {len(lists)} lists: {listed}",
        where=str(path),
        expected="one list" if name is None else f"one called `{name}`",
        fix="save the list that is meant on its own",
    )


def read_points(path: Path) -> Points:
    """Read a centreline: the only list of a file, or its only open curve if there are several lists.

    Raises
    ------
    DataError
        If the file is faulty, or holds no such list.
    """
    lists = read_lists(path)
    curves = [one for one in lists if one.kind == "Curve"]
    if len(lists) > 1 and len(curves) == 1:
        return curves[0].as_curve()
    return read_markups(path).as_curve()


def read_curves(path: Path) -> Mapping[str, Points]:
    """Read every list that can be a centreline, by name; DataError if there is none, or a name is
    used twice.
    """
    lists = read_lists(path)
    curves = [one for one in lists if one.kind in CURVE_KINDS] or list(lists)  # which then says what it is
    names = [one.name for one in curves]
    for name in names:
        if names.count(name) > 1:
            raise DataError(
                f"holds {names.count(name)} lists called `{name}`",
                where=str(path),
                expected="names that differ: they become ids",
                fix="rename them in Slicer, and save them again",
            )
    return {one.name: one.as_curve() for one in curves}
