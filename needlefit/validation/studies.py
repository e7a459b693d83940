"""Load a study file of any kind, and find the data that it needs."""

from collections.abc import Iterator, Mapping
from pathlib import Path

from needlefit.datasets.sources import find_dataset_file, is_missing
from needlefit.project.load import load, read_toml
from needlefit.project.locate import find_file
from needlefit.schemas.analyses import AnalysisRecord
from needlefit.schemas.study import StudyRecord, TrackStudyRecord
from needlefit.validation.analyses.kinds import load_analysis

AnyStudy = StudyRecord | TrackStudyRecord | AnalysisRecord


def load_study(path: Path) -> AnyStudy:
    """Load a study file and check it against the record of its kind.

    Raises
    ------
    ConfigError
        If it does not hold what a study of its kind wants.
    """
    if "observable" in read_toml(path):
        return load(path, TrackStudyRecord)
    return load_analysis(path) or load(path, StudyRecord)


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
