"""Faults found in a dataset, and the error that lists them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from needlefit.errors import DataError, NeedlefitError


@dataclass(frozen=True)
class Fault:
    """One fault in a dataset: `where` (file, line if known), `what`, what was `expected`, how to `fix` it."""

    where: str
    what: str
    expected: str = ""
    fix: str = ""

    def __str__(self) -> str:
        return str(as_error([self], Path(self.where)))


def from_error(error: NeedlefitError, where: str = "") -> Fault:
    """Return the fault that an error describes; `where` is used if the error names no place."""
    return Fault(error.where or where, error.what, error.expected, error.fix)


def as_error(faults: Sequence[Fault], path: Path) -> DataError:
    """Return one error that lists all faults found in `path`."""
    if len(faults) == 1:
        fault = faults[0]
        return DataError(fault.what, where=fault.where, expected=fault.expected, fix=fault.fix)
    listed = "\n".join(str(fault) for fault in faults)
    return DataError(f"has {len(faults)} faults\n{listed}", where=str(path))
