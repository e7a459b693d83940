"""What a sampler has done so far, block by block of steps, so that a killed run goes on to the same bytes."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from needlefit.errors import DataError
from needlefit.inference.sampling.ensembles import State
from needlefit.project.replace import replacing_file

Floats = NDArray[np.float64]
Failed = tuple[tuple[tuple[float, ...], ...], ...]


@dataclass(frozen=True)
class Block:
    """Some successive steps of all ensembles.

    Attributes
    ----------
    coordinates : (E, S, W, P) array
    log_density : (E, S, W) array
    accepted : (E, W) array
        How many proposals each walker took.
    random : tuple
        State of the legacy generator after the last step.
    failures : int
        Evaluations that were no number, or raised.
    failed : tuple of tuples of theta
        By ensemble the first of these.
    """

    coordinates: Floats
    log_density: Floats
    accepted: NDArray[np.int64]
    random: tuple[Any, ...]
    failures: int
    failed: Failed

    @property
    def steps(self) -> int:
        """How many these are."""
        return int(self.log_density.shape[1])

    @property
    def last(self) -> State:
        """Where the next step begins."""
        return State(self.coordinates[:, -1], self.log_density[:, -1], self.random)


@dataclass(frozen=True)
class Snapshots:
    """A folder of HDF5 files, one for each block of a run; None keeps nothing."""

    folder: Path | None = None

    def blocks(self) -> Iterator[Block]:
        """Yield the blocks that are kept, from the first on.

        Raises
        ------
        DataError
            If one cannot be read: none is written but whole.
        """
        for number in count():
            if self.folder is None or not self._file(number).is_file():
                return
            yield _read(self._file(number))

    def keep(self, number: int, block: Block) -> None:
        """Keep a block: written aside and renamed, so that a kill leaves it whole or not at all."""
        if self.folder is None:
            return
        with replacing_file(self._file(number)) as path:
            _write(path, block)

    def _file(self, number: int) -> Path:
        assert self.folder is not None
        return self.folder / f"{number:05d}.h5"


def _write(path: Path, block: Block) -> None:
    kind, key, *rest = block.random
    with h5py.File(path, "w") as file:
        file["coordinates"] = block.coordinates
        file["log_density"] = block.log_density
        file["accepted"] = block.accepted
        file["random"] = key
        file.attrs["random"] = json.dumps([kind, *rest])
        file.attrs["failures"] = block.failures
        file.attrs["failed"] = json.dumps(block.failed)


def _read(path: Path) -> Block:
    try:
        with h5py.File(path, "r") as file:
            kind, *rest = json.loads(file.attrs["random"])
            return Block(
                coordinates=file["coordinates"][()],
                log_density=file["log_density"][()],
                accepted=file["accepted"][()],
                random=(kind, file["random"][()], *rest),
                failures=int(file.attrs["failures"]),
                failed=_thetas(json.loads(file.attrs["failed"])),
            )
    except (OSError, KeyError, ValueError) as error:
        raise DataError(
            f"is a damaged snapshot: {error}", where=str(path), mend="run again without --resume"
        ) from None


def _thetas(lists: list[list[list[float]]]) -> Failed:
    return tuple(tuple(tuple(theta) for theta in ensemble) for ensemble in lists)
