"""Frames and records as one file, exact to the last digit; equal content gives equal bytes.

The file is gzip of two lines of JSON: format and SHA-256 of the second line, and the content. So a change
that is still valid gzip and valid JSON is found.
"""

import gzip
import hashlib
import json
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from needlefit.errors import DataError
from needlefit.project.reading import MAX_TEXT_BYTES, is_file, opened, parse_json, unreadable

NAME = "results.json.gz"

FORMAT = 3
"""Of the file, with a digest; `OLD_FORMAT`, one line without, is still read; others are refused."""

OLD_FORMAT = 2

MAX_UNPACKED_BYTES = 256 * 2**20
"""Of the text in the file; the studies of the paper have some MB."""

MAX_BRACKETS = 2_000_000
"""Lists and tables in it: each takes more memory than its text. Columns are one list each."""


def pack(table: Mapping[str, Any], folder: Path) -> Path:
    """Write a table of JSON values and arrays to `folder`."""
    path = folder / NAME
    path.write_bytes(with_digest(json.dumps(table, ensure_ascii=False, default=listed).encode("utf-8")))
    return path


def with_digest(content: bytes) -> bytes:
    """Return the bytes of a file that holds `content`, one line of JSON."""
    head = json.dumps({"format": FORMAT, "sha256": hashlib.sha256(content).hexdigest()}).encode("utf-8")
    return gzip.compress(head + b"\n" + content, 6, mtime=0)


def unpack(folder: Path) -> dict[str, Any]:
    """Return the table that a run left in `folder`.

    Raises
    ------
    DataError
        If it holds none, or one that is damaged, too large or of another version.
    """
    path = folder / NAME
    if not is_file(path):
        raise DataError(
            "holds no stored results",
            where=str(folder),
            expected=f"{NAME}, which needlefit writes into each run",
            mend="name such a run; what an earlier version wrote must be run again",
        )
    first, _, rest = _unzipped(path).partition(b"\n")
    head = _table(first, path)
    if head.get("format") == OLD_FORMAT:
        return head
    if head.get("format") != FORMAT:
        raise DataError(
            "is of a format that this version cannot read",
            where=str(path),
            expected=f"format {FORMAT} or {OLD_FORMAT}",
            mend="read it with the version that wrote it, or run it again",
        )
    if head.get("sha256") != hashlib.sha256(rest).hexdigest():
        raise damaged(path, "its content was changed: the digest does not match")
    return _table(rest, path)


def _unzipped(path: Path) -> bytes:
    """Return the bytes in a gzip file, unpacked up to `MAX_UNPACKED_BYTES`."""
    with opened(path, MAX_TEXT_BYTES) as file:
        try:
            with gzip.GzipFile(fileobj=file) as unzipped:
                data = unzipped.read(MAX_UNPACKED_BYTES + 1)
        except (gzip.BadGzipFile, EOFError, zlib.error):
            raise damaged(path, "it is no complete gzip file") from None
        except OSError as fault:
            raise unreadable(fault, DataError, str(path)) from None
    if len(data) > MAX_UNPACKED_BYTES:
        raise damaged(path, f"it unpacks to more than {MAX_UNPACKED_BYTES / 2**20:.0f} MiB")
    return data


def _table(line: bytes, path: Path) -> dict[str, Any]:
    if line.count(b"[") + line.count(b"{") > MAX_BRACKETS:
        raise damaged(path, f"it holds more than {MAX_BRACKETS} lists and tables")
    try:
        table = parse_json(line.decode("utf-8"), str(path))
    except UnicodeDecodeError:
        raise damaged(path, "it is not UTF-8") from None
    if not isinstance(table, dict):
        raise damaged(path, "it holds no table")
    return table


def damaged(path: Path, why: str) -> DataError:
    """Return what is raised of a file that does not hold what it should."""
    return DataError(
        f"is damaged: {why}",
        where=str(path),
        expected="the file as needlefit wrote it",
        mend="run it again, or take the file from a copy",
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
