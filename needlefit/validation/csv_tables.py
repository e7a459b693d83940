"""Read the CSV tables of a run again: a file that is damaged is an error with its name and column."""

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
import pandas as pd

from needlefit.errors import DataError
from needlefit.project.reading import read_bytes


@dataclass(frozen=True)
class TableForm:
    """The columns of a table that are used, by what their cells hold; any cell may be empty.

    Attributes
    ----------
    keys : tuple of str
        Texts that together tell its rows apart.
    texts, numbers, flags : tuples of str
        Columns of any text, of numbers, of True or False.
    """

    keys: tuple[str, ...] = ()
    texts: tuple[str, ...] = ()
    numbers: tuple[str, ...] = ()
    flags: tuple[str, ...] = ()


ANY = TableForm()


def read_table(path: Path, form: TableForm = ANY) -> pd.DataFrame:
    """Return the table in a CSV file that a run wrote; a file of blank lines is an empty one.

    Other columns than those of its form are as pandas finds them.

    Raises
    ------
    DataError
        If the file cannot be read, is no table, lacks a column, holds a cell of another type, or two rows of
        the same keys: joined with another table they would become many.
    """
    texts = (*form.keys, *form.texts)
    frame = _parsed(read_bytes(path), path, texts)
    if not len(frame.columns):
        return frame
    lacking = [name for name in (*texts, *form.numbers, *form.flags) if name not in frame]
    if lacking:
        raise _damaged(path, f"lacks the column {', '.join(lacking)}")
    for name in form.numbers:
        right = pd.to_numeric(frame[name], errors="coerce").notna() & ~_flagged(frame[name])
        _require(right, frame, name, path)
        frame[name] = frame[name].astype(np.float64)
    for name in form.flags:
        _require(_flagged(frame[name]), frame, name, path)
    repeated = frame.duplicated(list(form.keys)) if form.keys else pd.Series(dtype=bool)
    if repeated.any():
        raise _damaged(path, f"row {_row(repeated)} repeats the {', '.join(form.keys)} of an earlier one")
    return frame


def _parsed(data: bytes, path: Path, texts: Sequence[str]) -> pd.DataFrame:
    if not data:
        raise _damaged(path, "is empty")
    if not data.strip():
        return pd.DataFrame()
    try:
        frame = pd.read_csv(BytesIO(data), dtype=dict.fromkeys(texts, "str"), low_memory=False)
    except (ValueError, OverflowError, RuntimeError):  # pandas' ParserError and UnicodeDecodeError among them
        raise _damaged(path, "is no table of equal rows, as UTF-8") from None
    if not isinstance(frame.index, pd.RangeIndex):  # pandas takes cells beyond the head for names of rows
        raise _damaged(path, "has rows of more cells than its head")
    return frame


def _flagged(column: "pd.Series") -> "pd.Series":
    return column.map(lambda cell: isinstance(cell, bool | np.bool_)).astype(bool)


def _require(right: "pd.Series", frame: pd.DataFrame, name: str, path: Path) -> None:
    wrong = frame[name].notna() & ~right
    if wrong.any():
        raise _damaged(path, f"the cell in row {_row(wrong)} is of another type than its column", name)


def _row(wrong: "pd.Series") -> int:
    """Return the number of the first row at fault; the head of the table is row 1."""
    return int(np.argmax(wrong.to_numpy())) + 2


def _damaged(path: Path, what: str, column: str = "") -> DataError:
    return DataError(
        what,
        where=f"{path}, column {column}" if column else str(path),
        expected="the table as needlefit wrote it",
        mend="make it again with `needlefit report RUN`, or run it again",
    )
