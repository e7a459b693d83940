"""Read the published tables and parameter sets."""

from pathlib import Path
from typing import Any, Literal

import pandas as pd

from needlefit.errors import ConfigError
from needlefit.project import locate
from needlefit.project.input_files import convert_stored_errors

TableName = Literal[
    "insertions", "study_design", "tuning_by_layers", "tuning_by_media", "validation", "parameters"
]
"""Tables I and II, both halves of table III, IV, and V, whose parameters are read as Pa and mm."""


def read_published_table(name: TableName) -> pd.DataFrame:
    """Read one published table from `data/paper/<name>.csv`.

    Raises ConfigError if no project root holds the file, DataError if it is no table.
    """
    with convert_stored_errors(path := _find_file(name)):
        return pd.read_csv(path)


def read_hand_tuned(name: str) -> dict[str, float]:
    """Read one row of the parameter table, by parameter name (`mu1_pa`, `alpha1`, ..., `bevel_mm`).

    Raises ConfigError if there is no such row.
    """
    with convert_stored_errors(_find_file("parameters")):
        rows = select_rows("parameters", set=name)
    if not rows:
        names = ", ".join(read_hand_tuned_names())
        raise ConfigError(f"the paper has no parameter set called `{name}`", expected=f"one of {names}")
    return {key: float(value) for key, value in rows[0].items() if isinstance(value, int | float)}


def read_hand_tuned_names() -> tuple[str, ...]:
    """Return the names of the rows of the parameter table."""
    return tuple(read_published_table("parameters")["set"])


def _find_file(name: str) -> Path:
    for root in locate.search_roots():
        path = root / "data" / "paper" / f"{name}.csv"
        if path.is_file():
            return path
    raise ConfigError(
        f"the published table `{name}` is missing",
        fix="restore data/paper, or install needlefit again",
        where=f"data/paper/{name}.csv",
    )


def select_rows(name: TableName, **match: object) -> list[dict[str, Any]]:
    """Return the rows of one published table whose cells equal `match`; errors as `read_published_table`."""
    table = read_published_table(name).astype(object)
    names, cells = list(map(str, table)), table.where(table.notna(), None).to_numpy().tolist()
    rows = [dict(zip(names, row, strict=True)) for row in cells]
    return [row for row in rows if all(row[key] == value for key, value in match.items())]
