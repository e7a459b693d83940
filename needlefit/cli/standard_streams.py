"""stdout and stderr of the program, which never end a command: closed, full, unread, or of few characters.

A long run must not be lost because the reader of its messages has gone. So a failed write is remembered and
the command goes on: output that nobody reads any more is no failure, output that a disk did not take is.
"""

import errno
import io
import os
import sys
from typing import Any, TextIO

from needlefit.errors import ConfigError


class _Outlet(io.FileIO):
    """A descriptor of which the first failed write is remembered, and what follows is dropped."""

    def __init__(self, descriptor: int) -> None:
        super().__init__(descriptor, "w", closefd=False)
        self.fault: OSError | None = None

    def write(self, data: Any, /) -> int:  # noqa: ANN401 - whatever bytes are in
        """Write, or pretend to once that has failed."""
        if self.fault is None:
            try:
                return super().write(data)
            except OSError as error:
                self.fault = error
        return memoryview(data).nbytes


def install_streams() -> None:
    """Put such streams in the place of stdout and stderr, and the null device in that of closed ones.

    A closed descriptor would be given to the next file that is opened, which messages then went into.
    Characters that the encoding of a stream has not are replaced. What another program put there stays.
    """
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest that is free: this one
    sys.stdin = sys.stdin or open(0, encoding="utf-8", closefd=False)  # noqa: SIM115 - as long as the program
    if sys.stdout is sys.__stdout__:
        sys.stdout = _wrap_descriptor(sys.stdout, 1)
    if sys.stderr is sys.__stderr__:
        sys.stderr = _wrap_descriptor(sys.stderr, 2)


def find_stdout_fault() -> ConfigError | None:
    """Return what kept the output of the command from being written, if anything did.

    None also where the reader has had enough, as `head` has.
    """
    try:
        sys.stdout.flush()
    except OSError as error:
        fault: OSError | None = error
    else:
        outlet = getattr(getattr(sys.stdout, "buffer", None), "raw", None)
        fault = outlet.fault if isinstance(outlet, _Outlet) else None
        if fault is not None and fault.errno in (errno.EPIPE, errno.EBADF):
            fault = None
    if fault is None:
        return None
    return ConfigError(
        f"the output is incomplete: {fault.strerror or fault}",
        where="standard output",
        expected="a terminal, a pipe, or a file with space left",
        fix="send the output elsewhere, or free some space, and run the command again",
    )


def _wrap_descriptor(before: TextIO | None, descriptor: int) -> TextIO:
    if before is not None:
        before.flush()
    outlet = _Outlet(descriptor)
    encoding = (before.encoding if before is not None else None) or "utf-8"
    return io.TextIOWrapper(
        io.BufferedWriter(outlet),
        encoding=encoding,
        errors="replace",
        line_buffering=descriptor == 2 or outlet.isatty(),
        write_through=getattr(before, "write_through", False),
    )
