"""A study's file, whatever it asks: the record that it is checked against, and the data that it needs."""

from collections.abc import Iterator, Mapping
from pathlib import Path

from needlefit.datasets.sources import dataset_file, lacking
from needlefit.project.load import load, read_toml
from needlefit.project.places import find
from needlefit.project.records.inquiry import InquiryRecord
from needlefit.project.records.study import StudyRecord
from needlefit.project.records.track_study import TrackStudyRecord
from needlefit.validation.inquiries.kinds import inquiry

AnyStudy = StudyRecord | TrackStudyRecord | InquiryRecord


def load_study(path: Path) -> AnyStudy:
    """Return what a study file asks.

    Raises
    ------
    ConfigError
        If it does not hold what a study of its kind wants.
    """
    if "observes" in read_toml(path):
        return load(path, TrackStudyRecord)
    return inquiry(path) or load(path, StudyRecord)


def lacking_data(path: Path) -> list[str]:
    """Return the datasets that a study file names and whose data lie elsewhere, and are not there."""
    named = dict.fromkeys(_datasets(read_toml(path)))
    return [name for name in named if lacking(dataset_file(find("dataset", name)))]


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
