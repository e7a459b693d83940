"""Read the CSV tables of a stored run; a damaged one is an error that names the file and the column."""

import re
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

import numpy as np
import pandas as pd

from needlefit.errors import DataError
from needlefit.project.input_files import read_bytes

_TOO_LARGE = re.compile(r"\s*[+-]?\d[\d.]*[eE]\+?(309|3[1-9]\d|[4-9]\d\d|\d{4})\s*")
"""A number that no float holds, as text beside words such as "not determined"."""


def read_table(path: Path, keys: Sequence[str] = (), texts: Sequence[str] = ()) -> pd.DataFrame:
    """Read a CSV table that a run wrote; a file without lines is an empty table.

    `keys` are columns of texts that together tell its rows apart, `texts` others of any text. The rest is as
    pandas finds it.

    Raises DataError if the file cannot be read, is no table, lacks a column, holds a number that is infinite
    and never written so, or two rows of the same keys.
    """
    texts = (*keys, *texts)
    data = read_bytes(path)
    frame = _parse_table(data, path, texts)
    if not len(frame.columns):
        return frame
    lacking = [name for name in texts if name not in frame]
    if lacking:
        raise _damage_error(path, f"lacks the column {', '.join(lacking)}")
    repeated = frame.duplicated(list(keys)) if keys else pd.Series(dtype=bool)
    if repeated.any():
        raise _damage_error(
            path, f"row {_row_number(repeated)} repeats the {', '.join(keys)} of an earlier one"
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
