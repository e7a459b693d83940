"""Load a study file of any kind, and find the data that it needs."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from needlefit.datasets.sources import find_dataset_file, is_missing
from needlefit.project.json_values import to_json_values
from needlefit.project.locate import find_file
from needlefit.project.toml import add_file_context, check, read_toml
from needlefit.schemas.base import FileRecord
from needlefit.schemas.study import StudyRecord
from needlefit.schemas.tracks import TrackStudyRecord
from needlefit.studies.kind import find_kind


def load_study(path: Path) -> FileRecord:
    """Load a study file and check it against the record of its kind.

    Raises ConfigError if it does not hold what a study of its kind wants.
    """
    table = read_toml(path)
    with add_file_context(path):
        record = _record_type(table)
    return check(table, record, path)


def check_study(table: Mapping[str, Any], where: str) -> FileRecord:
    """Return the record of a study whose keys are given in memory; errors as of `load_study`."""
    plain: dict[str, Any] = {key: to_json_values(value) for key, value in table.items()}
    return check(plain, _record_type(plain), where)


def _record_type(table: Mapping[str, Any]) -> type[FileRecord]:
    if "observable" in table:
        return TrackStudyRecord
    return find_kind(table["kind"]).record if "kind" in table else StudyRecord


def find_missing_data(path: Path) -> list[str]:
    """Return the external datasets that a study file names and that are not there."""
    named = dict.fromkeys(_datasets(read_toml(path)))
    return [name for name in named if is_missing(find_dataset_file(find_file("dataset", name)))]


def _datasets(table: object) -> Iterator[str]:
    """Yield the value of every key `dataset` in a table, however deep."""
    if isinstance(table, Mapping):
        for key, value in table.items():
            if key == "dataset" and isinstance(value, str):
                yield value
            else:
                yield from _datasets(value)
    elif isinstance(table, list):
        for value in table:
            yield from _datasets(value)
