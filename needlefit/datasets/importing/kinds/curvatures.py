"""Curvatures: a row for each sensor in a needle, or for each needle, with a column for each sensor."""

import re
from collections.abc import Sequence
from itertools import product

import numpy as np

from needlefit.datasets.importing.draft_table import Column, Columns, Records, TableDraft, join_columns
from needlefit.datasets.importing.kinds import ImportedCurve, RowKind
from needlefit.datasets.importing.kinds.facts import read_stated
from needlefit.datasets.importing.kinds.tips import TipPlacer
from needlefit.datasets.importing.mapped_table import MappedTable
from needlefit.datasets.importing.meanings import CURVATURE_AXES, SENSOR_PLACES
from needlefit.errors import DataError
from needlefit.grouping import group_values

# pattern in the header of a curvature toward z, or in the plane xz
_SIDEWAYS = re.compile(r"(?<![a-z])x?z(?![a-z])", re.IGNORECASE)


class CurvaturePlacer(TipPlacer):
    """Places insertions of which curvatures alone were measured."""

    def settle_places(self) -> None:
        """Require the inserted length of each."""
        for curve in self.curves:
            if "depth" not in curve.stated:
                raise DataError(
                    f"the inserted length of needle {curve.name} is not stated",
                    expected="a column `depth` in a table with a row for each needle",
                    fix="name a table with the columns needle and depth, or the reconstructed shapes, too",
                    where=curve.points.path,
                )

    def fill_tips(self) -> None:
        """Fill in that curvatures alone were measured."""
        for curve in self.curves:
            curve.fill(observation="curvature")


def propose_curvatures(draft: TableDraft, is_stated: bool) -> dict[str, Columns]:
    """Return no columns but those of all, where headers or units are of curvatures; ask which is which."""
    taken = draft.taken
    if taken.keys() & {*CURVATURE_AXES} and "point_sd" in taken:
        taken.setdefault("curvature_sd", taken.pop("point_sd"))
    if not is_stated and draft.points:
        return {}
    inverse = [column for column in draft.list_free() if column.is_curvature]
    if not (inverse or taken.keys() & {*CURVATURE_AXES} or is_stated):
        return {}
    is_asked = _take_wide(draft, inverse)
    free = [column for column in draft.list_unknown() if not column.is_curvature]
    if not (is_asked or {*SENSOR_PLACES} & {*taken, *draft.draft.columns}):
        draft.ask_column("sensor", free)
    for axis in CURVATURE_AXES:
        if axis not in taken and "value" not in draft.draft.columns.get(axis, {}):
            left = [column for column in inverse if column.place not in draft.used]
            draft.ask_column(axis, left, {"0, in one plane": {f"{axis}.value": "0"}})
    return {"": {}}


def _take_wide(draft: TableDraft, columns: Sequence[Column]) -> bool:
    """Take a column of each sensor, of several; ask from where the places in their headers count.

    Return whether that is asked.
    """
    if {*SENSOR_PLACES} & {*draft.taken}:
        return False
    is_stated = any("value" in draft.draft.columns.get(place, {}) for place in SENSOR_PLACES)
    if len(columns) <= len(CURVATURE_AXES) and not is_stated:
        return False
    planes = group_values((CURVATURE_AXES[bool(_SIDEWAYS.search(column.text))], column) for column in columns)
    places = {tuple(column.along_mm for column in of_plane) for of_plane in planes.values()}
    for axis, of_plane in planes.items():
        draft.take(axis, of_plane)
    if len(places) != 1 or is_stated or None in (sensors := places.pop()):
        return False
    draft.ask("sensors", names=join_columns(columns), places=";".join(f"{place:g}" for place in sensors))
    return True


def complete_curvatures(draft: TableDraft, records: Records) -> None:
    """Let curvatures without a unit have that of the other axis."""
    units = [records[axis]["unit"] for axis in CURVATURE_AXES if "unit" in records.get(axis, {})]
    for axis in CURVATURE_AXES if units else ():
        if axis in records and not records[axis].keys() & {"unit", "unit_column"}:
            records[axis]["unit"] = units[0]
            draft.draft.assumed.pop(f"{axis}.unit", None)


def read_curvatures(mapped: MappedTable, curve: ImportedCurve, rows: Sequence[int]) -> None:
    """Add sensors: place, mm, curvatures and SD, 1/mm (NaN: no cell states it); and facts beside them."""
    columns = mapped.record.columns
    meanings = ("sensor" if "sensor" in columns else "sensor_from_base", *CURVATURE_AXES)
    mapped.require(*meanings)
    counts = [len(mapped.cells[meaning][rows[0]]) for meaning in meanings]
    if max(counts[1:]) != counts[0] or {*counts[1:]} - {1, counts[0]}:
        raise DataError(
            f"there are {counts[0]} places of sensors, and {max(counts[1:])} columns of curvatures",
            expected="a place for each",
            fix=mapped.name_edit(f"columns.{meanings[0]}.value", "10;30;50"),
            where=mapped.where,
        )
    for n, k in product(rows, range(counts[0])):
        sd = mapped.read_number("curvature_sd", n) if "curvature_sd" in columns else np.nan
        numbers = [
            mapped.read_number(meaning, n, min(k, count - 1))
            for meaning, count in zip(meanings, counts, strict=True)
        ]
        curve.sensors.append(np.array([*numbers, sd]))
    curve.are_sensors_from_base |= "sensor_from_base" in columns
    read_stated(mapped, curve, rows)


CURVATURES = RowKind(
    "curvatures",
    propose_curvatures,
    5,
    placer=CurvaturePlacer,
    complete=complete_curvatures,
    read=read_curvatures,
)
