"""Fork this process (Linux): a copy has loaded everything that it has."""

import os
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from needlefit.project.threads import count_cores

if TYPE_CHECKING:
    from collections.abc import Iterator

MAX_SHARED = 255
"""Pieces of work at most that are shared: each is one byte in a pipe."""


_ENDING_SIGNALS = (
    {signal.SIGTERM, signal.SIGHUP, signal.SIGINT} if sys.platform == "linux" else set[signal.Signals]()
)

_SET_PARENT_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG of prctl(2)


@contextmanager
def compute_beside(work: Sequence[Callable[[], bytes]]) -> "Iterator[Callable[[], list[bytes]]]":
    """Begin pieces of work in a copy of this process; yield a function that returns what they give.

    Until it is called this process may do other work. It then takes its share of the pieces that are left.
    What failed in the copy is repeated here, so that its errors are raised here. Work must not wait for
    threads of this process, which the copy lacks: those of typst among them.
    """
    if not 2 <= len(work) <= MAX_SHARED or not can_fork():
        yield lambda: [piece() for piece in work]
        return
    with tempfile.TemporaryDirectory(prefix="needlefit-") as name:
        folder = Path(name)
        source, sink = os.pipe()
        os.write(sink, bytes(range(len(work))))
        os.close(sink)  # readers then see the end
        parent, copies = os.getpid(), []
        with block_signals(), suppress(OSError):  # without a copy all is done here
            copies.append(os.fork())
            if copies[0] == 0:
                _compute_in_copy(work, source, folder, parent)

        def end() -> list[bytes]:
            done = {n: work[n]() for n in _take(source)}
            _wait_for(copies)
            found = {int(file.name): file.read_bytes() for file in folder.iterdir() if not file.suffix}
            parts = [done.get(n, found.get(n)) for n in range(len(work))]
            return [work[n]() if part is None else part for n, part in enumerate(parts)]

        try:
            yield end
        finally:
            for _ in _take(source):  # after an error nobody wants the rest
                pass
            os.close(source)
            _wait_for(copies)


def _wait_for(copies: list[int]) -> None:
    """Wait until copies have ended, and forget them."""
    for copy in copies:
        with suppress(ChildProcessError):  # where ended processes are not kept
            os.waitpid(copy, 0)
    copies.clear()


@contextmanager
def block_signals() -> "Iterator[None]":
    """Let signals that end a process wait while it is forked: a copy may not have handlers of its own yet."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDING_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def begin_copy(parent: int) -> None:
    """Let a copy end with its parent, by its id, and by signals; Ctrl-C is left to the parent."""
    end_with(parent)
    for number in _ENDING_SIGNALS:  # the parent's handlers only note them
        signal.signal(number, signal.SIG_IGN if number == signal.SIGINT else signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDING_SIGNALS)


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


def _compute_in_copy(work: Sequence[Callable[[], bytes]], source: int, folder: Path, parent: int) -> NoReturn:
    """Do pieces of work, leave each as a file, and end without what this process would do at its end."""
    try:
        begin_copy(parent)
        for n in _take(source):
            unfinished = folder / f"{n}.part"
            unfinished.write_bytes(work[n]())
            unfinished.rename(folder / str(n))
    finally:
        os._exit(0)
