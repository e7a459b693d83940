"""Tables of a run that are stored in Parquet files: memory does not grow with their rows.

Rows are written while tasks finish, in the order of the tasks, and read column by column or piece by piece.
"""

import shutil
from collections import UserDict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from importlib.util import find_spec
from pathlib import Path
from tempfile import mkdtemp
from typing import TYPE_CHECKING, Any
from weakref import finalize

import pandas as pd

from needlefit.errors import ConfigError
from needlefit.project.files import sha256
from needlefit.project.input_files import is_file
from needlefit.studies.packing import damage_error

if TYPE_CHECKING:  # PyArrow is installed with `needlefit[cluster]` only
    from pyarrow import Schema

Rows = Sequence[Mapping[str, Any]]

MIN_GROUP_ROWS = 1000
"""Rows of a row group, but for the last: each costs some kB of memory, whatever it holds."""

MAX_ROWS = 100_000_000
"""Rows of a file that are read: 100 bytes may stand for as many equal ones."""


class ColumnarFrames(UserDict[str, Any]):
    """Frames by name; of those in Parquet files the values are paths, read whenever they are asked for."""

    def __getitem__(self, name: str) -> pd.DataFrame:
        found = self.data[name]
        return _read(found) if isinstance(found, Path) else found

    def __reduce__(self) -> tuple[type, tuple[dict[str, pd.DataFrame]]]:
        """Another process gets the rows: the files may go with this one."""
        return dict, (dict(self),)

    @property
    def files(self) -> dict[str, Path]:
        """The files, by the names of their frames."""
        return {name: found for name, found in self.data.items() if isinstance(found, Path)}


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
    return _read(file, columns, categories=True)


def list_columns(frames: Mapping[str, pd.DataFrame], name: str) -> list[str]:
    """Return the names of a frame's columns."""
    if (file := _find_file(frames, name)) is None:
        return [str(one) for one in frames[name]]
    from pyarrow import parquet

    return list(parquet.read_schema(file).names)


def iterate_pieces(frames: Mapping[str, pd.DataFrame], name: str) -> Iterator[pd.DataFrame]:
    """Yield a frame in pieces, at least one: the row groups of its file, or the frame in memory."""
    if (file := _find_file(frames, name)) is None:
        yield frames[name]
        return
    from pyarrow import parquet

    with parquet.ParquetFile(file) as stored:
        groups = range(stored.num_row_groups)
        for group in groups:
            yield stored.read_row_group(group).to_pandas()
        if not groups:
            yield stored.schema_arrow.empty_table().to_pandas()


def _find_file(frames: Mapping[str, pd.DataFrame], name: str) -> Path | None:
    return frames.files.get(name) if isinstance(frames, ColumnarFrames) else None


def _read(file: Path, columns: Sequence[str] | None = None, categories: bool = False) -> pd.DataFrame:
    from pyarrow import parquet, types

    texts = [one.name for one in parquet.read_schema(file) if types.is_string(one.type)]
    with parquet.ParquetFile(file, read_dictionary=texts if categories else None) as stored:
        frame: pd.DataFrame = stored.read(columns).to_pandas()
    return frame


def write_frames(
    types: Mapping[str, str], parts: Iterable[Mapping[str, Rows]], columns: Mapping[str, Sequence[str]]
) -> ColumnarFrames:
    """Write the rows of tasks to temporary Parquet files, one per frame.

    The files are removed when the returned object is no longer referenced; a copy of it does not keep them.

    Parameters
    ----------
    types : mapping
        Arrow's names of the types of columns; others hold text.
    parts : iterable
        The rows of each task; equal parts give equal bytes.
    columns : mapping
        The columns of every frame.
    """
    import pyarrow as pa

    folder = Path(mkdtemp(prefix="needlefit-"))
    frames = ColumnarFrames({name: folder / f"{name}.parquet" for name in columns})
    finalize(frames, shutil.rmtree, folder, ignore_errors=True)
    with ExitStack() as opened:
        writers = {}
        for name, names in columns.items():
            schema = pa.schema([(one, pa.type_for_alias(types.get(one, "string"))) for one in names])
            writers[name] = opened.enter_context(_RowWriter(frames.files[name], schema))
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


def store_files(frames: Mapping[str, pd.DataFrame], folder: Path) -> dict[str, str]:
    """Copy the files of frames to `folder`, each under the name of its frame; return their SHA-256."""
    files = frames.files if isinstance(frames, ColumnarFrames) else {}
    return {name: sha256(shutil.copyfile(file, folder / f"{name}.parquet")) for name, file in files.items()}


def open_files(folder: Path, digests: Mapping[str, str]) -> dict[str, Path]:
    """Return the files of frames in `folder`, by name.

    Raises
    ------
    DataError
        If one is missing, is not the one with the stored digest, or holds more than `MAX_ROWS`.
    ConfigError
        If there are files, and PyArrow is not installed.
    """
    if not digests:
        return {}
    require_pyarrow()
    from pyarrow import parquet

    files = {name: folder / f"{name}.parquet" for name in digests}
    for name, file in files.items():
        if not is_file(file) or sha256(file) != digests[name]:
            raise damage_error(file, "it is missing, or was changed: the digest does not match")
        if parquet.read_metadata(file).num_rows > MAX_ROWS:
            raise damage_error(file, f"it holds more than {MAX_ROWS} rows")
    return files
