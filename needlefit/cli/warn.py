"""Warnings on the terminal: one line each, right under the result that they are about."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from needlefit.cli import screen
from needlefit.cli.invocation import Invocation
from needlefit.project.result_warnings import ResultWarning, warnings_of


def warn(invocation: Invocation, warnings: Iterable[ResultWarning]) -> None:
    """Print warnings to stderr; with `--strict` the command then ends with exit code 5."""
    for one in warnings:
        invocation.warned = True
        screen.note(f"needlefit: warning: {one}")


def warn_of(invocation: Invocation, run: Mapping[str, Any], dataset: str = "") -> None:
    """Print the warnings that a run keeps; `dataset` is the file of its data, if that is known."""
    folder = Path(dataset).parent
    warn(invocation, (_in_folder(one, folder) for one in warnings_of(run)))


def _in_folder(one: ResultWarning, folder: Path) -> ResultWarning:
    """Return a warning about a file of a folder with the file's path."""
    file = one.where.rpartition(":")[0] or one.where
    return replace(one, where=str(folder / one.where)) if file and (folder / file).is_file() else one
