"""Store a result in a folder, exact to the last digit, and read it again; equal results give equal bytes.

`results.json.gz` holds the record and the tables as JSON; posteriors lie beside it.
What is read must agree with the manifest of the folder (`project.folders`).
"""

import gzip
import json
import os
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import pandas as pd
from pydantic import BaseModel, ValidationError

from needlefit.datasets.sources import DATASET_FILE, DatasetFiles
from needlefit.errors import ConfigError, DataError
from needlefit.inference.sampling.posterior import load, save
from needlefit.project.folders import TIMING_FILE, require_unchanged
from needlefit.project.input_files import (
    MAX_TEXT_BYTES,
    convert_stored_errors,
    is_file,
    open_regular,
    parse_json,
    read_json,
)
from needlefit.project.json_values import to_json_values
from needlefit.project.locate import file_label, find_file, read_toml
from needlefit.project.toml import add_key_context
from needlefit.schemas.base import FileRecord
from needlefit.schemas.result_files import RunTable, StoredRunTable, TimingTable
from needlefit.schemas.study import FitRecord
from needlefit.studies.first_page import FaultKind, RunFault
from needlefit.studies.kind import KINDS, find_kind
from needlefit.studies.run import Frames, Run

RESULTS_FILE, RUN_FILE = "results.json.gz", "run.json"
Form = TypeVar("Form", bound=BaseModel)
DATA_FOLDER = "dataset"  #: of a copy of the data that were fitted to

FORMAT_VERSION = 10  #: of the file of results
#: largest size of the text in the file; the studies of the paper have some MB
MAX_UNPACKED_BYTES = 256 * 2**20
MAX_DATA_BYTES = 64 * 2**20  #: of the data that are copied; the synthetic dataset has 0.8 MB
MAX_RUN_BYTES = 32 * 2**20  #: size of a `run.json`; those of several studies together have some hundred kB

_PLAIN = ("kind", "name", "origin", "dataset_title", "interrupted")


def store_run(run: Run, folder: Path) -> Path:
    """Write a result without its times to `folder`, and a copy of its data; return the file of results."""
    files = posterior_file_names(len(run.posteriors))
    for posterior, file in zip(run.posteriors.values(), files, strict=True):
        save(posterior, folder / file)
    table = {
        "posteriors": list(run.posteriors),
        "record": run.record.model_dump(mode="json", by_alias=True),
        **{key: getattr(run, key) for key in _PLAIN},
        "run": to_json_values(run.metadata.to_json()),
        "faults": [{"kind": fault.kind.name, "what": fault.what} for fault in run.faults],
        "frames": {name: _pack_frame(frame) for name, frame in run.frames.items()},
    }
    stated = run.metadata.dataset
    if run.data is not None and stated is not None and _can_be_kept(run.data, stated.sha256):
        run.data.copy_to(folder / DATA_FOLDER)
    return pack(table, folder)


def _can_be_kept(data: DatasetFiles, digest: str) -> bool:
    """Return whether data are small enough to be copied, and still those with the digest."""
    try:
        return data.can_be_copied and data.size <= MAX_DATA_BYTES and data.digest() == digest
    except OSError:  # a file is gone
        return False


def posterior_file_names(count: int) -> tuple[str, ...]:
    """Return the names of the posterior files of a run, in the order of its posteriors."""
    return ("posterior.nc",) if count == 1 else tuple(f"posterior_{k + 1}.nc" for k in range(count))


