"""Say everything that is wrong with a dataset."""

from pathlib import Path

from needlefit.datasets.faults import Fault
from needlefit.datasets.inspection import inspect

__all__ = ["Fault", "check"]


def check(path: Path) -> list[Fault]:
    """Return every fault of the dataset whose folder or `dataset.toml` is `path`; none if `read` takes it."""
    return list(inspect(path).faults)
