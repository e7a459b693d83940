"""Read a dataset, or say everything that is wrong with it."""

from pathlib import Path

from needlefit.datasets.faults import as_error
from needlefit.datasets.insertion import Dataset
from needlefit.datasets.inspection import inspect
from needlefit.datasets.sources import dataset_file
from needlefit.datasets.tracks.read import holds_tracks
from needlefit.errors import DataError


def read(path: Path) -> Dataset:
    """Return the dataset whose folder or `dataset.toml` is `path`.

    Raises
    ------
    DataError
        Listing every fault that `check` finds, or because it holds tip tracks.
    """
    if holds_tracks(path):
        raise DataError(
            "holds tip tracks, no shapes",
            where=str(dataset_file(path)),
            expected="a dataset with [centerlines]",
            fix='fit it by a study with `observable = "tip tracks"`',
        )
    found = inspect(path)
    if found.dataset is None:
        raise as_error(found.faults, dataset_file(path))
    return found.dataset
