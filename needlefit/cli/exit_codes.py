"""How a command ends: its exit code, its error message, and what Ctrl-C does."""

import errno
import os
import shlex
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType

from needlefit.errors import (
    ConfigError,
    FitError,
    NeedlefitError,
    UnfinishedWorkError,
    printable,
    without_controls,
)


@dataclass
class Invocation:
    """One call of the program, and the values of its common options.

    `resumes` is whether the command has `--resume`.
    `warned` is whether a warning was printed: with `strict` the exit code then is that of no convergence.
    `noted` are lines that were printed before the work.
    """

    words: tuple[str, ...]
    seed: int | None = None
    jobs: int | None = None
    scheduler: str | None = None
    insecure: bool = False
    out: Path = Path("reports")
    reference: bool = False
    resume: bool = False
    resumes: bool = True
    strict: bool = False
    explain: bool = False
    json: bool = False
    quiet: bool = False
    verbose: bool = False
    warned: bool = False
    noted: list[str] = field(default_factory=list)

    def repeat(self, *more: str) -> str:
        """Return this command line with further words."""
        return shlex.join(("needlefit", *self.words, *more))

    def resuming(self) -> str:
        """Return the command line that goes on where this one stopped."""
        return self.repeat(*() if "--resume" in self.words or not self.resumes else ("--resume",))

    def interrupt_message(self) -> str:
        """Return the line with the command that goes on."""
        return f"needlefit: interrupted; to go on: {self.resuming()}"


# exit codes of an error that is a bug, of a fit that did not converge, and of Ctrl-C
UNEXPECTED, NOT_CONVERGED, INTERRUPTED = 1, 5, 130

EXIT_CODES = {
    0: "ok",
    UNEXPECTED: "unexpected",
    2: "usage",
    ConfigError.exit_code: "bad data or configuration",
    FitError.exit_code: "the solver failed",
    NOT_CONVERGED: "not converged, or a warning with --strict (result written)",
    INTERRUPTED: "interrupted",
}


def report_error(error: BaseException, invocation: Invocation) -> int:
    """Say what went wrong and return the exit code."""
    if isinstance(error, KeyboardInterrupt) or type(error).__name__ == "Abort":
        print("needlefit: interrupted", file=sys.stderr)
        return INTERRUPTED
    if hasattr(error, "show"):  # of the words that were typed, which it repeats
        error.message = printable(str(error.message))  # type: ignore[attr-defined]
        error.show()
        return int(error.exit_code)  # type: ignore[attr-defined]
    if invocation.verbose:
        traceback.print_exception(error)
    error = _to_user_error(error, invocation)
    if isinstance(error, NeedlefitError):
        print(f"needlefit: {error}", file=sys.stderr)
        if isinstance(error, UnfinishedWorkError):
            print(f"needlefit: to go on with it: {without_controls(invocation.resuming())}", file=sys.stderr)
        return error.exit_code
    hint = "" if invocation.verbose else " (needlefit -v ... shows where)"
    print(f"needlefit: unexpected {type(error).__name__}: {error}{hint}", file=sys.stderr)
    return UNEXPECTED


_EXTRAS = {"distributed": "cluster"}  # names of extras, of the packages that needlefit works without


# advice where a write fails, by the error's number: such errors name no file, and are about the results
_SPACE_ADVICE = {
    errno.ENOSPC: "free some space",
    errno.EDQUOT: "free some space",
    errno.EFBIG: "raise the limit of the size of files (ulimit -f)",
}


def _to_user_error(error: BaseException, invocation: Invocation) -> BaseException:
    """Return an error of Python's of which it is known what a user can do, as one that states it."""
    if isinstance(error, OSError):
        advice = _SPACE_ADVICE.get(error.errno or 0, "")
        return ConfigError(
            f"cannot be read or written: {error.strerror or error}",
            expected="a place that you may read and write",
            fix=f"{advice or 'check the path and its permissions'}, or choose another folder",
            where=error.filename or (invocation.out if advice else ""),
        )
    if isinstance(error, MemoryError):
        return ConfigError(
            "there is not enough memory for this",
            fix="use fewer --jobs, or smaller inputs",
        )
    extra = _EXTRAS.get((getattr(error, "name", None) or "").partition(".")[0])
    if isinstance(error, ModuleNotFoundError) and extra:
        return ConfigError(f"{error.name} is not installed", fix=f"pip install 'needlefit[{extra}]'")
    return error


_FIRST_INTERRUPT_MESSAGE = b"\nneedlefit: stopping after this step; Ctrl-C again leaves at once\n"
STOP_SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
"""Signals that stop a run; Windows has no SIGHUP."""
_SHOW_CURSOR = b"\x1b[?25h"


@contextmanager
def catch_interrupts(invocation: Invocation) -> Iterator[Callable[[], bool]]:
    """Yield whether the run is to stop, after Ctrl-C, SIGTERM or SIGHUP; the second one ends it at once.

    Either way the command line that goes on is printed.
    """
    pressed = threading.Event()

    def on_signal(number: int, frame: FrameType | None) -> None:
        if pressed.is_set():
            _write(
                without_controls(f"\n{invocation.interrupt_message()}\n").encode(errors="backslashreplace")
            )
            if sys.stderr.isatty():
                _write(_SHOW_CURSOR)
            os._exit(INTERRUPTED)  # threads that are still computing would hold up any softer way out
        pressed.set()
        _write(_FIRST_INTERRUPT_MESSAGE)

    before = {number: signal.signal(number, on_signal) for number in STOP_SIGNALS}
    try:
        yield pressed.is_set
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _write(text: bytes) -> None:
    """Write to stderr, if anybody still reads it; print() may not be entered again from inside a print()."""
    with suppress(OSError):
        os.write(2, text)
