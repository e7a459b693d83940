"""Fork this process (Linux): a copy has loaded everything that it has."""

import os
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from needlefit.project.threads import count_cores

if TYPE_CHECKING:
    from collections.abc import Iterator

MAX_SHARED = 255
"""Pieces of work at most that are shared: each is one byte in a pipe."""


_SET_PARENT_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG of prctl(2)


def compute_in_two_processes(work: Sequence[Callable[[], bytes]]) -> list[bytes]:
    """Return what each piece of work gives; a copy of this process takes every second one, or as it comes.

    What the copy leaves undone is done here, so that its errors are raised here. Work must not wait for
    threads of this process, which the copy lacks: those of typst among them.
    """
    if not 2 <= len(work) <= MAX_SHARED or not can_fork():
        return [piece() for piece in work]
    with tempfile.TemporaryDirectory(prefix="needlefit-") as name:
        folder = Path(name)
        source, sink = os.pipe()
        os.write(sink, bytes(range(len(work))))
        os.close(sink)  # readers then see the end
        copy = os.fork()
        if copy == 0:
            _compute_in_copy(work, source, folder)
        done = {}
        try:
            done = {n: work[n]() for n in _take(source)}
        finally:
            os.close(source)
            os.waitpid(copy, 0)
        found = {int(file.name): file.read_bytes() for file in folder.iterdir() if not file.suffix}
    return [done[n] if n in done else found[n] if n in found else piece() for n, piece in enumerate(work)]


def can_fork() -> bool:
    """Return whether a copy works: libraries of macOS do not survive it, nor do locks that threads hold.

    Threads of libraries are not seen: a copy must not wait for one that has worked here, such as typst's.
    """
    return sys.platform == "linux" and count_cores() > 1 and threading.active_count() == 1


def end_with(parent: int) -> None:
    """Let this process be ended together with its parent, by its id, where the system offers it."""
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(_SET_PARENT_DEATH_SIGNAL, signal.SIGKILL)
        if os.getppid() != parent:  # it ended before
            os._exit(1)


def _take(source: int) -> "Iterator[int]":
    """Yield the numbers that nobody has taken."""
    while taken := os.read(source, 1):
        yield taken[0]


def _compute_in_copy(work: Sequence[Callable[[], bytes]], source: int, folder: Path) -> NoReturn:
    """Do pieces of work, leave each as a file, and end without what this process would do at its end."""
    try:
        for n in _take(source):
            unfinished = folder / f"{n}.part"
            unfinished.write_bytes(work[n]())
            unfinished.rename(folder / str(n))
    finally:
        os._exit(0)
