"""Differences of two runs: `run.json` key by key, and a join of their tables on the columns that name a row.

Rows that these columns do not tell apart are paired in their order.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd

from needlefit.errors import DataError
from needlefit.reporting.number_format import format_number
from needlefit.reporting.table import Table, TableLayout
from needlefit.reporting.table_files import Row, to_records
from needlefit.studies.report import list_files
from needlefit.studies.store import restore_run

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
COLUMNS = ("table", "column", "row", "before", "after", "rows", "change")
RUN_JSON = "run.json"
MAX_CELL_LETTERS = 24  #: characters of a value that a table shows


def compare_runs(before: Path, after: Path) -> pd.DataFrame:
    """Return the differences of run folder `after` from `before`: keys of `run.json`, and columns of tables.

    Of a column `row`, `before`, `after` and `change` are those of the greatest change, for each unit in it;
    `rows` is how many rows differ.

    Raises DataError as `restore_run`, or if the runs are of different kinds.
    """
    runs = [restore_run(folder) for folder in (before, after)]
    if runs[0].kind != runs[1].kind:
        raise DataError(
            f"is of kind {runs[1].kind}, and {before} of kind {runs[0].kind}",
            where=str(after),
            expected=f"a run of kind {runs[0].kind}",
            fix="compare runs of the same command",
        )
    one, two = (pd.json_normalize(run.run_json).iloc[0].to_dict() for run in runs)
    keys = [key for key in {**one, **two} if one.get(key) != two.get(key)]
    found: list[Row] = [_row(RUN_JSON, key, "", one.get(key), two.get(key)) for key in keys]
    tables, others = map(list_files, runs)
    for name, frame in tables.items():
        other = others.get(name)
        if isinstance(frame, pd.DataFrame) and isinstance(other, pd.DataFrame):
            found += _compare_tables(f"{name}.csv", frame, other)
    return pd.DataFrame(found, columns=list(COLUMNS), dtype=object)


def _row(*values: Any, rows: int = 1, change: float | None = None) -> Row:  # noqa: ANN401 - any cell
    return dict(zip(COLUMNS, (*values, rows, change), strict=True))


def _compare_tables(name: str, before: pd.DataFrame, after: pd.DataFrame) -> Iterator[Row]:
    """Yield a row for the rows that one table alone has, then for each column that differs."""
    keys = [str(one) for one in before if one in KEYS and one in after]
    numbered = []
    for frame in (before, after):
        words = frame.assign(**{key: frame[key].astype(object).fillna("").astype(str) for key in keys})
        repeats = words.groupby(keys, sort=False).cumcount() if keys else range(len(frame))
        numbered.append(words.assign(repeat_=repeats))
    both = numbered[0].merge(
        numbered[1], on=[*keys, "repeat_"], how="outer", suffixes=("_a", "_b"), indicator="in_", sort=False
    )
    both["row_"] = [", ".join(filter(None, dict.fromkeys(row))) for row in both[keys].itertuples(index=False)]
    alone = both[both["in_"] != "both"]
    if len(alone):
        yield _row(name, "rows", alone["row_"].iloc[0], len(before), len(after), rows=len(alone))
    for column in sorted({*before} ^ {*after}):
        there = (column if column in frame else None for frame in (before, after))
        yield _row(name, column, "", *there)
    units = [key for key in UNIT_KEYS if key in keys]
    same = both[both["in_"] == "both"].assign(
        unit_=lambda rows: rows[units].agg(" ".join, axis=1) if units else ""
    )
    for column in [str(one) for one in before if one in after and one not in keys]:
        pairs = same[["unit_", "row_", f"{column}_a", f"{column}_b"]].set_axis(
            ["unit", "row", "a", "b"], axis=1
        )
        pairs = pairs[(pairs["a"] != pairs["b"]) & pairs[["a", "b"]].notna().any(axis=1)]
        numbers = pairs[["a", "b"]].apply(pd.to_numeric, errors="coerce").astype(float)
        pairs["change"] = (numbers["b"] - numbers["a"]).abs()
        for _, rows in pairs.groupby("unit", sort=False):
            most = rows.sort_values("change", ascending=False, kind="stable").iloc[0]
            change = None if pd.isna(most["change"]) else float(most["change"])
            yield _row(name, column, most["row"], most["a"], most["b"], rows=len(rows), change=change)


def lay_out_differences(found: pd.DataFrame) -> TableLayout:
    """Return one row per difference."""
    cells = [
        {
            **{"differs": f"{one['table']}: {one['column']}", "found_at": one["row"]},
            **{key: _format_value(one[key]) for key in ("before", "after")},
            **{"differing_rows": one["rows"], "greatest_change": _format_value(one["change"])},
        }
        for one in to_records(found)
    ]
    columns = ("differs", "differing_rows", "found_at", "before", "after", "greatest_change")
    caption = "Differences of B (second run) from A (first run): the greatest change of each column."
    return Table("differences", cells, columns, caption=caption).lay_out()


def _format_value(value: object) -> str:
    if value is None:
        return "–"
    shown = format_number(value) if isinstance(value, float) else str(value)
    return shown if len(shown) <= MAX_CELL_LETTERS else shown[: MAX_CELL_LETTERS - 1] + "…"
