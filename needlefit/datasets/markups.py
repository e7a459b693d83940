"""Markup lists of 3D Slicer: labelled points, converted to LPS; and what its file formats have in common."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats
from needlefit.datasets.faults import Fault
from needlefit.datasets.formats import FileFormat, ReadCurves
from needlefit.datasets.points import MAX_COORDINATE, Points
from needlefit.errors import DataError
from needlefit.geometry.frames import PatientSystem

# How files name their coordinate system; until 2019 by numbers.
SYSTEM_NAMES: Mapping[str, PatientSystem] = MappingProxyType(
    {"LPS": "LPS", "1": "LPS", "RAS": "RAS", "0": "RAS"}
)
EXPECTED_SYSTEM = "LPS or RAS (older files: 1 or 0)"

CURVE_KINDS = ("Curve", "Fiducial")  # lists whose points, in their order, can be a centreline


@dataclass(frozen=True)
class Markups:
    """One markup list of 3D Slicer."""

    path: Path  # where it stands
    name: str  # of the list; the file's where it has none
    kind: str  # "Fiducial", "Curve", "ClosedCurve", "Line", ...
    labels: tuple[str, ...]  # of the points, N of them
    # (N, 3); LPS, mm. Locked, hidden and unselected points are among them: that is how they are shown, no
    # more.
    points: Floats
    system: PatientSystem = "LPS"  # the coordinate system of the file, from which they were turned
    unset: tuple[str, ...] = ()  # labels of the points that were never placed; `points` leaves them out
    lines: NDArray[np.int64] | None = None  # (N,); line of each point; None where the format has no lines
    descriptions: tuple[str, ...] = ()  # of the points, N of them; empty where the format has none

    def as_curve(self) -> Points:
        """Return the points as a centreline; DataError if the list is not a curve."""
        if self.kind in CURVE_KINDS:
            return Points(self.path, self.points, self.lines)
        what = f"`{self.name}` is a {self.kind}, which is no centreline"
        expected = "an open curve (Curve), or points (Fiducial) from the entry to the tip"
        fix = "draw the needle in Slicer as an open curve, and save that"
        raise DataError(what, where=str(self.path), expected=expected, fix=fix)


def parse_system(name: str, where: str) -> PatientSystem:
    """Return the coordinate system that a file names; DataError if it is not LPS or RAS."""
    if name in SYSTEM_NAMES:
        return SYSTEM_NAMES[name]
    ijk = name in ("2", "IJK")
    what = f"the coordinate system is {name!r}" + (": voxels of a volume that the file does not hold" * ijk)
    fix = "load it into Slicer with its volume, and save it again" if ijk else "correct it"
    raise DataError(what, where=where, expected=EXPECTED_SYSTEM, fix=fix)


def parse_position(values: object, where: str) -> list[float]:
    """Return three coordinates from a file; DataError if they are not three numbers."""
    numbers = [_number(value) for value in values] if isinstance(values, list | tuple) else []
    if len(numbers) == 3 and all(abs(number) <= MAX_COORDINATE for number in numbers):
        return numbers
    what = f"the position is {str(values)[:80]}"
    expected = f"three finite numbers, at most {MAX_COORDINATE:g}"
    raise DataError(what, where=where, expected=expected, fix="place the point again in Slicer, or remove it")


def _number(value: object) -> float:
    """Return a number as float; NaN for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return float("nan")
    try:
        return float(value)
    except OverflowError:
        return float("nan")


def require_points(markups: Markups) -> Markups:
    """Return the list; DataError if none of its points has a position."""
    if len(markups.points):
        return markups
    unset = len(markups.unset)
    what = f"list `{markups.name}` is empty" + (f": its {unset} points were never placed" if unset else "")
    fix = "place its points in Slicer and save it again, or take another file"
    raise DataError(what, where=str(markups.path), expected="a list with points", fix=fix)


def make_markups_format(
    name: str, suffixes: tuple[str, ...], read_lists: Callable[[Path], tuple[Markups, ...]]
) -> FileFormat:
    """Return a file format of 3D Slicer, whose files hold lists."""

    def read_curves(path: Path) -> ReadCurves:
        lists = read_lists(path)
        unset = sum(len(one.unset) for one in lists)
        # a list of another kind then says what it is
        curves = [one for one in lists if one.kind in CURVE_KINDS] or list(lists)
        names = [one.name for one in curves]
        for name in names:
            if names.count(name) > 1:
                what = f"holds {names.count(name)} lists called `{name}`"
                fix = "rename them in Slicer, and save them again"
                raise DataError(what, where=str(path), expected="names that differ: they become ids", fix=fix)
        notes = [f"{unset} points without a position ignored"] if unset else []
        return {one.name: one.as_curve() for one in curves}, notes

    def read_centerline(path: Path, _columns: Mapping[str, str], _found: list[Fault]) -> Points:
        lists = read_lists(path)
        curves = [one for one in lists if one.kind == "Curve"]
        return (curves[0] if len(curves) == 1 else pick_list(lists, path)).as_curve()

    def read_markers(path: Path) -> Points:
        markups = pick_list(read_lists(path), path)
        return Points(path, markups.points, markups.lines)

    return FileFormat(name, suffixes, read_curves, read_centerline, read_markers, in_scan=True)


def pick_list(lists: Sequence[Markups], path: Path) -> Markups:
    """Return the only list of a file; DataError if there are several."""
    if len(lists) == 1:
        return lists[0]
    listed = ", ".join(f"`{one.name}` ({one.kind})" for one in lists)
    what = f"holds {len(lists)} lists: {listed}"
    raise DataError(what, where=str(path), expected="one list", fix="save the list that is meant on its own")
