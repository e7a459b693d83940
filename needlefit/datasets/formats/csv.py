"""Read comma-separated text as a table of cells that keep their line numbers."""

import csv
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from needlefit.arrays import Floats
from needlefit.datasets.columns import POINT_COLUMNS, SD_COLUMN, describe_column
from needlefit.datasets.faults import Fault, as_error, note_fault
from needlefit.datasets.formats import FileFormat
from needlefit.datasets.points import MAX_COORDINATE, Points
from needlefit.errors import DataError
from needlefit.project.input_files import read_text

MAX_TABLE_BYTES = 64 * 2**20  # largest file of a table (bytes)
# limits of a table: one beyond them would take more than a gigabyte of memory
MAX_COLUMNS = 1000  # largest number of columns
MAX_CELLS = 4_000_000  # largest number of cells
MAX_SHOWN_CHARS = 60  # longest part of a cell in a message (characters)
MAX_SHOWN_COLUMNS = 30  # largest number of columns in a message
_NAME = re.compile(r"[^\W\d][\w .()\[\]/%^-]{0,39}")  # pattern of the name of a column
# largest number of bad cells of a column that are listed one by one; the rest is counted
MAX_LISTED_CELLS = 5
MISSING_COLUMN_FIX = "add it, or rename a column; dataset.toml can name it under `columns`"
OTHER_DELIMITERS = {";": "semicolons", "\t": "tabs", "|": "bars"}


@dataclass(frozen=True)
class CsvTable:
    """A table of cells as text (stripped), with the line of the file of each row, counted from 1.

    `names` gives the names in the file of columns that were renamed to ours.
    """

    path: Path
    cells: pd.DataFrame
    lines: NDArray[np.int64]  # (N,)
    names: Mapping[str, str] = field(default_factory=dict)

    def where(self, row: int) -> str:
        """Return the place of a row for a message."""
        return f"{self.path}:{self.lines[row]}"


def read_table(path: Path) -> CsvTable:
    """Read a CSV file with a header; byte order mark, CRLF and blank lines are accepted.

    DataError if the file is missing, is no UTF-8 text, has no rows, another delimiter, columns of the same
    name, or a row with more cells than the header.
    """
    rows = _read_rows(path)
    if not rows:
        raise DataError(
            "is empty", expected="a header line and rows below it", fix="fill it, or restore it", where=path
        )
    (top, header), body = rows[0], rows[1:]
    _check_header(header, f"{path}:{top}")
    if not body:
        raise DataError(
            "has a header but no rows",
            expected="one row a line below it",
            fix="add the rows, or restore the file",
            where=f"{path}:{top}",
        )
    for line, row in body:
        if len(row) > len(header):
            raise DataError(
                f"has {len(row)} cells under {len(header)} columns",
                expected=f"{len(header)} cells, decimal points (not decimal commas)",
                fix="remove cells, or put text with a comma in quotes",
                where=f"{path}:{line}",
            )
    width = len(header)
    # Text cells: pandas must not guess types, or ids such as 007 would lose their zeros.
    cells = pd.DataFrame([row + [""] * (width - len(row)) for _, row in body], columns=header, dtype=object)
    return CsvTable(path, cells, np.array([line for line, _ in body], dtype=np.int64))


def parse_numbers(table: CsvTable, column: str, faults: list[Fault], default: float | None = None) -> Floats:
    """Return a column as numbers (N,); NaN where a cell is faulty.

    What exceeds `MAX_COORDINATE` is faulty; so is an empty cell, and a missing column, without a `default`.
    """
    if column not in table.cells and default is not None:
        return np.full(len(table.lines), default)
    text = table.cells[column]
    values: Floats = np.asarray(pd.to_numeric(text.to_numpy(), errors="coerce"), dtype=np.float64)
    # Infinity parses as a number; this comparison rejects it too.
    values = np.where(np.abs(values) <= MAX_COORDINATE, values, np.nan)
    missing = np.flatnonzero(np.isnan(values))
    if not len(missing):
        return values
    empty = missing[text.to_numpy()[missing] == ""]
    bad = missing if default is None else np.setdiff1d(missing, empty)
    for row in bad[:MAX_LISTED_CELLS]:
        problem = "is empty" if row in empty else f"is {text.iloc[row][:MAX_SHOWN_CHARS]!r}"
        note_fault(
            faults,
            table.where(row),
            f"{describe_column(table.names, column)} {problem}",
            f"a finite number, at most {MAX_COORDINATE:g}",
            "fix the cell",
        )
    if len(bad) > MAX_LISTED_CELLS:
        more, line = len(bad) - MAX_LISTED_CELLS, table.lines[bad[MAX_LISTED_CELLS]]
        note_fault(
            faults,
            f"{table.path}:{line}",
            f"{describe_column(table.names, column)} has {more} more such cells from here on",
            "finite numbers",
            "fix the cells",
        )
    if default is not None:
        values[empty] = default
    return values


