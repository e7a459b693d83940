"""Only what `needlefit check` passes becomes a dataset; the rest is told, and costs the others nothing."""

import re
import shutil
from collections.abc import Sequence
from pathlib import Path

from needlefit.datasets.check import check
from needlefit.datasets.faults import Fault, as_error
from needlefit.errors import DataError
from needlefit.imaging.assemble import About, assemble
from needlefit.imaging.batch import Failure
from needlefit.imaging.reconstruction import Reconstruction
from needlefit.project.records.reconstruction import ReconstructionRecord

_PLACE = re.compile(r"centerlines/(?P<curve>[^/]+)\.csv|insertions\.csv:(?P<line>\d+)")


def assemble_sound(
    folder: Path, ones: Sequence[Reconstruction], recipe: ReconstructionRecord, about: About
) -> tuple[tuple[Reconstruction, ...], tuple[Failure, ...]]:
    """Write into `folder` the dataset of those of `ones` that have no fault; return them and the others.

    Raises
    ------
    DataError
        If a fault belongs to no single insertion, or all have one.
    """
    left, failures = list(ones), list[Failure]()
    while True:
        assemble(folder, left, recipe, about)
        faults = check(folder)
        if not faults:
            return tuple(left), tuple(failures)
        blamed = [_owner(fault, left) for fault in faults]
        if None in blamed or len({one.scan.id for one in blamed if one}) == len(left):
            raise as_error(faults, folder)
        for one, fault in zip(blamed, faults, strict=True):
            if one in left:
                left.remove(one)
                failures.append(Failure(one.scan, _error(fault)))
        shutil.rmtree(folder)
        folder.mkdir()


def _owner(fault: Fault, ones: Sequence[Reconstruction]) -> Reconstruction | None:
    """Return the insertion in whose row or centreline a fault stands."""
    place = _PLACE.search(Path(fault.where).as_posix())
    if place is None:
        return None
    if place["line"]:
        return ones[int(place["line"]) - 2]  # below one header line
    return next((one for one in ones if one.scan.id == place["curve"]), None)


def _error(fault: Fault) -> DataError:
    return DataError(fault.what, where=Path(fault.where).name, expected=fault.expected, mend=fault.mend)