def restore_run(folder: Path) -> Run:
    """Read the result that a run stored in `folder`.

    Raises DataError if it holds no result, a damaged one, or one that does not agree with its manifest.
    """
    table = unpack(folder)
    require_unchanged(folder)
    require_schema(table, StoredRunTable, str(folder / RESULTS_FILE))
    with convert_stored_errors(folder / RESULTS_FILE):
        if table["kind"] not in KINDS:
            raise damage_error(folder / RESULTS_FILE, f"there is no kind of study called {table['kind']!r}")
        kind = find_kind(table["kind"])
        about: dict[str, Any] = {key: table[key] for key in _PLAIN}
        faults = [RunFault(FaultKind[fault["kind"]], fault["what"]) for fault in table["faults"]]
        frames: Frames = {name: _unpack_frame(frame) for name, frame in table["frames"].items()}
        for name, wanted in kind.frames.items():
            frame = frames.setdefault(name, pd.DataFrame(columns=list(wanted)))  # one of a later version
            if lacking := [column for column in wanted if column not in frame]:
                raise DataError(
                    f"run `{table['name']}` lacks the column {', '.join(lacking)} in its table {name}",
                    expected="a run of this version",
                    fix="run it again, or read it with the version that wrote it",
                    where=folder,
                )
        names, copy = table["posteriors"], folder / DATA_FOLDER
        files = posterior_file_names(len(names))
        return Run(
            record=kind.record.model_validate(table["record"]),
            frames=frames,
            metadata=require_schema(table["run"], kind.metadata, str(folder / RESULTS_FILE)),
            timing=read_timing(folder),
            posteriors={name: load(folder / file) for name, file in zip(names, files, strict=True)},
            faults=tuple(faults),
            data=DatasetFiles.of_copy(copy) if is_file(copy / DATASET_FILE) else None,
            **about,
        )


def read_run(folder: Path) -> dict[str, Any]:
    """Return what the run in a folder was computed with.

    Raises DataError if its file is missing or damaged, or a value in it is of another type than needlefit
    writes.
    """
    return _read_table(folder / RUN_FILE, RunTable)


def read_timing(folder: Path) -> dict[str, Any]:
    """Return times and durations of a run, empty if it has no `timing.json`; DataError if that is damaged."""
    path = folder / TIMING_FILE
    return _read_table(path, TimingTable) if is_file(path) else {}


def _read_table(path: Path, form: type[BaseModel]) -> dict[str, Any]:
    table = read_json(path, MAX_RUN_BYTES)
    require_schema(table, form, str(path))
    return dict(table)


def require_schema(table: object, form: type[Form], where: str) -> Form:
    """Return a table read from a file in its declared form; DataError names the first key at fault."""
    try:
        return form.model_validate(table)
    except ValidationError as error:
        fault = error.errors(include_url=False, include_input=False, include_context=False)[0]
        key = ".".join(f"{part!s:.40}" for part in fault["loc"][:6])
        raise DataError(
            f"is damaged: {fault['msg'][:200]}",
            where=f"{where}, key `{key}`" if key else where,
            expected="what needlefit wrote there",
            fix="run it again",
        ) from None


# --- the file of results --------------------------------------------------------------------------------


def pack(table: Mapping[str, Any], folder: Path) -> Path:
    """Write a table of JSON values and arrays to `folder`."""
    path = folder / RESULTS_FILE
    text = json.dumps(
        {"format": FORMAT_VERSION, **table}, ensure_ascii=False, default=lambda value: value.tolist()
    )
    path.write_bytes(gzip.compress(text.encode("utf-8"), 4, mtime=0))  # 6 takes three times as long for 2 %
    return path


def unpack(folder: Path) -> dict[str, Any]:
    """Read the table that a run stored in `folder`; it is not compared with the manifest.

    Raises DataError if it holds none, or one that is damaged, too large or of another version.
    """
    path = folder / RESULTS_FILE
    if not is_file(path):
        raise DataError(
            "holds no stored results",
            where=folder,
            expected=f"{RESULTS_FILE}, which needlefit writes into each run",
            fix="name the folder of a run",
        )
    try:
        with open_regular(path, MAX_TEXT_BYTES) as file, gzip.GzipFile(fileobj=file) as unzipped:
            text = unzipped.read(MAX_UNPACKED_BYTES + 1).decode("utf-8")
    except (EOFError, OSError, UnicodeDecodeError, zlib.error):
        raise damage_error(path, "it is no complete gzip file of text") from None
    if len(text) > MAX_UNPACKED_BYTES:
        raise damage_error(path, f"it unpacks to more than {MAX_UNPACKED_BYTES / 2**20:.0f} MiB")
    table = parse_json(text, str(path))
    if not isinstance(table, dict) or table.get("format") != FORMAT_VERSION:
        raise DataError(
            "is of a format that this version cannot read",
            where=path,
            expected=f"format {FORMAT_VERSION}",
            fix="read it with the version that wrote it, or run it again",
        )
    return table


