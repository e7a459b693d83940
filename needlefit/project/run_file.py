"""`run.json`: what a run was computed with."""

import json
from pathlib import Path
from typing import Any

from needlefit.errors import DataError

RUN_FILE = "run.json"


def read_run(folder: Path) -> dict[str, Any]:
    """Return what the run in a folder says of itself; DataError if its file is missing or damaged."""
    path = folder / RUN_FILE
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise DataError(
            f"cannot be read: {error}", where=str(path), mend="run it again, or take the file from a copy"
        ) from None
    if not isinstance(table, dict):
        raise DataError("holds no table", where=str(path), mend="run it again")
    return table
