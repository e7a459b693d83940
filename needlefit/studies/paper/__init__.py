"""Read the published tables and parameter sets, and find where the paper contradicts itself."""

import math
from pathlib import Path
from typing import Literal

import pandas as pd

from needlefit.errors import ConfigError
from needlefit.project import locate
from needlefit.project.input_files import convert_stored_errors
from needlefit.studies.csv_tables import ANY_COLUMNS, TableSchema, read_table
from needlefit.studies.paper.claims import Claim, PublishedTables, check_all, select_rows

TableName = Literal[
    "insertions", "study_design", "tuning_by_layers", "tuning_by_media", "validation", "parameters"
]
TABLE_TITLES: dict[TableName, str] = {
    "insertions": "Table I: insertions by medium and layers traversed",
    "study_design": "Table II: fitted and held-out insertions of each study",
    "tuning_by_layers": "Table III, upper half: in-sample errors in phantom 2, by layers",
    "tuning_by_media": "Table III, lower half: in-sample errors, by medium",
    "validation": "Table IV: errors on held-out insertions",
    "parameters": "Table V: parameters (printed without units; read as Pa and mm)",
}


_SCHEMAS: dict[TableName, TableSchema] = {"parameters": TableSchema(keys=("set",))}


def read_published_table(name: TableName) -> pd.DataFrame:
    """Read one published table from `data/paper/<name>.csv`.

    Raises ConfigError if no project root holds the file. Raises DataError if it is no table, or lacks a
    column.
    """
    path = _find_file(name)
    return read_table(path, _SCHEMAS.get(name, ANY_COLUMNS))


def read_printed_table(name: TableName) -> pd.DataFrame:
    """Read one published table with its numbers as texts, as they are printed: 33.60, 12.0.

    Raises ConfigError, DataError as `read_published_table`.
    """
    names = tuple(map(str, read_published_table(name)))
    return read_table(_find_file(name), TableSchema(texts=names)).fillna("")


def read_hand_tuned(name: str) -> dict[str, float]:
    """Read one row of the parameter table, by parameter name (`mu1_pa`, `alpha1`, ..., `bevel_mm`).

    Raises ConfigError if there is no such row.
    """
    published = {"parameters": read_published_table("parameters")}
    with convert_stored_errors(_find_file("parameters")):
        found = select_rows(published, "parameters", set=name)
    if not found:
        known = ", ".join(read_hand_tuned_names())
        raise ConfigError(f"the paper has no parameter set called `{name}`", expected=f"one of {known}")
    numbers = {key: value for key, value in found[0].items() if isinstance(value, int | float)}
    return {key: float(value) for key, value in numbers.items() if not math.isnan(value)}


def read_hand_tuned_names() -> tuple[str, ...]:
    """Return the names of the rows of the parameter table."""
    return tuple(read_published_table("parameters")["set"])


def check_claims() -> list[Claim]:
    """Return every claim of the paper that was checked against its tables, whether it holds or not."""
    published: PublishedTables = {name: read_published_table(name) for name in TABLE_TITLES}
    with convert_stored_errors(_find_file("parameters").parent):
        return check_all(published)


def find_contradictions() -> list[Claim]:
    """Return the claims of the paper that its own tables contradict, with both places and numbers.

    Every entry whose numbers stand in the tables is computed from them; a claim that the tables bear out
    is left out.
    """
    return [claim for claim in check_claims() if not claim.agrees]


def _find_file(name: str) -> Path:
    for root in locate.search_roots():
        path = root / "data" / "paper" / f"{name}.csv"
        if path.is_file():
            return path
    raise ConfigError(
        f"the published table `{name}` is missing",
        where=f"data/paper/{name}.csv",
        fix="restore data/paper, or install needlefit again",
    )
