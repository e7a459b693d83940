"""Read the CSV tables of a stored run; a damaged one is an error that names the file and the column."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
import pandas as pd

from needlefit.errors import DataError
from needlefit.project.input_files import read_bytes


@dataclass(frozen=True)
class TableSchema:
    """The columns that are read from a table, by the type of their cells; any cell may be empty."""

    keys: tuple[str, ...] = ()  #: texts that together tell its rows apart
    texts: tuple[str, ...] = ()  #: columns of any text, of numbers, of True or False
    numbers: tuple[str, ...] = ()  #: columns of any text, of numbers, of True or False
    flags: tuple[str, ...] = ()  #: columns of any text, of numbers, of True or False
    finite: tuple[str, ...] = ()  #: columns of numbers, none of them infinite
    #: A column of flags, where it is there: only the rows in which it is True must be finite
    finite_where: str = ""


ANY_COLUMNS = TableSchema()

_TOO_LARGE = re.compile(r"\s*[+-]?\d[\d.]*[eE]\+?(309|3[1-9]\d|[4-9]\d\d|\d{4})\s*")
"""A number that no float holds, as text beside words such as "not determined"."""


def read_table(path: Path, form: TableSchema = ANY_COLUMNS) -> pd.DataFrame:
    """Read a CSV table that a run wrote; a file without lines is an empty table.

    Other columns than those of its form are as pandas finds them.

    Raises DataError if the file cannot be read, is no table, lacks a column, holds a cell of another type, a
    number that is infinite and never written so, or two rows of the same keys: joined with another table they
    would become many.
    """
    texts = (*form.keys, *form.texts)
    data = read_bytes(path)
    frame = _parse_table(data, path, texts)
    if not len(frame.columns):
        return frame
    lacking = [name for name in (*texts, *form.numbers, *form.flags) if name not in frame]
    if lacking:
        raise _damage_error(path, f"lacks the column {', '.join(lacking)}")
    for name in form.numbers:
        right = pd.to_numeric(frame[name], errors="coerce").notna() & ~_find_flags(frame[name])
        _require(right, frame, name, path)
        frame[name] = frame[name].astype(np.float64)
    for name in form.flags:
        _require(_find_flags(frame[name]), frame, name, path)
    wanted = pd.Series(True, frame.index)
    if form.finite_where in frame:
        wanted = frame[form.finite_where].map(lambda cell: cell is True or cell is np.True_).astype(bool)
    for name in form.finite:
        _require_finite(np.isinf(frame[name]) & wanted, name, path)
    repeated = frame.duplicated(list(form.keys)) if form.keys else pd.Series(dtype=bool)
    if repeated.any():
        raise _damage_error(
            path, f"row {_row_number(repeated)} repeats the {', '.join(form.keys)} of an earlier one"
        )
    return frame


def _parse_table(data: bytes, path: Path, texts: Sequence[str]) -> pd.DataFrame:
    if not data:
        raise _damage_error(path, "is empty")
    if not data.strip():
        return pd.DataFrame()
    try:
        frame = pd.read_csv(BytesIO(data), dtype=dict.fromkeys(texts, "str"), low_memory=False)
    except (ValueError, OverflowError, RuntimeError):  # pandas' ParserError and UnicodeDecodeError among them
        raise _damage_error(path, "is not a table of equal rows, as UTF-8") from None
    if not isinstance(frame.index, pd.RangeIndex):  # pandas takes cells beyond the head for names of rows
        raise _damage_error(path, "has rows of more cells than its head")
    for number, name in enumerate(frame):
        if name not in texts:
            _require_finite(_find_overflows(frame[name], number, data), str(name), path)
    return frame


def _find_overflows(column: "pd.Series", number: int, data: bytes) -> "pd.Series":
    """Return which cells are numbers too large for a float: an infinite one is only ever written as inf."""
    if pd.api.types.is_float_dtype(column):
        if not np.isinf(column).any():
            return pd.Series(False, column.index)
        written = pd.read_csv(BytesIO(data), usecols=[number], dtype="str").iloc[:, 0]
        return pd.Series(np.isinf(column)) & ~written.str.strip().isin(("inf", "-inf"))
    return column.map(lambda cell: isinstance(cell, str) and _TOO_LARGE.fullmatch(cell) is not None).astype(
        bool
    )


def _require_finite(wrong: "pd.Series", name: str, path: Path) -> None:
    if wrong.any():
        raise _damage_error(path, f"the number in row {_row_number(wrong)} is infinite", name)


def _find_flags(column: "pd.Series") -> "pd.Series":
    return column.map(lambda cell: isinstance(cell, bool | np.bool_)).astype(bool)


def _require(right: "pd.Series", frame: pd.DataFrame, name: str, path: Path) -> None:
    wrong = frame[name].notna() & ~right
    if wrong.any():
        raise _damage_error(
            path, f"the cell in row {_row_number(wrong)} is of another type than its column", name
        )


def _row_number(wrong: "pd.Series") -> int:
    """Return the number of the first row at fault; the head of the table is row 1."""
    return int(np.argmax(wrong.to_numpy())) + 2


def _damage_error(path: Path, what: str, column: str = "") -> DataError:
    return DataError(
        what,
        where=f"{path}, column {column}" if column else str(path),
        expected="the table as needlefit wrote it",
        fix="make it again with `needlefit report RUN`, or run it again",
    )
