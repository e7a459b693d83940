"""`run.json`: what a run was computed with."""

from pathlib import Path
from typing import Any

from needlefit.errors import DataError
from needlefit.project.reading import read_json

RUN_FILE = "run.json"


def read_run(folder: Path) -> dict[str, Any]:
    """Return what the run in a folder says of itself; DataError if its file is missing or damaged."""
    path = folder / RUN_FILE
    table = read_json(path)
    if not isinstance(table, dict):
        raise DataError("holds no table", where=str(path), mend="run it again")
    return table
