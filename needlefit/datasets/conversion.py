"""Somebody's centrelines: the curves of one CSV, MATLAB or Slicer file, and where in it each fault stands."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from needlefit.datasets.curve_faults import MIN_POINTS
from needlefit.datasets.faults import Fault, as_error
from needlefit.datasets.formats import mat, slicer
from needlefit.datasets.formats.csv import read_curve, read_table
from needlefit.datasets.formats.points import Points
from needlefit.datasets.schema import POINT, SD
from needlefit.errors import DataError
from needlefit.project.input_files import is_file
from needlefit.project.locate import join_names
from needlefit.schemas.names import EXPECTED_NAME, name_fault

READS = (
    "--from reads a CSV with the columns x_mm, y_mm, z_mm, sd_mm if known and, for more than one curve, id "
    "(without id the whole table is one curve; other columns are ignored), the N x 3 arrays of a .mat, or "
    "the curves and point lists of a .mrk.json or .fcsv of 3D Slicer (LPS)"
)

Found = tuple[Mapping[str, Points], Sequence[str]]
"""Curves by the names that a file gives them, and remarks on how it was read."""

MAX_SHOWN_NAME, MAX_SHOWN_NAMES = 80, 5
"""Characters of a name, and names, that a message shows."""

_PLACE = re.compile(r"(?:centerlines/(?P<id>[^/]+)\.csv|insertions\.csv):(?P<line>\d+)$")


@dataclass(frozen=True)
class Source:
    """The curves of a file by id, and what a reader should know of how it was read."""

    path: Path
    curves: Mapping[str, Points]
    remarks: tuple[str, ...]

    def fault(self, fault: Fault) -> Fault:
        """Return a fault of the dataset made from this file as one of the file itself."""
        place = _PLACE.search(Path(fault.where).as_posix())
        if place is None:
            return replace(fault, where=str(self.path))
        row = int(place["line"]) - 2  # below one header line, as the dataset was just written
        name, point = (place["id"], row) if place["id"] else (list(self.curves)[row], 0)
        what = f"curve {name} {fault.what}" if place["id"] else f"curve {name}: {fault.what}"
        return replace(fault, where=self.curves[name].where(point), what=what)


def read_source(path: Path) -> Source:
    """Read every centreline of a CSV, .mat, .mrk.json or .fcsv file.

    Raises
    ------
    DataError
        If the file is missing, of another kind, or holds no usable curves; it says what is read.
    """
    suffix = path.suffix.lower()
    if suffix not in READERS:
        expected = ", ".join(READERS)
        raise DataError(f"has the ending {suffix!r}", where=str(path), expected=expected, fix=READS)
    try:
        curves, remarks = READERS[suffix](path)
    except DataError as error:
        fix = "check the path" if not is_file(path) else error.fix or READS
        raise DataError(error.what, where=error.where, expected=error.expected, fix=fix) from None
    found = [fault for name, points in curves.items() for fault in _unusable(name, points)]
    if found:
        raise as_error(found, path)
    named = _named(curves, path)
    changed = [f"{theirs!r} is {name}" for theirs, name in zip(curves, named, strict=True) if theirs != name]
    if changed:
        remarks = [*remarks, f"ids name files, so that {join_names(changed, MAX_SHOWN_NAMES)}"]
    return Source(path, named, tuple(remarks))


def _of_matlab(path: Path) -> Found:
    return mat.read_curves(path), ()


def _of_slicer(path: Path) -> Found:
    """Return the lists of a Slicer file; the points that none of them ever placed are told."""
    unset = sum(len(one.unset) for one in slicer.read_lists(path))
    remarks = [f"{unset} points without a position ignored"] if unset else []
    return slicer.read_curves(path), remarks


def _of_table(path: Path) -> Found:
    """Return the curves of a long table by its column `id`; without one, all rows are one curve."""
    table = read_table(path)
    found: list[Fault] = []
    points = read_curve(table, {}, found)
    if points is None:
        raise as_error([_without_mapping(fault) for fault in found], table.path)
    ignored = [f"`{name}`" for name in table.cells if name not in ("id", *POINT, SD)]
    remarks = [f"column{'s' if len(ignored) > 1 else ''} {', '.join(ignored)} ignored"] if ignored else []
    if "id" not in table.cells:
        remarks.append(f"no column `id`: all {len(points.values)} rows are one curve")
        return {table.path.stem: points}, remarks
    ids = table.cells["id"]
    rows = {str(name): np.flatnonzero((ids == name).to_numpy()) for name in ids.unique()}
    return {name: points.part(n) for name, n in rows.items()}, remarks


READERS: Mapping[str, Callable[[Path], Found]] = {
    ".csv": _of_table,
    ".mat": _of_matlab,
    **dict.fromkeys(slicer.ENDINGS, _of_slicer),
}
"""What reads a file, by its ending."""


def _without_mapping(fault: Fault) -> Fault:
    """Return a fault whose fix speaks of `--from`, which knows no `columns` of a dataset.toml."""
    return replace(fault, fix=f"rename it; {READS}") if "is missing" in fault.what else fault


def _unusable(name: str, points: Points) -> list[Fault]:
    if len(points.values) < MIN_POINTS:
        fix = f"sample the needle more densely; {READS}"
        what = f"curve {name} has only {len(points.values)} points"
        return [Fault(points.where(), what, f"at least {MIN_POINTS}", fix)]
    bad = points.unusable()
    if len(bad) == 0:
        return []
    what = f"curve {name} has {len(bad)} points that are NaN, infinite or too far away"
    return [Fault(points.where(int(bad[0])), what, "finite numbers, mm", "remove or fix these points")]


def _named(curves: Mapping[str, Points], path: Path) -> dict[str, Points]:
    """Return the curves under ids that can name files.

    Two that come out alike, and names that a spreadsheet would run or a terminal would not show, are errors.
    """
    named: dict[str, Points] = {}
    for theirs, points in curves.items():
        if fault := name_fault(theirs):
            raise DataError(
                f"the name {theirs[:MAX_SHOWN_NAME]!r} of a curve is refused: {fault}",
                where=points.where(),
                expected=EXPECTED_NAME,
                fix=f"rename it in {path.name}" if theirs != path.stem else "rename the file",
            )
        name = re.sub(r"[^A-Za-z0-9._-]+", "_", theirs).lstrip("._-") or "curve"
        if name in named:
            raise DataError(
                f"id {theirs!r} becomes {name}, as another one does",
                where=points.where(),
                expected="ids that differ in letters, digits, `.`, `_`, `-`: they name files",
                fix=f"rename one of them in {path.name}",
            )
        named[name] = points
    return named
