"""The command line: parse, call, print. Everything else is imported where a command needs it."""

import atexit
import gc
import os
import sys
from collections.abc import Sequence
from contextlib import suppress

from needlefit.cli import exit_codes
from needlefit.cli.exit_codes import Invocation
from needlefit.project.processes import limit_to_one_thread


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one command and leave the interpreter with its exit code."""
    # Python looks through all objects for cycles when it ends, which takes a sixth of `simulate`: memory that
    # the system frees anyway. What must happen at exit is registered, or closed by `with`.
    atexit.register(gc.freeze)
    # It would also look whenever so many more objects exist: modules alone are 300 000, which stay.
    gc.set_threshold(1_000_000, 50, 50)
    _prepare_streams()
    limit_to_one_thread()
    os.environ.setdefault("MPLBACKEND", "agg")  # else matplotlib loads pyplot to look for a display
    # else pydantic reads the metadata of all installed packages, a tenth of `simulate`
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    invocation = Invocation(tuple(sys.argv[1:] if arguments is None else arguments))
    code = _run(invocation)
    try:
        sys.stdout.flush()
    except OSError as error:  # a full disk
        code = code or exit_codes.report_error(error, invocation)
        with suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # Python flushes it once more
    raise SystemExit(code)


def _prepare_streams() -> None:
    """Replace characters that a stream's encoding has not; use the null device for a closed stream."""
    for name in ("stdout", "stderr"):
        if (stream := getattr(sys, name)) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: PTH123, SIM115
        elif hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")


def _run(invocation: Invocation) -> int:
    from needlefit.cli.application import build

    try:
        # an option of all commands, wherever it stands
        words = sorted(invocation.words, key=lambda word: word not in ("-v", "--verbose"))
        app = build()
        # not standalone: it raises errors, and returns the code of an early exit
        code = app(args=words, prog_name="needlefit", obj=invocation, standalone_mode=False)
    except Exception as error:
        return exit_codes.report_error(error, invocation)
    return code or (exit_codes.NOT_CONVERGED if invocation.strict and invocation.warned else 0)
