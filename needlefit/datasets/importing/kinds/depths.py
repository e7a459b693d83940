"""Depths at times: a row for each, of readings of tips that another table has at their own times."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from needlefit.datasets.importing.draft_table import Columns, TableDraft
from needlefit.datasets.importing.kinds import ImportedCurve, RowKind
from needlefit.datasets.importing.mapped_table import MappedTable
from needlefit.errors import DataError


def propose_depths(draft: TableDraft, is_stated: bool) -> dict[str, Columns]:
    """Return no columns but those of all, where a table without points has times and depths that change."""
    if draft.points or not ({"depth", "time"} <= draft.taken.keys() and "depth" in draft.changing):
        return {}
    draft.keys["of"] = "needle" if "needle" in draft.taken else "all"
    return {"": {}}


def read_depths(mapped: MappedTable, curve: ImportedCurve, rows: Sequence[int]) -> None:
    """Interpolate the depths of readings, mm, by their times.

    Those at other times are left out, and of those at rest all but the first.
    """
    mapped.require("time", "depth")
    times, depths = (mapped.read_numbers(meaning, rows) for meaning in ("time", "depth"))
    order, read_times = np.argsort(times, kind="stable"), curve.times
    inside = np.flatnonzero((read_times >= times.min()) & (read_times <= times.max()))
    if not len(inside):
        raise DataError(
            f"the readings of {curve.name} have no times between {times.min():g} and {times.max():g}",
            expected="a column of times in both tables, by one clock and in one unit",
            fix="correct the times, or join the tables",
            where=mapped.where,
        )
    depths_read = np.interp(read_times, times[order], depths[order])
    moving = inside[np.diff(depths_read[inside], prepend=-np.inf) != 0]
    curve.keep_readings(moving)
    curve.times, depths_read = np.empty(0), depths_read[moving]
    if curve.is_deflection:
        values = np.column_stack([depths_read, curve.line[:, 1:]])
        curve.points = replace(curve.points, values=values)
    else:
        curve.depths = depths_read
    curve.depth_column = str(mapped.record.columns["depth"].columns[0])


DEPTHS = RowKind("depths", propose_depths, 2, read=read_depths)