def damage_error(path: Path, why: str) -> DataError:
    """Return the error for a file of a result that does not hold what it should."""
    return DataError(
        f"is damaged: {why}",
        where=path,
        expected="the file as needlefit wrote it",
        fix="run it again",
    )


def _pack_frame(frame: pd.DataFrame) -> dict[str, Any]:
    columns = {str(name): frame[name].tolist() for name in frame}
    return {"types": {name: str(frame[name].dtype) for name in columns}, "columns": columns}


def _unpack_frame(table: Mapping[str, Any]) -> pd.DataFrame:
    columns = table["columns"]
    if len(set(map(len, columns.values()))) > 1 or columns.keys() != table["types"].keys():
        raise ValueError("columns are of different lengths, or without types")
    return pd.DataFrame(
        {name: pd.Series(columns[name], dtype=kind) for name, kind in table["types"].items()},
        columns=list(columns),
    )


# --- of which files a result is made: that of another study or dataset is not replaced
#
# Two studies may have one name, and results of one name lie in one folder. `timing.json` names the files:
# shipped ones by their names, others by their paths from the folder of the result, so that a project can be
# moved.

SOURCES_KEY = "sources"  #: of `timing.json`


def name_source(file: Path) -> str:
    """Return the name of a shipped file, the absolute path of another one."""
    label = file_label(file)
    return str(file.resolve()) if label == str(file) else label


def store_sources(sources: Sequence[str], folder: Path) -> dict[str, list[str]]:
    """Return the entry of `timing.json` for a result in `folder` that is made of these files."""
    return {SOURCES_KEY: [_relate(source, folder) for source in sources]}


def read_sources(timing: Mapping[str, Any], folder: Path) -> list[str]:
    """Return the files of which the result in `folder` was made; none of earlier versions."""
    return [
        str((folder / source).resolve()) if source.startswith(".") else source
        for source in timing.get(SOURCES_KEY, ())
    ]


def require_same_sources(folder: Path, sources: Sequence[str], record: FileRecord | None = None) -> None:
    """Raise ConfigError if a folder holds the result of other files, or of another dataset than a fit names.

    Results of earlier versions name no files.
    """
    if not is_file(folder / RUN_FILE):
        return
    try:
        run, timing = read_run(folder), read_timing(folder)
    except DataError:  # a damaged one is no result to be lost
        return
    for before, after in zip(read_sources(timing, folder), sources, strict=False):
        if before != after:
            raise _other_result_error(folder, before, after)
    if isinstance(record, FitRecord) and (dataset := run.get("dataset")):
        with add_key_context("dataset"):
            before, after = dataset["name"], read_toml(find_file("dataset", record.dataset)).get("name", "")
        if before != after:
            raise _other_result_error(folder, f"the dataset {before}", f"the dataset {after}")


def _relate(source: str, folder: Path) -> str:
    """Return a path as it is from a folder, beginning with a dot; a name as it is."""
    if not Path(source).is_absolute():
        return source
    try:
        related = Path(os.path.relpath(source, folder.resolve())).as_posix()
    except ValueError:  # on another drive
        return source
    return related if related.startswith(".") else f"./{related}"


def _other_result_error(folder: Path, before: str, after: str) -> ConfigError:
    return ConfigError(
        f"holds another result, of {before}",
        where=folder,
        expected=f"a new folder, or the result of {after}",
        fix="choose another folder with --out, or move that result away",
    )
