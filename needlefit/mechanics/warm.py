"""Compiling the kernel ahead, in a process of its own, once for all processes that begin at the same time.

What is compiled does not depend on who compiles it. A process of its own gives back the memory (300 MB), and
the others wait for it rather than compile the same.
"""

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import numpy as np

from needlefit.mechanics.batch import Batch, positions_each
from needlefit.mechanics.control import Bevel, Step
from needlefit.mechanics.kernel.cache import folder, is_complete, mark_complete
from needlefit.mechanics.lanes import follow_batches
from needlefit.mechanics.linearize import linearize, moved
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.simulate import simulate
from needlefit.mechanics.tissue import Tissue

try:
    import fcntl
except ImportError:  # Windows: processes that begin at the same time all compile
    fcntl = None  # type: ignore[assignment]

ROOMS = ("kernel", "lanes", "sensitivity")

WAIT_S, LOOK_S = 300.0, 0.1
"""How long to wait for another process that compiles, and how often to look."""

_NEEDLE = Needle.from_tube(50.0, 1.27, 80e3)
_TISSUE = Tissue(mu=np.array([0.2]), alpha=np.array([1.0]))
_BEVEL, _DEPTH = Bevel(0.1), 4.0


def warm(*rooms: str) -> None:
    """Compile those of some rooms of the kernel that are not on the disk yet; nothing if all are.

    Where no other process can be started they are compiled in this one, when they are called.
    """
    if all(map(is_complete, rooms)):
        return
    with _alone(folder().path / "lock"):
        missing = [room for room in rooms if not is_complete(room)]  # another process may have compiled
        if missing:
            program = f"from needlefit.mechanics.warm import insert; insert({missing!r})"
            with suppress(OSError):
                subprocess.run([sys.executable, "-c", program], check=False, capture_output=True)


@contextmanager
def _alone(lock: Path) -> Iterator[None]:
    """Hold a lock, which goes with this process however it ends; after `WAIT_S`, or without locks, go on."""
    with ExitStack() as stack:
        if fcntl is not None:
            with suppress(OSError):
                _wait(stack.enter_context(lock.open("w")).fileno())
        yield


def _wait(file: int) -> None:
    until = time.monotonic() + WAIT_S
    while time.monotonic() < until:
        with suppress(BlockingIOError):
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        time.sleep(LOOK_S)


def insert(rooms: list[str]) -> None:
    """Insert a needle by what some rooms hold, which compiles it."""
    for room in rooms:
        _INSERT[room]()
        mark_complete(room)


def _scalar() -> None:
    simulate(_NEEDLE, _TISSUE, _BEVEL, _DEPTH)


def _lanes() -> None:
    batch = Batch(_NEEDLE, _TISSUE, (Step(_DEPTH, _BEVEL),), mu=np.full((2, 1), 0.2))
    for shapes in follow_batches([batch], 1):
        positions_each(shapes, np.array([0.0, _DEPTH]))


def _sensitivity() -> None:
    shape, jacobian = linearize(_NEEDLE, _TISSUE, _BEVEL, _DEPTH)
    moved(shape, jacobian, np.array([0.0, _DEPTH]))


_INSERT: dict[str, Callable[[], None]] = {"kernel": _scalar, "lanes": _lanes, "sensitivity": _sensitivity}
