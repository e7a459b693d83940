"""File formats of points: each is one file here, or of a plugin. Insertions are unknown here."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from needlefit.datasets.faults import Fault
from needlefit.datasets.points import Points
from needlefit.errors import ConfigError, DataError
from needlefit.registry import Registry

# Curves by the names that a file gives them, and remarks on how it was read.
ReadCurves = tuple[Mapping[str, Points], Sequence[str]]


@dataclass(frozen=True)
class FileFormat:
    """A file format of points; all functions raise DataError of a file that is missing or damaged.

    Attributes
    ----------
    name : str
        Its own.
    suffixes : tuple of str
        Endings of its files, in lower case.
    read_curves : callable or None
        Path -> every curve of the file, mm, and remarks. Reading must be safe: the file may be anything.
    read_centerline : callable or None
        Path, the dataset's names of columns, and a list for faults -> the one curve of a file, or None after
        a fault; None: the only one of `read_curves`.
    read_markers : callable or None
        Path -> places of markers, (N, 3); None: the format holds none.
    in_scan : bool
        Whether its coordinates are those of the scan, LPS, and not of the world.
    is_of_format : callable
        Path -> whether a file with one of these endings is of this format.
    """

    name: str
    suffixes: tuple[str, ...]
    read_curves: Callable[[Path], ReadCurves] | None = None
    read_centerline: Callable[[Path, Mapping[str, str], list[Fault]], Points | None] | None = None
    read_markers: Callable[[Path], Points] | None = None
    in_scan: bool = False
    is_of_format: Callable[[Path], bool] = lambda path: True

    def read_one(self, path: Path, columns: Mapping[str, str], faults: list[Fault]) -> Points | None:
        """Return the one curve of a file; None after a fault, which is added to `found`."""
        if self.read_centerline is not None:
            return self.read_centerline(path, columns, faults)
        curves = {} if self.read_curves is None else self.read_curves(path)[0]
        if len(curves) != 1:
            raise DataError(
                f"holds {len(curves)} curves: {', '.join(curves)}",
                expected="one curve",
                fix="save one insertion a file",
                where=path,
            )
        return next(iter(curves.values()))


FORMATS = Registry(FileFormat, __name__, "file format")


def find_format(path: Path) -> FileFormat | None:
    """Return the format of a file by its ending, the longest that is known; None if there is none.

    Formats that share an ending look into the file. ConfigError if it may be of two.
    """
    name = path.name.lower()
    matches = [(len(end), form) for form in FORMATS.values() for end in form.suffixes if name.endswith(end)]
    longest = max((length for length, _ in matches), default=0)
    forms = [form for length, form in matches if length == longest and form.is_of_format(path)]
    if len(forms) > 1:
        raise ConfigError(
            f"`{path.name}` may be of two file formats: {' and '.join(form.name for form in forms)}",
            fix="leave out the plugin of one of them",
        )
    return forms[0] if forms else None
