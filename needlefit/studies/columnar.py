"""Tables of a run that are stored in Parquet files: memory does not grow with their rows.

Rows are written while tasks finish, in the order of the tasks, and read column by column or piece by piece.
"""

import shutil
from collections import UserDict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from tempfile import mkdtemp
from typing import TYPE_CHECKING, Any
from weakref import finalize

import pandas as pd
from numpy.typing import NDArray
from pandas.api.types import union_categoricals

from needlefit.errors import ConfigError, DataError
from needlefit.project.input_files import is_file
from needlefit.project.sandbox import READER_BYTES, limits_for, read_in_sandbox

if TYPE_CHECKING:  # PyArrow is installed with `needlefit[cluster]` only
    from pyarrow import Schema

Rows = Sequence[Mapping[str, Any]]

#: rows of a row group, but for the last: each costs some kB of memory, whatever it holds
MIN_GROUP_ROWS = 1000
MAX_PIECE_BYTES = 2**30  #: arrays of one piece that a stored file is read in


@dataclass(frozen=True)
class ColumnarFile:
    """A frame in a Parquet file; one that this process has not written is read in a sandbox."""

    path: Path
    own: bool = False

    def read(self, columns: Sequence[str] | None = None) -> Iterator[pd.DataFrame]:
        """Yield some columns (all by default) in pieces, at least one; texts are categories.

        Raises DataError if the file is damaged.
        """
        group: int | None = 0
        while group is not None:
            found, arrays = self._read_piece(columns, group)
            try:
                columns_read = {one["name"]: _decode(arrays[one["name"]], one) for one in found["columns"]}
                piece, group = pd.DataFrame(columns_read), found["next"]
            except (KeyError, TypeError, ValueError) as error:
                raise damage_error(self.path, type(error).__name__) from None
            yield piece

    def list_columns(self) -> list[str]:
        """Return the names of the columns, without reading rows; DataError if the file is damaged."""
        found, _ = self._read_piece((), 0)
        return [str(name) for name in found["names"]]

    def _read_piece(
        self, columns: Sequence[str] | None, group: int
    ) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Return what `read_rows` returns of the row groups from `group` on, and its arrays."""
        wanted: dict[str, Any] = {
            "path": str(self.path),
            "columns": None if columns is None else list(columns),
        }
        wanted["first_group"] = group
        if not self.own:
            return read_in_sandbox(_READER, self.path, _LIMITS, wanted)
        from needlefit.studies.parquet_reader import OwnArrays, read_rows

        arrays = OwnArrays()
        return read_rows(arrays, **wanted), arrays


_READER = "needlefit.studies.parquet_reader:read_rows"
_LIMITS = limits_for(READER_BYTES, MAX_PIECE_BYTES, cpu_seconds=10.0)


def _decode(values: NDArray[Any], described: Mapping[str, Any]) -> "NDArray[Any] | pd.Categorical":
    words = described["words"]
    return values.copy() if words is None else pd.Categorical.from_codes(values, words)


class ColumnarFrames(UserDict[str, Any]):
    """Frames by name; of those in Parquet files the values are files, read whenever they are asked for."""

    def __getitem__(self, name: str) -> pd.DataFrame:
        found = self.data[name]
        return _as_texts(_join(found.read())) if isinstance(found, ColumnarFile) else found

    def __reduce__(self) -> tuple[type, tuple[dict[str, pd.DataFrame]]]:
        """Another process gets the rows: the files may go with this one."""
        return dict, (dict(self),)

    @property
    def files(self) -> dict[str, ColumnarFile]:
        """The files, by the names of their frames."""
        return {name: found for name, found in self.data.items() if isinstance(found, ColumnarFile)}


def _join(pieces: Iterable[pd.DataFrame]) -> pd.DataFrame:
    """Return pieces as one frame; texts stay categories."""
    first, *others = pieces
    if not others:
        return first
    every = [first, *others]
    parts = {
        name: union_categoricals([piece[name] for piece in every])
        if isinstance(first[name].dtype, pd.CategoricalDtype)
        else pd.concat([piece[name] for piece in every], ignore_index=True)
        for name in first
    }
    return pd.DataFrame(parts)


def _as_texts(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a frame with texts in place of categories."""
    texts = {
        str(name): pd.Series(column.to_numpy(dtype=object), index=frame.index)
        for name, column in frame.items()
        if isinstance(column.dtype, pd.CategoricalDtype)
    }
    return frame.assign(**texts) if texts else frame


