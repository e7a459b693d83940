"""Find the centreline points of each insertion of a dataset, in files of their own or in one long table."""

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from needlefit.datasets.columns import InsertionRow
from needlefit.datasets.faults import Fault, from_error
from needlefit.datasets.formats import FORMATS, find_format
from needlefit.datasets.formats.csv import CsvTable, note_missing_columns, read_curve, read_table
from needlefit.datasets.points import Points
from needlefit.errors import DataError
from needlefit.geometry.frames import IDENTITY_FRAME, Frame
from needlefit.schemas.dataset import DatasetRecord, FrameRecord, InsertionsRecord


@dataclass(frozen=True)
class LongTable:
    """A table that holds many centrelines: the rows of each, by insertion id."""

    table: CsvTable
    groups: dict[str, np.ndarray]

    def first_rows(self) -> CsvTable:
        """Return the first row of every group, with its id as column `id`."""
        first = [int(rows[0]) for rows in self.groups.values()]
        cells = self.table.cells.iloc[first].reset_index(drop=True).assign(id=list(self.groups))
        return replace(self.table, cells=cells, lines=self.table.lines[first])

    def part(self, rows: np.ndarray) -> CsvTable:
        """Return some of the rows as a new table."""
        return replace(
            self.table, cells=self.table.cells.iloc[rows].reset_index(drop=True), lines=self.table.lines[rows]
        )


def read_long_table(path: Path, record: DatasetRecord, found: list[Fault]) -> LongTable | None:
    """Read the long table and sort its rows by insertion; return None after a fault."""
    group_columns = list(record.centerlines.group_by)
    try:
        table = read_table(path)
    except DataError as error:
        found.append(from_error(error))
        return None
    if note_missing_columns(table, group_columns, found):
        return None
    names = _make_group_names(table.cells[group_columns], record.insertions.id_template, path, found)
    rows: dict[str, list[int]] = {}
    for row, name in enumerate(names):
        rows.setdefault(name, []).append(row)
    long = LongTable(table, {name: np.array(of_name) for name, of_name in rows.items()})
    _check_constant(long, record.insertions, found)
    return long


_FIELD = re.compile(r"\{([^{}]*)\}")
"""A column in `id_template`."""


def _make_group_names(keys: pd.DataFrame, template: str | None, path: Path, found: list[Fault]) -> list[str]:
    """Return every row's insertion id, from the template over the group columns."""
    template = template or "_".join(f"{{{column}}}" for column in keys)
    cells = [{str(k): str(v) for k, v in row.items()} for row in keys.to_dict("records")]
    try:
        # not str.format, whose attributes and widths a dataset from elsewhere could misuse
        return [_FIELD.sub(lambda field, row=row: row[field[1]], template) for row in cells]  # type: ignore[misc]
    except KeyError:
        found.append(
            Fault(
                f"{path}:1",
                f"insertions.id_template is {template!r}",
                f"text with {{...}} around columns of group_by: {', '.join(map(str, keys))}",
                "use only these names in it",
            )
        )
        return []


def _check_constant(long: LongTable, record: InsertionsRecord, found: list[Fault]) -> None:
    """Note a column that should have one value for an insertion and has several."""
    if record.file is not None:
        return
    for column in record.columns.values():
        if column not in long.table.cells:
            continue
        text = long.table.cells[column]
        for name, rows in long.groups.items():
            other = np.flatnonzero((text.iloc[rows] != text.iloc[rows[0]]).to_numpy())
            if len(other):
                where = long.table.where(int(rows[other[0]]))
                found.append(
                    Fault(
                        where,
                        f"column `{column}` changes within insertion {name}",
                        "one value",
                        "fix the cells, or distinguish the insertions by this column too (group_by)",
                    )
                )


def find_points(
    row: InsertionRow, folder: Path, record: DatasetRecord, long: LongTable | None
) -> tuple[Points | None, list[Fault]]:
    """Return an insertion's points in the world (None after a fault) and the faults of their cells.

    Points of a format that holds coordinates of the scan are brought from there into the world.
    """
    found: list[Fault] = []
    lines = record.centerlines
    try:
        if lines.pattern is None:
            if long is None or row.id not in long.groups:
                return None, [
                    Fault(
                        str(folder / (lines.file or "")),
                        f"has no rows of insertion {row.id}",
                        "rows of every insertion",
                        "add them, or remove the insertion from the table",
                    )
                ]
            return read_curve(long.part(long.groups[row.id]), lines.columns, found), found
        path = folder / lines.pattern.replace("{id}", row.id)
        format_ = find_format(path) or FORMATS["csv"]
        points = format_.read_one(path, lines.columns, found)
        if points is None or (points := _require_finite(points, found)) is None:
            return None, found
        if format_.in_scan:
            patient = row.patient or make_patient_frame(record.frame)
            points = replace(points, values=patient.to_world(points.values))
        return points, found
    except DataError as error:
        return None, [*found, from_error(error)]


def make_patient_frame(record: FrameRecord) -> Frame:
    """Return the patient coordinates, as a frame in the world, of scans whose row states no others."""
    return IDENTITY_FRAME if record.lps_to_world is None else Frame.from_rows(record.lps_to_world)


def _require_finite(points: Points, found: list[Fault]) -> Points | None:
    bad = points.unusable()
    if len(bad) == 0:
        return points
    found.append(
        Fault(
            points.where(int(bad[0])),
            f"has {len(bad)} points that are NaN, infinite or too far away",
            "finite numbers, mm",
            "remove or fix these points",
        )
    )
    return None
