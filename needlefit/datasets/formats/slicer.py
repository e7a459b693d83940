"""Files of 3D Slicer by their ending: `.mrk.json` and `.fcsv`."""

from collections.abc import Mapping
from pathlib import Path

from needlefit.datasets.formats.fcsv import read_fcsv
from needlefit.datasets.formats.markups import KINDS, Markups
from needlefit.datasets.formats.mrk_json import read_mrk_json
from needlefit.datasets.formats.points import Points
from needlefit.errors import DataError

ENDINGS = (".json", ".fcsv")
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
    """Read the one list of a file, or, of several, the one called `name`; in LPS and mm.

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
    """Read a centreline: the one list of a file or, of several, its one open curve.

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
    """Read every list that can be a centreline, by its name; DataError if there is none, or a name twice."""
    lists = read_lists(path)
    curves = [one for one in lists if one.kind in KINDS] or list(lists)  # which then says what it is
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
