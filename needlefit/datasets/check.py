"""Say everything that is wrong with a dataset."""

from pathlib import Path

from needlefit.datasets.faults import Fault
from needlefit.datasets.inspection import inspect
from needlefit.datasets.tracks.read import holds_tracks, inspect_tracks

__all__ = ["Fault", "check"]


def check(path: Path) -> list[Fault]:
    """Return every fault of the dataset whose folder or `dataset.toml` is `path`; none if it can be read."""
    found = inspect_tracks(path).faults if holds_tracks(path) else inspect(path).faults
    return list(found)
