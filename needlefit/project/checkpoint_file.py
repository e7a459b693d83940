"""Files in which finished work is kept for `--resume`: plain data with a digest, and no code.

The first line is JSON: what the file is, the digest of all that decided its content (its stamp), and the
SHA-256 and size of all that follows. A line of JSON follows, with values and a table of arrays, then the
arrays' bytes, one after the other. Nothing is decoded before stamp, size and digest are found right.
"""

import hashlib
import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needlefit.errors import DataError
from needlefit.project.atomic_write import replace_file
from needlefit.project.input_files import parse_json, read_bytes

FORMAT = 1
MAX_CHECKPOINT_BYTES = 2**31

_TYPES = ("<f8", "<f4", "<i8", "|b1")


@dataclass(frozen=True)
class CheckpointContent:
    """Values of JSON, and arrays by name."""

    values: Mapping[str, Any]
    arrays: Mapping[str, NDArray[Any]] = field(default_factory=dict)


def write_checkpoint_file(path: Path, kind: str, stamp: str, content: CheckpointContent) -> None:
    """Write a file whole or not at all; the same content gives the same bytes.

    Parameters
    ----------
    kind : str
        What the file holds.
    stamp : str
        A digest of all that decides the content.
    """
    arrays = {name: _to_stored_type(array) for name, array in content.arrays.items()}
    table = [[name, array.dtype.str, list(array.shape)] for name, array in arrays.items()]
    head = json.dumps({"values": content.values, "arrays": table}, ensure_ascii=True)
    body = b"".join([head.encode("ascii"), b"\n", *(array.tobytes() for array in arrays.values())])
    digest = hashlib.sha256(body).hexdigest()
    first = {"needlefit": kind, "format": FORMAT, "stamp": stamp, "sha256": digest, "bytes": len(body)}
    with replace_file(path) as fresh:
        fresh.write_bytes(json.dumps(first).encode("ascii") + b"\n" + body)


def read_checkpoint_file(path: Path, kind: str, stamp: str) -> CheckpointContent | None:
    """Return what a file holds; None if it is of other work.

    Raises
    ------
    DataError
        If it is damaged, or is not such a file.
    """
    first, _, body = read_bytes(path, MAX_CHECKPOINT_BYTES).partition(b"\n")
    head = _table(first, path)
    if head.get("needlefit") != kind or head.get("format") != FORMAT:
        raise _damaged(path, f"it is not a file of kind {kind}, format {FORMAT}")
    if head.get("stamp") != stamp:
        return None
    if head.get("bytes") != len(body) or head.get("sha256") != hashlib.sha256(body).hexdigest():
        raise _damaged(path, "its bytes are not those that were written")
    values, _, data = body.partition(b"\n")
    table = _table(values, path)
    if not isinstance(table.get("values"), dict) or not isinstance(table.get("arrays"), list):
        raise _damaged(path, "it holds no values")
    return CheckpointContent(table["values"], _arrays(table["arrays"], data, path))


def set_aside(path: Path) -> Path:
    """Give a damaged file or folder a new name, `NAME.damaged-1` or the first that is free; return it."""
    for number in range(1, 10_000):
        aside = path.with_name(f"{path.name}.damaged-{number}")
        if aside.exists() or aside.is_symlink():
            continue
        if path.is_dir():
            path.rename(aside)  # fails on a folder that holds anything
            return aside
        try:
            os.link(path, aside)  # unlike a renaming it overwrites nothing
        except FileExistsError:
            continue
        except OSError:  # a disk without links
            path.rename(aside)
            return aside
        path.unlink()
        return aside
    raise _damaged(path, "thousands of damaged ones lie beside it")


def _to_stored_type(array: NDArray[Any]) -> NDArray[Any]:
    """Return an array in one of the types that are kept, in C order."""
    plain = np.ascontiguousarray(array).reshape(array.shape)
    kind = plain.dtype.newbyteorder("<").str
    if kind not in _TYPES:
        raise TypeError(f"no array of {array.dtype} is kept")
    return plain.astype(kind, copy=False)


def _arrays(table: list[Any], data: bytes, path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays that a table lists; their sizes must sum up to that of `data`."""
    arrays, begin = {}, 0
    for row in table:
        if not _lists_array(row):
            raise _damaged(path, "its table of arrays is damaged")
        name, kind, shape = row
        count, width = math.prod(shape), np.dtype(kind).itemsize
        if count * width > len(data) - begin:
            raise _damaged(path, f"array {name!r} is longer than the file")
        flat = np.frombuffer(data, kind, count, begin) if count else np.empty(0, kind)
        arrays[name] = flat.reshape(shape).copy()
        begin += count * width
    if begin != len(data):
        raise _damaged(path, "it holds more than its arrays")
    return arrays


def _lists_array(row: object) -> bool:
    """Whether a row of the table is a name, a type and a shape."""
    if not isinstance(row, list) or len(row) != 3:
        return False
    name, kind, shape = row
    sizes = (
        isinstance(shape, list) and len(shape) <= 8 and all(type(n) is int and 0 <= n < 2**40 for n in shape)
    )
    return isinstance(name, str) and kind in _TYPES and sizes


def _table(text: bytes, path: Path) -> dict[str, Any]:
    try:
        value = parse_json(text.decode("ascii"), str(path))
    except UnicodeDecodeError:
        value = None
    if not isinstance(value, dict):
        raise _damaged(path, "it holds no table of JSON")
    return value


def _damaged(path: Path, reason: str) -> DataError:
    return DataError(
        f"is damaged: {reason}",
        where=str(path),
        expected="a file as needlefit keeps it for --resume",
        fix="remove it; what it held is computed again",
    )
