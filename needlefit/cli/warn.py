"""Warnings on the terminal: one line each, right under the result that they are about."""

import sys
from collections.abc import Iterable, Mapping
from typing import Any

from needlefit.cli import screen
from needlefit.cli.invocation import Invocation
from needlefit.project.result_warnings import ResultWarning, warnings_of


def warn(invocation: Invocation, warnings: Iterable[ResultWarning]) -> None:
    """Print warnings to stderr; with `--strict` the command then ends with exit code 5."""
    sys.stdout.flush()  # where both go to one file, they come after the result
    for one in warnings:
        invocation.warned = True
        screen.note(f"needlefit: warning: {one}")


def warn_of(invocation: Invocation, run: Mapping[str, Any]) -> None:
    """Print the warnings that a run keeps in its `run.json`."""
    warn(invocation, warnings_of(run))
