"""Only what `needlefit check` passes becomes a dataset; the rest is told, and costs the others nothing."""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

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

    Where all have one, nothing is written, and none is returned as sound.

    Raises
    ------
    DataError
        If a fault belongs to no single insertion.
    """
    left, failures = list(ones), list[Failure]()
    while left:
        faults = _faults(left, recipe, about)
        if not faults:
            assemble(folder, left, recipe, about)
            return tuple(left), tuple(failures)
        blamed = [_owner(fault, left) for fault in faults]
        if None in blamed:
            raise as_error(faults, Path(about.name))
        told = list(zip(blamed, faults, strict=True))
        for one in [one for one in left if one in blamed]:
            left.remove(one)
            failures.append(Failure(one.scan, _error(one, [fault for owner, fault in told if owner is one])))
    return (), tuple(failures)


def _faults(ones: Sequence[Reconstruction], recipe: ReconstructionRecord, about: About) -> list[Fault]:
    """Return the faults of the dataset that some insertions make, not of the folder where it is tried."""
    with TemporaryDirectory(prefix="needlefit-") as trial:
        assemble(Path(trial), ones, recipe, about)
        return [_of_all(fault, Path(trial)) for fault in check(Path(trial))]


def _owner(fault: Fault, ones: Sequence[Reconstruction]) -> Reconstruction | None:
    """Return the insertion in whose row or centreline a fault stands."""
    place = _PLACE.search(Path(fault.where).as_posix())
    if place is None:
        return None
    if place["line"]:
        return ones[int(place["line"]) - 2]  # below one header line
    return next((one for one in ones if one.scan.id == place["curve"]), None)


def _error(one: Reconstruction, faults: Sequence[Fault]) -> DataError:
    """Return the error of an insertion whose faults the user meets in the scan and the recipe."""
    what = "; ".join(dict.fromkeys(fault.what for fault in faults))
    first = faults[0]
    return DataError(
        f"gives no insertion that a dataset may hold: {what}",
        where=str(one.scan.volume),
        expected=first.expected,
        mend=_in_recipe(first.mend),
    )


def _of_all(fault: Fault, folder: Path) -> Fault:
    """Return a fault of the dataset without the temporary folder in which it was found."""
    return replace(fault, where=fault.where.replace(f"{folder}/", ""), mend=_in_recipe(fault.mend))


def _in_recipe(mend: str) -> str:
    """Return what mends a fault, told where a user of a recipe does it."""
    return mend.replace("dataset.toml", "the recipe")
