"""Write the tables of a run; equal tables give equal bytes."""

import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from needlefit.project.json_values import to_json_values
from needlefit.reporting.tidy import to_tidy


def write_csv(frame: pd.DataFrame, path: Path, digits: str | None = "%.8g") -> None:
    """Write a table as CSV, tidy; `digits` None writes all digits."""
    write_csv_pieces([frame], path, digits)


def write_csv_pieces(pieces: Iterable[pd.DataFrame], path: Path, digits: str | None = "%.8g") -> None:
    """Write a table as `write_csv`, whose rows come in pieces."""
    with path.open("w", encoding="utf-8", newline="") as file:
        for n, piece in enumerate(pieces):
            to_tidy(piece).to_csv(file, index=False, header=n == 0, float_format=digits, lineterminator="\n")


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Write values as JSON with sorted keys; NaN and infinity become null."""
    text = json.dumps(to_json_values(value), indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")


def all_files(folder: Path) -> list[Path]:
    """Return all files in a folder and its subfolders."""
    return sorted(path for path in folder.rglob("*") if path.is_file())


Row = dict[str, Any]


def to_records(frame: pd.DataFrame) -> list[Row]:
    """Return the rows as JSON values; missing values are None."""
    return [{str(k): _to_plain_value(v) for k, v in row.items()} for row in frame.to_dict("records")]


def _to_plain_value(value: object) -> object:
    """Return a value that JSON can store: NaN and infinity become None, numpy scalars become Python's."""
    value = value.item() if hasattr(value, "item") else value
    if value is pd.NA or value is pd.NaT or (isinstance(value, float) and not math.isfinite(value)):
        return None
    return value
