"""Differences of two runs: a join of their tables on the columns that name a row.

Rows that these columns do not tell apart are paired in their order.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from needlefit.errors import DataError
from needlefit.project.folders import require_unchanged
from needlefit.project.input_files import convert_stored_errors
from needlefit.project.json_values import to_json_values
from needlefit.reporting.number_format import format_number
from needlefit.reporting.table import Table, TableLayout
from needlefit.studies.csv_tables import read_table
from needlefit.studies.store import read_run

KEYS = frozenset(
    (
        *("dataset", "study", "fold", "fit", "role", "run", "insertion", "hole", "specimen", "medium"),
        *("method", "boundaries", "comparison", "grouping", "layers", "layer", "specimen_treatment"),
        *("parameter", "metric", "quantity", "level", "replicate", "seed"),
        *("start", "curve", "draw", "scan", "marker", "name", "mark"),
    )
)
"""Columns that name a row, in any table."""
UNIT_KEYS = ("parameter", "metric", "quantity")  #: keys of which the unit of a number depends
STATES = ("interrupted", "posteriors", "passes", "not_calibrated", "not_converged", "faults")
INPUTS = (
    *("dataset", "medium", "recipe", "rules", "study", "fit", "folds", "hand_tuned", "versions"),
    *("source_revision", "datasets", "parts", "scene", "fits", "replicates"),
)
RUN_JSON = "run.json"
MAX_CELL_LETTERS = 16  #: characters of a value that a table shows


@dataclass(frozen=True)
class Difference:
    """What differs between run A and run B: a value of `run.json`, or a column of a table.

    Of a column `before` and `after` are those of the greatest change, and `row` is where that is.
    """

    table: str  #: file
    column: str
    row: str
    before: object  #: in A and in B, as JSON knows values; None where one of them has none
    after: object
    rows: int = 1  #: how many rows differ
    change: float | None = None  #: the greatest, without its sign; None of texts


def compare_runs(before: Path, after: Path, unverified: bool = False) -> list[Difference]:
    """Return all differences of run folder `after` from `before`: inputs, states, and numbers by column.

    Raises DataError if a `run.json` is missing, a file is damaged or (unless `unverified`) does not agree
    with its manifest, or the runs are of different kinds.
    """
    with convert_stored_errors(f"{before} or {after}"):
        faults = [", ".join(require_unchanged(folder, unverified)) or None for folder in (before, after)]
        named = "files that do not agree with it"
        found = [Difference("needlefit.json", named, "", faults[0], faults[1])] if any(faults) else []
        one, two = read_run(before), read_run(after)
        for folder, run in ((before, one), (after, two)):
            if not run.get("kind"):
                raise DataError(
                    "states no kind of study",
                    where=str(folder / RUN_JSON),
                    expected="a run of one study",
                    fix="name the folder of one study, or run it again",
                )
        kinds = [str(run["kind"]) for run in (one, two)]
        if kinds[0] != kinds[1]:
            raise DataError(
                f"is of kind {kinds[1]}, and {before} of kind {kinds[0]}: they answer different questions",
                where=str(after),
                expected=f"a run of kind {kinds[0]}",
                fix="compare runs of the same command",
            )
        leaves = [
            dict(_iterate_leaves({key: run[key] for key in (*INPUTS, *STATES) if key in run}))
            for run in (one, two)
        ]
        for key in dict.fromkeys((*leaves[0], *leaves[1])):
            values = leaves[0].get(key), leaves[1].get(key)
            found += [Difference(RUN_JSON, key, "", *values)] if values[0] != values[1] else []
        for path in sorted(before.glob("*.csv")):
            if (other := after / path.name).is_file():
                found += compare_tables(path.name, read_table(path), read_table(other))
        return found


def _iterate_leaves(value: object, path: str = "") -> Iterator[tuple[str, object]]:
    """Yield every value of nested mappings by its path; a list is one value."""
    if isinstance(value, Mapping) and (value or not path):
        for key, inner in value.items():
            yield from _iterate_leaves(inner, f"{path}.{key}" if path else str(key))
    else:
        yield path, value


_REPEAT = "__repeat"


def compare_tables(name: str, before: pd.DataFrame, after: pd.DataFrame) -> Iterator[Difference]:
    """Yield the rows that one table alone has, then the columns that differ, by unit."""
    keys = [str(one) for one in before if one in KEYS and one in after]
    frames = [_number_rows(frame, keys) for frame in (before, after)]
    both = frames[0].merge(
        frames[1], on=[*keys, _REPEAT], how="outer", suffixes=("_a", "_b"), indicator="in", sort=False
    )
    alone = both[both["in"] != "both"]
    if len(alone):
        row = _name_row(alone.iloc[0], keys)
        yield Difference(name, "rows", row, len(before), len(after), len(alone))
    for column in sorted({*before} ^ {*after}):
        there = (column if column in frame else None for frame in (before, after))
        yield Difference(name, str(column), "", next(there), next(there))
    same = both[both["in"] == "both"]
    units = [key for key in UNIT_KEYS if key in keys]
    for column in [one for one in before if one in after and one not in keys]:
        one, two = same[f"{column}_a"], same[f"{column}_b"]
        changed = same[(one != two) & ~(one.isna() & two.isna())]
        for _, rows in changed.groupby(units, sort=False) if units else [("", changed)] * bool(len(changed)):
            yield _find_greatest_change(name, str(column), rows, keys)


def _number_rows(frame: pd.DataFrame, keys: list[str]) -> pd.DataFrame:
    """Return a frame with its keys as text, and numbers of the rows that have the same ones."""
    words = frame.assign(**{key: frame[key].astype(object).fillna("").astype(str) for key in keys})
    repeats = words.groupby(keys, sort=False).cumcount() if keys else range(len(frame))
    return words.assign(**{_REPEAT: repeats})


def _find_greatest_change(name: str, column: str, rows: pd.DataFrame, keys: list[str]) -> Difference:
    """Return the difference of a column by the row of its greatest change; of texts the first row."""
    one, two = (pd.to_numeric(rows[f"{column}_{run}"], errors="coerce").astype(float) for run in "ab")
    gap = (two - one).abs()
    known = bool(np.isfinite(gap).any())
    row = rows.iloc[int(np.nanargmax(gap.where(np.isfinite(gap)))) if known else 0]
    before, after = (None if pd.isna(row[f"{column}_{run}"]) else row[f"{column}_{run}"] for run in "ab")
    change = float(gap[np.isfinite(gap)].max()) if known else None
    return Difference(name, column, _name_row(row, keys), before, after, len(rows), change)


def _name_row(row: "pd.Series[Any]", keys: list[str]) -> str:
    return ", ".join(filter(None, dict.fromkeys(str(row[key]) for key in keys)))


def summarize_differences(found: Sequence[Difference]) -> str:
    """Return in one sentence how many values differ, of results and of `run.json`."""
    if not found:
        return "No difference."
    values = [one for one in found if one.table == RUN_JSON]
    columns = [one for one in found if one.table != RUN_JSON]
    tables = len({one.table for one in columns})
    return (
        f"{sum(one.rows for one in columns)} values differ, in {tables} tables; {len(values)} keys of "
        f"{RUN_JSON} differ."
    )


def lay_out_differences(found: Sequence[Difference]) -> TableLayout:
    """Return one row per difference."""
    cells = [
        {
            **{"differs": f"{one.table}: {one.column}", "found_at": one.row, "differing_rows": one.rows},
            **{key: _format_value(getattr(one, key)) for key in ("before", "after")},
            "greatest_change": "" if one.change is None else format_number(one.change),
        }
        for one in found
    ]
    columns = ("differs", "differing_rows", "found_at", "before", "after", "greatest_change")
    caption = "Differences of B (second run) from A (first run): the greatest change of each column."
    return Table("differences", cells, columns, caption=caption).lay_out()


def differences_to_json(found: Sequence[Difference]) -> list[object]:
    return [to_json_values(asdict(one)) for one in found]


def _format_value(value: object) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return format_number(value)
    shown = str(value)
    return shown if len(shown) <= MAX_CELL_LETTERS else shown[: MAX_CELL_LETTERS - 1] + "…"
