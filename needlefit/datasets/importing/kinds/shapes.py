"""Shapes: a row for each point of a needle, or all of its points in one row."""

import re
from collections.abc import Sequence

from needlefit.datasets.importing.curves import ImportedCurve
from needlefit.datasets.importing.draft_table import Records, TableDraft
from needlefit.datasets.importing.kinds import RowKind
from needlefit.datasets.importing.mapped_table import MappedTable
from needlefit.datasets.importing.shapes import ShapePlacer
from needlefit.datasets.importing.synonyms import INDEX, find_meaning
from needlefit.datasets.point_labels import divide_labels
from needlefit.datasets.points import MIN_POINTS
from needlefit.errors import DataError


def propose_shapes(draft: TableDraft, is_stated: bool) -> list[Records]:
    """Return the columns of points; ask where rows may be tips, readings, or needles."""
    points = draft.points
    if not points or draft.are_deflections:
        return points
    is_array, is_alone = _is_array(draft), len(draft.groups) < 2
    if not is_stated:
        if draft.names_rows and not divide_labels(draft.names):
            draft.draft.ask("labels", draft.where)
        elif ("time" in draft.changing and not is_array) or ("depth" in draft.changing and is_alone):
            draft.draft.ask("readings", draft.where)
    first, is_several = points[0], len(points) > 1
    if is_several and is_array:
        if draft.keys.get("layout") != "wide":
            draft.draft.ask("layout", draft.where, count=str(len(points)))
            return points
        return [
            {
                axis: first[axis] | {"column": [entry[axis]["column"] for entry in points if axis in entry]}
                for axis in "xyz"
                if axis in first
            }
        ]
    is_version = any(find_meaning("version", name.split(" ")[0]) for name in draft.groups)
    if is_several and ("needle" in draft.taken or is_version):
        answers = {
            str(next(iter(entry.values()))["column"]): {
                f"{axis}.column": entry[axis]["column"] for axis in entry if axis in "xyz"
            }
            for entry in points
        }
        names = " and ".join(f"`{name}`" for name in answers)
        draft.draft.ask("points", draft.where, answers, names=names)
    if "x" not in first.keys() | draft.taken.keys() and "depth" in draft.taken:
        draft.taken["x"] = draft.taken.pop("depth")  # points at depths
    return points


def _is_array(draft: TableDraft) -> bool:
    """Whether the places below a row of headers are numbered, and each row may be a needle."""
    if len(draft.groups) < MIN_POINTS or draft.keys.get("layout") == "long":
        return False
    first = min(next(iter(draft.groups.values())).values())
    is_numbered = INDEX.search(first.header.text) is not None
    is_numbered |= any(column.header.meaning in ("time", "needle") for column in draft.all)
    return is_numbered and len({re.sub(r"\d+", "#", name) for name in draft.groups}) == 1


def complete_shapes(draft: TableDraft, records: Records) -> None:
    """Take the name of a needle from labels of its points; a name of its own for each point is none."""
    names = draft.names
    if len(names) > MIN_POINTS and len({*names}) == len(names):
        if divide_labels(names):
            records["needle"]["pattern"] = r"(.+?)[-_ .]?\d+"
        else:
            del records["needle"]


def read_shape(mapped: MappedTable, curve: ImportedCurve, rows: Sequence[int]) -> None:
    """Take one point beside shapes for a tip; DataError if it is a shape that was cut short, or none is."""
    if len(rows) > 1:
        return
    names = [mapped.names[n] for n in mapped.kept_rows]
    if names.count(mapped.names[rows[0]]) > 1 or len({*names}) == len(names):
        raise DataError(
            f"{curve.name} has one point: it is a tip, and no shape",
            expected="the points of each needle from the entry to the tip",
            fix=f"complete its points; or, of a table of tips: {mapped.name_edit('holds', 'tips')}",
            where=mapped.table.places[rows[0]],
        )
    curve.holds = "tips"


SHAPES = RowKind(
    "shapes",
    propose_shapes,
    3,
    has_points=True,
    placer=ShapePlacer,
    is_line=True,
    complete=complete_shapes,
    read=read_shape,
)
