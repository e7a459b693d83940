"""Fork this process (Linux): a copy has loaded everything that it has."""

import os
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from needlefit.project.threads import count_cores

if TYPE_CHECKING:
    from collections.abc import Iterator

MAX_SHARED = 255
"""Pieces of work at most that are shared: each is one byte in a pipe."""


_SET_PARENT_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG of prctl(2)


@contextmanager
def compute_beside(work: Sequence[Callable[[], bytes]]) -> "Iterator[Callable[[], list[bytes]]]":
    """Begin pieces of work in a copy of this process; yield the function that ends and returns them.

    In between this process may do other work. That function takes the pieces that are left as well, and does
    here what the copy leaves undone, so that its errors are raised here. Work must not wait for threads of
    this process, which the copy lacks: those of typst among them.
    """
    if not 2 <= len(work) <= MAX_SHARED or not can_fork():
        yield lambda: [piece() for piece in work]
        return
    with tempfile.TemporaryDirectory(prefix="needlefit-") as name:
        folder = Path(name)
        source, sink = os.pipe()
        os.write(sink, bytes(range(len(work))))
        os.close(sink)  # readers then see the end
        copy = os.fork()
        if copy == 0:
            _compute_in_copy(work, source, folder)
        waiting = [copy]

        def end() -> list[bytes]:
            done = {n: work[n]() for n in _take(source)}
            os.waitpid(waiting.pop(), 0)
            found = {int(file.name): file.read_bytes() for file in folder.iterdir() if not file.suffix}
            parts = [done.get(n, found.get(n)) for n in range(len(work))]
            return [work[n]() if part is None else part for n, part in enumerate(parts)]

        try:
            yield end
        finally:
            for _ in _take(source):  # after an error nobody wants the rest
                pass
            os.close(source)
            for copy in waiting:
                os.waitpid(copy, 0)


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
