"""The command line: parse, call, print. Everything else is imported where a command needs it."""

import sys
from collections.abc import Sequence

from needlefit.cli.application import build
from needlefit.cli.invocation import Invocation


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one command and leave the interpreter with its exit code."""
    words = tuple(sys.argv[1:] if arguments is None else arguments)
    build()(args=list(words), prog_name="needlefit", obj=Invocation(words))
