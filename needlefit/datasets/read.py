"""Read a dataset, or say everything that is wrong with it."""

from pathlib import Path

from needlefit.datasets.faults import as_error
from needlefit.datasets.insertion import Dataset
from needlefit.datasets.inspection import inspect
from needlefit.datasets.sources import dataset_file


def read(path: Path) -> Dataset:
    """Return the dataset whose folder or `dataset.toml` is `path`.

    Raises
    ------
    DataError
        Listing every fault that `check` finds.
    """
    found = inspect(path)
    if found.dataset is None:
        raise as_error(found.faults, dataset_file(path))
    return found.dataset
