"""The command line: parse, call, print. Everything else is imported where a command needs it."""

import atexit
import gc
import os
import sys
from collections.abc import Sequence

from needlefit.cli import exit_codes, standard_streams
from needlefit.cli.application import build
from needlefit.cli.exit_codes import Invocation
from needlefit.project.processes import limit_to_one_thread


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one command and leave the interpreter with its exit code."""
    # Python looks through all objects for cycles when it ends, which takes a sixth of `simulate`: memory that
    # the system frees anyway. What must happen at exit is registered, or closed by `with`.
    atexit.register(gc.freeze)
    standard_streams.install_streams()
    limit_to_one_thread()
    os.environ.setdefault("MPLBACKEND", "agg")  # else matplotlib loads pyplot to look for a display
    words = tuple(sys.argv[1:] if arguments is None else arguments)
    try:
        build()(args=list(words), prog_name="needlefit", obj=Invocation(words))
    except SystemExit as leaving:
        fault = standard_streams.find_stdout_fault()
        if fault is None:
            raise
        code = exit_codes.report_error(fault, Invocation(words))
        raise SystemExit(leaving.code or code) from None
