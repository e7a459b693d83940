"""Read a dataset, or list all of its faults (`needlefit check`)."""

from pathlib import Path

from needlefit.datasets import tip_track_table as tracks
from needlefit.datasets.faults import Fault, as_error
from needlefit.datasets.insertion import Dataset
from needlefit.datasets.inspection import Inspection, inspect_dataset
from needlefit.datasets.sources import find_dataset_file
from needlefit.datasets.tip_track_table import holds_tracks
from needlefit.errors import DataError
from needlefit.project.result_warnings import ResultWarning


def read(path: Path) -> Dataset:
    """Return the dataset, of shapes or tip tracks, whose folder or `dataset.toml` is `path`.

    Raises
    ------
    DataError
        Listing every fault that `check` finds.
    """
    found = inspect(path)
    if found.dataset is None:
        raise as_error(found.faults, find_dataset_file(path))
    return found.dataset


def inspect(path: Path) -> Inspection | tracks.TrackInspection:
    """Return the dataset whose folder or `dataset.toml` is `path`, or its faults, and its warnings."""
    return tracks.inspect_tracks(path) if holds_tracks(path) else inspect_dataset(path)


def read_shapes(path: Path) -> Dataset:
    """Return `read(path)` for what works on whole shapes alone.

    Raises
    ------
    DataError
        Listing every fault that `check` finds, or because it holds tip tracks.
    """
    if holds_tracks(path):
        raise DataError(
            "holds tip tracks, no shapes",
            where=str(find_dataset_file(path)),
            expected="a dataset with [centerlines]",
            fix="tune, identify, calibrate and predict take it; this does not",
        )
    return read(path)


__all__ = ["Fault", "check", "check_all", "inspect", "read", "read_shapes"]


def check(path: Path) -> list[Fault]:
    """Return every fault of the dataset whose folder or `dataset.toml` is `path`."""
    return check_all(path)[0]


def check_all(path: Path) -> tuple[list[Fault], list[ResultWarning]]:
    """Return all faults of a dataset, which prevent a fit, and all warnings, which do not."""
    found = inspect(path)
    return list(found.faults), list(found.warnings)
