"""Compiling the kernel ahead, in a process of its own.

In the process that compiles them, functions that call each other run as they were compiled one by one; from
the disk they run as compiled together, and sums of lanes then end in other digits (1e-10 mm). Compiled
ahead, every process runs what is on the disk, and results are the same bytes from the first run on.
"""

import subprocess
import sys
from collections.abc import Callable

import numpy as np

from needlefit.mechanics.batch import Batch, positions_each
from needlefit.mechanics.control import Bevel, Step
from needlefit.mechanics.kernel import compiled
from needlefit.mechanics.lanes import follow_batches
from needlefit.mechanics.linearize import linearize, moved
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.simulate import simulate
from needlefit.mechanics.tissue import Tissue

ROOMS = ("kernel", "lanes", "sensitivity")

_NEEDLE = Needle.from_tube(50.0, 1.27, 80e3)
_TISSUE = Tissue(mu=np.array([0.2]), alpha=np.array([1.0]))
_BEVEL, _DEPTH = Bevel(0.1), 4.0


def warm(*rooms: str) -> None:
    """Compile those of some rooms of the kernel that are not on the disk yet; nothing if all are.

    Where no other process can be started they are compiled in this one, when they are called.
    """
    missing = [room for room in rooms if not compiled(room)]
    if missing:
        program = f"from needlefit.mechanics.warm import insert; insert({missing!r})"
        subprocess.run([sys.executable, "-c", program], check=False, capture_output=True)


def insert(rooms: list[str]) -> None:
    """Insert a needle by what some rooms hold, which compiles it."""
    for room in rooms:
        _INSERT[room]()


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
