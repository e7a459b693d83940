"""Compile the kernel ahead of its use, in separate processes, once for all processes that start together.

The compiled code does not depend on the process that compiles it. Separate processes return the memory (300
MB each) when they end, and other processes wait for them instead of compiling the same code. Two of them work
side by side: numba compiles on one thread at a time.
"""

import gc
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import numpy as np

from needlefit.mechanics.batch import Batch, compute_batch_positions
from needlefit.mechanics.control import Bevel, Step
from needlefit.mechanics.kernel.cache import find_cache_folder, is_complete, mark_complete
from needlefit.mechanics.lanes import simulate_batches
from needlefit.mechanics.linearize import differentiate_positions, linearize
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.simulate import simulate
from needlefit.mechanics.tissue import Tissue

try:
    import fcntl
except ImportError:  # Windows: processes that begin at the same time all compile
    fcntl = None  # type: ignore[assignment]

KERNEL_PARTS = ("kernel", "lanes", "sensitivity")

SIDE_BY_SIDE = (("kernel", "sensitivity"), ("lanes",))
"""Parts that one process compiles. Derivatives contain the simulation, which is then compiled already."""

MAX_WAIT_S, POLL_INTERVAL_S = 300.0, 0.1
"""Longest wait for another process that compiles, and the time between two checks."""

_NEEDLE = Needle.from_tube(50.0, 1.27, 80e3)
_TISSUE = Tissue(mu=np.array([0.2]), alpha=np.array([1.0]))
_BEVEL, _DEPTH = Bevel(0.1), 4.0


def precompile(*parts: str) -> None:
    """Compile those parts of the kernel that are not on disk yet.

    Where no other process can be started they are compiled in this one, when they are called.
    """
    if all(map(is_complete, parts)):
        return
    with _hold_lock(find_cache_folder().path / "lock"):
        missing = [part for part in parts if not is_complete(part)]  # another process may have compiled
        groups = [[part for part in missing if part in group] for group in SIDE_BY_SIDE]
        for process in [_start_compiling(group) for group in groups if group]:
            if process is not None:
                process.wait()


def _start_compiling(parts: list[str]) -> "subprocess.Popen[bytes] | None":
    """Start a process that compiles some parts; None where no process can be started."""
    program = f"from needlefit.mechanics.precompile import compile_parts; compile_parts({parts!r})"
    silent = subprocess.DEVNULL
    try:
        return subprocess.Popen([sys.executable, "-c", program], stdin=silent, stdout=silent, stderr=silent)
    except OSError:
        return None


@contextmanager
def _hold_lock(lock: Path) -> Iterator[None]:
    """Hold a lock, which ends with this process; after `MAX_WAIT_S`, or without locks, go on."""
    with ExitStack() as stack:
        if fcntl is not None:
            with suppress(OSError):
                _wait_for_lock(stack.enter_context(lock.open("w")).fileno())
        yield


def _wait_for_lock(file: int) -> None:
    until = time.monotonic() + MAX_WAIT_S
    while time.monotonic() < until:
        with suppress(BlockingIOError):
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        time.sleep(POLL_INTERVAL_S)


def compile_parts(parts: list[str]) -> None:
    """Compile parts of the kernel by simulating a needle with each of them, in a process of its own."""
    gc.disable()  # a tenth of the time; the memory is returned when the process ends
    for part in parts:
        _COMPILERS[part]()
        mark_complete(part)


def _compile_scalar() -> None:
    simulate(_NEEDLE, _TISSUE, _BEVEL, _DEPTH)


def _compile_lanes() -> None:
    batch = Batch(_NEEDLE, _TISSUE, (Step(_DEPTH, _BEVEL),), mu=np.full((2, 1), 0.2))
    for shapes in simulate_batches([batch], 1):
        compute_batch_positions(shapes, np.array([0.0, _DEPTH]))


def _compile_sensitivity() -> None:
    shape, jacobian = linearize(_NEEDLE, _TISSUE, _BEVEL, _DEPTH)
    differentiate_positions(shape, jacobian, np.array([0.0, _DEPTH]))


_COMPILERS: dict[str, Callable[[], None]] = {
    "kernel": _compile_scalar,
    "lanes": _compile_lanes,
    "sensitivity": _compile_sensitivity,
}
