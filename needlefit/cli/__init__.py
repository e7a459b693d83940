"""The command line: parse, call, print. Everything else is imported where a command needs it."""

import sys
from collections.abc import Sequence

from needlefit.cli import failure, streams
from needlefit.cli.application import build
from needlefit.cli.invocation import Invocation
from needlefit.project.threads import begin_with_one_thread


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one command and leave the interpreter with its exit code."""
    streams.install()
    begin_with_one_thread()
    words = tuple(sys.argv[1:] if arguments is None else arguments)
    try:
        build()(args=list(words), prog_name="needlefit", obj=Invocation(words))
    except SystemExit as leaving:
        fault = streams.fault_of_stdout()
        if fault is None:
            raise
        code = failure.report(fault, Invocation(words))
        raise SystemExit(leaving.code or code) from None
