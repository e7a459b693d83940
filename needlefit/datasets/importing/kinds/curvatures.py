"""Curvatures: a row for each sensor in a needle."""

from collections.abc import Sequence

import numpy as np

from needlefit.datasets.importing.draft_table import Columns, Records, TableDraft
from needlefit.datasets.importing.kinds import ImportedCurve, RowKind
from needlefit.datasets.importing.kinds.facts import read_stated
from needlefit.datasets.importing.kinds.tips import TipPlacer
from needlefit.datasets.importing.mapped_table import MappedTable
from needlefit.datasets.importing.meanings import CURVATURE_AXES
from needlefit.errors import DataError


class CurvaturePlacer(TipPlacer):
    """Places insertions of which curvatures alone were measured."""

    def settle_places(self) -> None:
        """Require the inserted length of each."""
        for curve in self.curves:
            curve.hole = curve.name if curve.is_named else ""
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
    inverse = [column for column in draft.list_free() if column.unit.startswith("1/")]
    if not (inverse or taken.keys() & {*CURVATURE_AXES} or is_stated):
        return {}
    for key in ("sensor_from_base" if "sensor_from_base" in taken else "sensor", *CURVATURE_AXES):
        if key not in taken and "value" not in draft.draft.columns.get(key, {}):
            if key in CURVATURE_AXES:
                draft.ask_column(key, inverse, {"0, in one plane": {f"{key}.value": "0"}})
            else:
                draft.ask_column(key, [column for column in draft.list_unknown() if column not in inverse])
    return {"": {}}


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
    for n in rows:
        sd = mapped.read_number("curvature_sd", n) if "curvature_sd" in columns else np.nan
        curve.sensors.append(np.array([*(mapped.read_number(meaning, n) for meaning in meanings), sd]))
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
