"""Store tables and records in one file, exact to the last digit; equal content gives equal bytes.

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
from needlefit.project.input_files import (
    MAX_TEXT_BYTES,
    is_file,
    open_regular,
    parse_json,
    unreadable_error,
)

RESULTS_FILE = "results.json.gz"

FORMAT_VERSION = 5
"""Of the file."""

MAX_UNPACKED_BYTES = 256 * 2**20
"""Largest size of the text in the file; the studies of the paper have some MB."""

MAX_BRACKETS = 2_000_000
"""Lists and tables in it: each takes more memory than its text. Columns are one list each."""


def pack(table: Mapping[str, Any], folder: Path) -> Path:
    """Write a table of JSON values and arrays to `folder`."""
    path = folder / RESULTS_FILE
    path.write_bytes(
        with_digest(json.dumps(table, ensure_ascii=False, default=to_json_value).encode("utf-8"))
    )
    return path


def with_digest(content: bytes) -> bytes:
    """Return the bytes of a file with `content` and its digest, one line of JSON."""
    head = json.dumps({"format": FORMAT_VERSION, "sha256": hashlib.sha256(content).hexdigest()}).encode(
        "utf-8"
    )
    return gzip.compress(head + b"\n" + content, 6, mtime=0)


def unpack(folder: Path) -> dict[str, Any]:
    """Read the table that a run stored in `folder`.

    Raises
    ------
    DataError
        If it holds none, or one that is damaged, too large or of another version.
    """
    path = folder / RESULTS_FILE
    if not is_file(path):
        raise no_results_error(folder)
    first, _, rest = _unzip(path).partition(b"\n")
    head = _parse_table(first, path)
    if head.get("format") != FORMAT_VERSION:
        raise DataError(
            "is of a format that this version cannot read",
            where=str(path),
            expected=f"format {FORMAT_VERSION}",
            fix="read it with the version that wrote it, or run it again",
        )
    if head.get("sha256") != hashlib.sha256(rest).hexdigest():
        raise damage_error(path, "its content was changed: the digest does not match")
    return _parse_table(rest, path)


def no_results_error(folder: Path) -> DataError:
    """Return the error for a folder without stored results."""
    return DataError(
        "holds no stored results",
        where=str(folder),
        expected=f"{RESULTS_FILE}, which needlefit writes into each run",
        fix="name the folder of a run",
    )


def _unzip(path: Path) -> bytes:
    """Return the bytes in a gzip file, unpacked up to `MAX_UNPACKED_BYTES`."""
    with open_regular(path, MAX_TEXT_BYTES) as file:
        try:
            with gzip.GzipFile(fileobj=file) as unzipped:
                data = unzipped.read(MAX_UNPACKED_BYTES + 1)
        except (gzip.BadGzipFile, EOFError, zlib.error):
            raise damage_error(path, "it is no complete gzip file") from None
        except OSError as fault:
            raise unreadable_error(fault, DataError, str(path)) from None
    if len(data) > MAX_UNPACKED_BYTES:
        raise damage_error(path, f"it unpacks to more than {MAX_UNPACKED_BYTES / 2**20:.0f} MiB")
    return data


def _parse_table(line: bytes, path: Path) -> dict[str, Any]:
    if line.count(b"[") + line.count(b"{") > MAX_BRACKETS:
        raise damage_error(path, f"it holds more than {MAX_BRACKETS} lists and tables")
    try:
        table = parse_json(line.decode("utf-8"), str(path))
    except UnicodeDecodeError:
        raise damage_error(path, "it is not UTF-8") from None
    if not isinstance(table, dict):
        raise damage_error(path, "it holds no table")
    return table


def damage_error(path: Path, why: str) -> DataError:
    """Return the error for a file that does not hold what it should."""
    return DataError(
        f"is damaged: {why}",
        where=str(path),
        expected="the file as needlefit wrote it",
        fix="run it again, or take the file from a copy",
    )


def pack_frame(frame: pd.DataFrame) -> dict[str, Any]:
    """Return a frame as JSON values."""
    columns = {str(name): frame[name].tolist() for name in frame}
    return {"types": {name: str(frame[name].dtype) for name in columns}, "columns": columns}


def unpack_frame(table: Mapping[str, Any]) -> pd.DataFrame:
    """Return the table that `pack_frame` stored."""
    columns = table["columns"]
    return pd.DataFrame(
        {name: pd.Series(columns[name], dtype=kind) for name, kind in table["types"].items()},
        columns=list(columns),
    )


def to_json_value(value: object) -> object:
    """Return a numpy array or number as a JSON value."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be stored")
