"""Write the tables of a run; equal tables give equal bytes."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from needlefit.project.json_values import to_json_values


def write_csv(frame: pd.DataFrame, path: Path, digits: str | None = "%.8g") -> None:
    """Write a table as CSV; `digits` None writes all digits."""
    frame.to_csv(path, index=False, float_format=digits, lineterminator="\n", encoding="utf-8")


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Write values as JSON with sorted keys; NaN and infinity become null."""
    text = json.dumps(to_json_values(value), indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")


def all_files(folder: Path) -> list[Path]:
    """Return all files in a folder and its subfolders."""
    return sorted(path for path in folder.rglob("*") if path.is_file())
