"""Frames and records as one file, exact to the last digit; equal content gives equal bytes."""

import gzip
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from needlefit.errors import DataError

NAME = "results.json.gz"
FORMAT = 2
"""Of the file; another number is refused."""


def pack(table: Mapping[str, Any], folder: Path) -> Path:
    """Write a table of JSON values and arrays to `folder`."""
    path = folder / NAME
    text = json.dumps({"format": FORMAT, **table}, ensure_ascii=False, default=listed)
    path.write_bytes(gzip.compress(text.encode("utf-8"), 6, mtime=0))
    return path


def unpack(folder: Path) -> dict[str, Any]:
    """Return the table that a run left in `folder`.

    Raises
    ------
    DataError
        If it holds none, or one that is damaged or of another version.
    """
    path = folder / NAME
    if not path.is_file():
        raise DataError(
            "holds no stored results",
            where=str(folder),
            expected=f"{NAME}, which needlefit writes into each run",
            mend="name such a run; what an earlier version wrote must be run again",
        )
    try:
        table: dict[str, Any] = json.loads(gzip.decompress(path.read_bytes()))
        found = table["format"]
    except (OSError, EOFError, KeyError, TypeError, ValueError) as error:
        raise damaged(path, error) from None
    if found != FORMAT:
        raise DataError(f"is of format {found}", where=str(path), expected=f"{FORMAT}", mend="run it again")
    return table


def damaged(path: Path, error: Exception) -> DataError:
    """Return what is raised of a file that does not hold what it should."""
    return DataError(
        f"cannot be read: {error!r}", where=str(path), mend="run it again, or take the file from a copy"
    )


def packed(frame: pd.DataFrame) -> dict[str, Any]:
    """Return a frame as JSON values."""
    columns = {str(name): frame[name].tolist() for name in frame}
    return {"types": {name: str(frame[name].dtype) for name in columns}, "columns": columns}


def unpacked(table: Mapping[str, Any]) -> pd.DataFrame:
    """Return the frame that `packed` was given."""
    columns = table["columns"]
    return pd.DataFrame(
        {name: pd.Series(columns[name], dtype=kind) for name, kind in table["types"].items()},
        columns=list(columns),
    )


def listed(value: object) -> object:
    """Return what JSON knows of an array or a number of numpy's."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be stored")
