"""Ctrl-C once: finish the step and save. Twice: leave at once."""

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType

from needlefit.cli.failure import INTERRUPTED

_ONCE = b"\nneedlefit: stopping after this step; Ctrl-C again leaves at once\n"
_SHOW_CURSOR = b"\x1b[?25h"


@contextmanager
def stopping() -> Iterator[Callable[[], bool]]:
    """Yield the question "has Ctrl-C been pressed?" for the time of a long run."""
    pressed = threading.Event()

    def on_signal(number: int, frame: FrameType | None) -> None:
        if pressed.is_set():
            if sys.stderr.isatty():
                _write(_SHOW_CURSOR)
            os._exit(INTERRUPTED)  # threads that are still computing would hold up any softer way out
        pressed.set()
        _write(_ONCE)

    before = signal.signal(signal.SIGINT, on_signal)
    try:
        yield pressed.is_set
    finally:
        signal.signal(signal.SIGINT, before)


def _write(text: bytes) -> None:
    """Write to stderr, if anybody still reads it; print() may not be entered again from inside a print()."""
    with suppress(OSError):
        os.write(2, text)
