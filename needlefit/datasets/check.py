"""The one gate of a dataset: what `needlefit check` finds is what every fit, study and view of it refuses."""

from pathlib import Path

from needlefit.datasets import inspection
from needlefit.datasets.faults import Fault
from needlefit.datasets.tracks import read as tracks
from needlefit.project.result_warnings import ResultWarning

__all__ = ["Fault", "check", "check_all"]


def check(path: Path) -> list[Fault]:
    """Return every fault of the dataset whose folder or `dataset.toml` is `path`."""
    return check_all(path)[0]


def check_all(path: Path) -> tuple[list[Fault], list[ResultWarning]]:
    """Return every fault of a dataset, which nothing is fitted to, and every warning, which stops nothing."""
    found = tracks.inspect_tracks(path) if tracks.holds_tracks(path) else inspection.inspect(path)
    return list(found.faults), list(found.warnings)