def require_pyarrow() -> None:
    """Raise ConfigError unless PyArrow is installed."""
    if find_spec("pyarrow") is None:
        raise ConfigError(
            "the tables of a cohort are Parquet files, for which PyArrow is not installed",
            fix="pip install 'needlefit[cluster]'",
        )


def read_columns(frames: Mapping[str, pd.DataFrame], name: str, columns: Sequence[str]) -> pd.DataFrame:
    """Return some columns of a frame; texts of one in a file are categories, which take little memory."""
    if (file := _find_file(frames, name)) is None:
        return frames[name][list(columns)]
    return _join(file.read(columns))


def list_columns(frames: Mapping[str, pd.DataFrame], name: str) -> list[str]:
    """Return the names of a frame's columns."""
    if (file := _find_file(frames, name)) is None:
        return [str(one) for one in frames[name]]
    return file.list_columns()


def iterate_pieces(frames: Mapping[str, pd.DataFrame], name: str) -> Iterator[pd.DataFrame]:
    """Yield a frame in pieces, at least one: of its file, or the frame in memory."""
    if (file := _find_file(frames, name)) is None:
        yield frames[name]
    else:
        yield from map(_as_texts, file.read())


def _find_file(frames: Mapping[str, pd.DataFrame], name: str) -> ColumnarFile | None:
    return frames.files.get(name) if isinstance(frames, ColumnarFrames) else None


def write_frames(
    types: Mapping[str, str], parts: Iterable[Mapping[str, Rows]], columns: Mapping[str, Sequence[str]]
) -> ColumnarFrames:
    """Write the rows of tasks to temporary Parquet files, one per frame.

    The files are removed when the returned object is no longer referenced; a copy of it does not keep them.

    `types`: Arrow's names of the types of columns; others hold text. `parts`: the rows of each task; equal
    parts give equal bytes. `columns`: the columns of every frame.
    """
    import pyarrow as pa

    folder = Path(mkdtemp(prefix="needlefit-"))
    frames = ColumnarFrames({name: ColumnarFile(folder / f"{name}.parquet", own=True) for name in columns})
    finalize(frames, shutil.rmtree, folder, ignore_errors=True)
    with ExitStack() as opened:
        writers = {}
        for name, names in columns.items():
            schema = pa.schema([(one, pa.type_for_alias(types.get(one, "string"))) for one in names])
            writers[name] = opened.enter_context(_RowWriter(frames.files[name].path, schema))
        for part in parts:
            for name, rows in part.items():
                writers[name].add(rows)
    return frames


class _RowWriter(AbstractContextManager["_RowWriter"]):
    """Writes rows to a Parquet file: row groups hold whole parts."""

    def __init__(self, file: Path, schema: "Schema") -> None:
        from pyarrow import parquet

        self._schema, self._rows = schema, list[Mapping[str, Any]]()
        self._writer = parquet.ParquetWriter(file, schema)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if kind is None:
                self._write()
        finally:
            self._writer.close()

    def add(self, rows: Rows) -> None:
        self._rows += rows
        if len(self._rows) >= MIN_GROUP_ROWS:
            self._write()

    def _write(self) -> None:
        import pyarrow as pa

        if self._rows:
            self._writer.write_table(pa.Table.from_pylist(self._rows, self._schema))
        self._rows = []


def store_files(frames: Mapping[str, pd.DataFrame], folder: Path) -> list[str]:
    """Copy the files of frames to `folder`, each under the name of its frame; return the names."""
    files = frames.files if isinstance(frames, ColumnarFrames) else {}
    for name, file in files.items():
        shutil.copyfile(file.path, folder / f"{name}.parquet")
    return list(files)


def open_files(folder: Path, names: Iterable[str]) -> dict[str, ColumnarFile]:
    """Return the files of frames in `folder`, by name.

    Raises DataError if one is missing. ConfigError if there are files, and PyArrow is not installed.
    """
    files = {name: folder / f"{name}.parquet" for name in names}
    if files:
        require_pyarrow()
    for file in files.values():
        if not is_file(file):
            raise damage_error(file, "it is missing")
    return {name: ColumnarFile(file) for name, file in files.items()}


def damage_error(path: Path, why: str) -> DataError:
    """Return the error for a file of a result that does not hold what it should."""
    return DataError(
        f"is damaged: {why}",
        where=str(path),
        expected="the file as needlefit wrote it",
        fix="run it again, or take the file from a copy",
    )
