"""The published tables as frames, the hand-tuned parameter sets, and where the paper contradicts itself."""

import math
from pathlib import Path
from typing import Literal

import pandas as pd

from needlefit.errors import ConfigError
from needlefit.project import places
from needlefit.project.reading import stored_values
from needlefit.validation.csv_tables import ANY, TableForm, read_table
from needlefit.validation.paper import counts, explanations
from needlefit.validation.paper.claims import BOUNDS, Claim, Tables, rows

Table = Literal[
    "insertions", "study_design", "tuning_by_layers", "tuning_by_media", "validation", "parameters"
]
TABLES: dict[Table, str] = {
    "insertions": "Table I: insertions by medium and layers traversed",
    "study_design": "Table II: what tunes and what validates each study",
    "tuning_by_layers": "Table III, upper half: errors of the tuned model in phantom 2, by layers",
    "tuning_by_media": "Table III, lower half: errors of the tuned models, by medium",
    "validation": "Table IV: errors of the validation studies",
    "parameters": "Table V: parameters tuned by hand (no units printed; read as Pa and mm)",
}


_FORMS: dict[Table, TableForm] = {"parameters": TableForm(keys=("set",))}


def table(name: Table) -> pd.DataFrame:
    """Return one published table, as `data/paper/<name>.csv` holds it.

    Raises
    ------
    ConfigError
        If no project root holds the file.
    DataError
        If it is no table, or lacks a column.
    """
    path = _file(name)
    return read_table(path, _FORMS.get(name, ANY))


def hand_tuned(name: str) -> dict[str, float]:
    """Return one row of the parameter table by parameter name (`mu1_pa`, `alpha1`, ..., `bevel_mm`).

    Raises
    ------
    ConfigError
        If there is no such row.
    """
    published = {"parameters": table("parameters")}
    with stored_values(_file("parameters")):
        found = rows(published, "parameters", set=name)
    if not found:
        known = ", ".join(hand_tuned_names())
        raise ConfigError(f"the paper has no hand-tuned set called `{name}`", expected=f"one of {known}")
    return {key: float(value) for key, value in found[0].items() if _is_number(value)}


def hand_tuned_names() -> tuple[str, ...]:
    """Return the names of the rows of the parameter table."""
    return tuple(table("parameters")["set"])


def checked_claims() -> list[Claim]:
    """Return every claim of the paper that was held against its tables, whether it holds or not."""
    published: Tables = {name: table(name) for name in TABLES}
    with stored_values(_file("parameters").parent):
        return [check(published) for check in _CHECKS]


def contradictions() -> list[Claim]:
    """Return what the paper says in one place and not in another, each with both places and their numbers.

    Every entry whose numbers stand in the tables is computed from them; a claim that the tables bear out
    is left out.
    """
    return [claim for claim in checked_claims() if not claim.holds]


_CHECKS = (
    counts.four_and_three,
    counts.tuning_count,
    counts.chicken,
    counts.plural,
    explanations.maximum_called_average,
    explanations.halves,
    *(bound.check for bound in BOUNDS),
    explanations.deeper,
    explanations.chicken_depth,
    explanations.edp_everywhere,
    explanations.edp_two_layers,
    explanations.edp_depth,
    counts.table_numbers,
)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not math.isnan(value)


def _file(name: str) -> Path:
    for root in places.roots():
        path = root / "data" / "paper" / f"{name}.csv"
        if path.is_file():
            return path
    raise ConfigError(
        f"the published table `{name}` is missing",
        where=f"data/paper/{name}.csv",
        mend="restore data/paper, or install needlefit again",
    )
