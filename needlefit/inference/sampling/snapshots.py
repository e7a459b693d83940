"""Store snapshots of a sampler, one per block of steps, so that a killed run resumes to the same bytes."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats
from needlefit.errors import DataError
from needlefit.inference.sampling.ensembles import WalkerState
from needlefit.project.checkpoint_file import (
    CheckpointContent,
    read_checkpoint_file,
    set_aside,
    write_checkpoint_file,
)
from needlefit.project.progress import Note, no_note

Failed = tuple[tuple[tuple[float, ...], ...], ...]


@dataclass(frozen=True)
class Block:
    """Some successive steps of all ensembles, as they are stored.

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
        """Number of steps."""
        return int(self.log_density.shape[1])

    @property
    def last(self) -> WalkerState:
        """The state from which the next step starts."""
        return WalkerState(self.coordinates[:, -1], self.log_density[:, -1], self.random)


@dataclass(frozen=True)
class Snapshots:
    """A folder with one file per block of a run; with folder None nothing is stored."""

    folder: Path | None = None
    note: Note = no_note

    def blocks(self) -> Iterator[Block]:
        """Yield the stored blocks from the first on, up to one that is damaged.

        That one is set aside and those after it are removed: they would go on from a state that is lost.
        """
        for number in count():
            if self.folder is None or not self._file(number).is_file():
                return
            try:
                block = _read_block(self._file(number))
            except DataError:
                self._end_at(number)
                return
            yield block

    def keep(self, number: int, block: Block) -> None:
        """Store a block; it is written aside and renamed, so that a kill leaves a whole file or none."""
        if self.folder is not None:
            # NumPy's legacy state: name, 624 words, position, has_gauss, cached_gaussian; only the words are
            # an array
            kind, key, *rest = block.random
            values = {"random": [kind, *rest], "failures": block.failures, "failed": block.failed}
            arrays = {name: getattr(block, name) for name in _ARRAYS}
            content = CheckpointContent(values, {**arrays, "random": np.asarray(key, dtype=np.int64)})
            write_checkpoint_file(self._file(number), _KIND, "", content)

    def _file(self, number: int) -> Path:
        assert self.folder is not None
        return self.folder / f"{number:05d}.checkpoint"

    def _end_at(self, number: int) -> None:
        aside = set_aside(self._file(number))
        for after in count(number + 1):
            if not self._file(after).is_file():
                break
            self._file(after).unlink()
        self.note(
            f"{self._file(number)} was damaged: it is now {aside.name}; the sampler continues from there"
        )


_KIND = "snapshot"
_ARRAYS = ("coordinates", "log_density", "accepted")


def _read_block(path: Path) -> Block:
    """Return the block in a file; DataError if it is damaged."""
    content = read_checkpoint_file(path, _KIND, "")
    try:
        if content is None or not _is_consistent(content):
            raise ValueError
        kind, *rest = content.values["random"]
        return Block(
            **{name: content.arrays[name] for name in _ARRAYS},
            random=(str(kind), content.arrays["random"].astype(np.uint32), *rest),
            failures=int(content.values["failures"]),
            failed=_to_tuples(content.values["failed"]),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(f"is no block of a sampler: {error!r}", where=str(path)) from None


def _is_consistent(content: CheckpointContent) -> bool:
    """Whether the arrays of a block have the shapes that belong together."""
    ensembles, steps, walkers, _ = content.arrays["coordinates"].shape
    shapes = (content.arrays["log_density"].shape, content.arrays["accepted"].shape)
    return shapes == ((ensembles, steps, walkers), (ensembles, walkers)) and steps > 0


def _to_tuples(lists: list[list[list[float]]]) -> Failed:
    return tuple(tuple(tuple(theta) for theta in ensemble) for ensemble in lists)