def read_curve(table: CsvTable, names: Mapping[str, str], faults: list[Fault]) -> Points | None:
    """Return the points under `POINT_COLUMNS` (renamed by `names`), with their deviations if it has any.

    None after a fault.
    """
    before, wanted = len(faults), [names.get(column, column) for column in POINT_COLUMNS]
    note_missing_columns(
        table, [*wanted, *(names[column] for column in (SD_COLUMN,) if column in names)], faults
    )
    values = [parse_numbers(table, column, faults) for column in wanted if column in table.cells]
    column, sd = names.get(SD_COLUMN, SD_COLUMN), None
    if column in table.cells and (table.cells[column] != "").any():
        sd = parse_numbers(table, column, faults)
        for row in np.flatnonzero(sd < 0)[:MAX_LISTED_CELLS]:
            note_fault(
                faults,
                table.where(int(row)),
                f"{column} is {sd[row]:g}",
                "a standard deviation, 0 or more, mm",
                "fix the cell, or leave the column out",
            )
    if len(faults) > before:
        return None
    return Points(table.path, np.column_stack(values), table.lines, sd)


def rename_columns(
    table: CsvTable, names: Mapping[str, str], constants: Mapping[str, object], faults: list[Fault]
) -> CsvTable:
    """Return a table under our names, with constants where it has no column; note columns that it lacks."""
    note_missing_columns(table, list(names.values()), faults)
    present = {ours: table.cells[theirs] for ours, theirs in names.items() if theirs in table.cells}
    cells = table.cells.drop(columns=[*names.values()], errors="ignore").assign(**present)
    absent = {name: str(value) for name, value in constants.items() if name not in cells}
    return CsvTable(table.path, cells.assign(**absent), table.lines, names)


def note_missing_columns(table: CsvTable, wanted: Sequence[str], faults: list[Fault]) -> bool:
    """Note a fault for each column of `wanted` that is missing; return whether any was."""
    missing = [column for column in wanted if column not in table.cells]
    for column in missing:
        note_fault(
            faults,
            f"{table.path}:1",
            f"column `{column}` is missing",
            f"a column of that name; there are {list_columns(table.cells.columns)}",
            MISSING_COLUMN_FIX,
        )
    return bool(missing)


def _read_rows(path: Path) -> list[tuple[int, list[str]]]:
    """Return every line that is not blank: its number and its cells."""
    # pandas would forget on which line a row stood
    reader = csv.reader(io.StringIO(read_text(path, MAX_TABLE_BYTES)), skipinitialspace=True)
    rows: list[tuple[int, list[str]]] = []
    end = 0
    try:
        for cells in reader:
            begin, end = end + 1, reader.line_num
            if any(cell.strip() for cell in cells):
                rows.append((begin, [cell.strip() for cell in cells]))
                check_extent(len(rows), len(rows[0][1]), f"{path}:{begin}")
    except csv.Error as error:
        raise DataError(
            f"cannot be read: {error}",
            expected="a CSV file",
            fix="save it again as CSV",
            where=f"{path}:{end + 1}",
        ) from None
    return rows


def check_extent(rows: int, columns: int, where: str, most: int = MAX_CELLS) -> None:
    """Raise DataError if a table has more than `most` cells, empty ones included, or too many columns."""
    if columns > MAX_COLUMNS or rows * columns > most:
        raise DataError(
            f"is too large: {rows} rows of {columns} columns",
            expected=f"at most {MAX_COLUMNS} columns, and {most:,} cells",
            fix="check the file, or divide it",
            where=where,
        )


def list_columns(columns: Iterable[object]) -> str:
    """Return the table's column names for a message; only plausible names, since the file may be anything."""
    names = [name for name in map(str, columns) if _NAME.fullmatch(name)]
    shown = ", ".join(names[:MAX_SHOWN_COLUMNS]) + ", ..." * (len(names) > MAX_SHOWN_COLUMNS)
    return shown if len(names) > 1 else "no names of columns"


def _check_header(header: list[str], where: str) -> None:
    for sign, name in OTHER_DELIMITERS.items():
        if len(header) == 1 and sign in header[0]:
            raise DataError(
                f"columns are separated by {name}",
                expected="commas between columns, points in decimals",
                fix="save it again as comma-separated values",
                where=where,
            )
    repeated = sorted({name for name in header if header.count(name) > 1})
    if repeated:
        raise DataError(
            "has more than one column "
            f"`{'`, `'.join(name[:MAX_SHOWN_CHARS] for name in repeated[:MAX_LISTED_CELLS])}`",
            expected="a name for every column",
            fix="rename or remove one of them",
            where=where,
        )


def _read_markers(path: Path) -> Points:
    faults: list[Fault] = []
    points = read_curve(read_table(path), {}, faults)
    if points is None:
        raise as_error(faults, path)
    return points


CSV = FileFormat(
    "csv",
    (".csv",),
    read_centerline=lambda path, columns, faults: read_curve(read_table(path), columns, faults),
    read_markers=_read_markers,
)
