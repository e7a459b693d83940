"""Of which files a result is made: that of another study or dataset is not replaced.

Two studies may have one name, and results of one name lie in one folder. `timing.json` names the files:
shipped ones by their names, others by their paths from the folder of the result, so that a project can be
moved.
"""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from needlefit.errors import ConfigError, DataError
from needlefit.project.input_files import is_file
from needlefit.project.locate import file_label, find_file, read_toml
from needlefit.project.toml import add_key_context
from needlefit.schemas.base import FileRecord
from needlefit.schemas.study import FitRecord
from needlefit.studies.store import RUN_FILE, read_run, read_timing

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
        before, after = dataset["name"], _find_dataset_name(record)
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


def _find_dataset_name(record: FitRecord) -> str:
    with add_key_context("dataset"):
        file = find_file("dataset", record.dataset)
    name: str = read_toml(file).get("name", "")
    return name


def _other_result_error(folder: Path, before: str, after: str) -> ConfigError:
    return ConfigError(
        f"holds another result, of {before}",
        where=folder,
        expected=f"a new folder, or the result of {after}",
        fix="choose another folder with --out, or move that result away",
    )
