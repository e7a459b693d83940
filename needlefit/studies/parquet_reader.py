"""Read rows of a Parquet file as arrays: in the child process of `project.sandbox`, or in this one."""

from typing import Any, Protocol

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import parquet

MAX_ROWS = 100_000_000  #: rows of a file that are read: 100 bytes may stand for as many equal ones
MAX_PIECE_ROWS = 100_000  #: rows that are read at once, but for one row group that has more


class NewArrays(Protocol):
    """Makes the arrays that a reader fills."""

    def new(self, name: str, shape: tuple[int, ...], dtype: str) -> NDArray[Any]:
        """Return a new array of zeros."""


def read_rows(results: NewArrays, path: str, columns: list[str] | None, first_group: int) -> dict[str, Any]:
    """Fill an array for each column, of the row groups from `first_group` on that make one piece.

    Returns
    -------
    dict
        `names` of all columns; `columns`: of each read its name, and of texts the words that its numbers
        stand for (-1: none); `next`: the group after these, None at the end.
    """
    with parquet.ParquetFile(path, memory_map=False) as stored:
        groups = [stored.metadata.row_group(n).num_rows for n in range(stored.num_row_groups)]
        if sum(groups) > MAX_ROWS:
            raise ValueError(f"more than {MAX_ROWS} rows")
        end = first_group + 1
        while end < len(groups) and sum(groups[first_group : end + 1]) <= MAX_PIECE_ROWS:
            end += 1
        stored_names = stored.schema_arrow.names
        names = stored_names if columns is None else columns
        if groups:
            table = stored.read_row_groups(range(first_group, end), names, use_threads=False)
        else:
            table = stored.schema_arrow.empty_table().select(names)
    described = [_fill(results, name, table.column(name)) for name in names]
    return {"names": stored_names, "columns": described, "next": end if end < len(groups) else None}


def _fill(results: NewArrays, name: str, column: "pa.ChunkedArray") -> dict[str, Any]:
    words = None
    if pa.types.is_string(column.type):
        coded = column.combine_chunks().dictionary_encode()
        words = coded.dictionary.to_pylist()
        values = coded.indices.fill_null(-1).to_numpy(zero_copy_only=False)
    else:
        values = column.to_numpy()
    dtype = "int64" if words is not None else values.dtype.name
    results.new(name, (len(column),), dtype)[:] = values
    return {"name": name, "words": words}


class OwnArrays(dict[str, NDArray[Any]]):
    """Arrays of this process."""

    def new(self, name: str, shape: tuple[int, ...], dtype: str) -> NDArray[Any]:
        """Return a new array of zeros, which is kept under its name."""
        self[name] = np.zeros(shape, dtype)
        return self[name]
