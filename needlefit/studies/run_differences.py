"""Differences of two runs: their tables are joined on the columns that name a row, `run.json` on its keys."""

from pathlib import Path

import pandas as pd

from needlefit.errors import DataError
from needlefit.studies.identity import PART_DIGITS, describe_change
from needlefit.studies.report import list_run_files
from needlefit.studies.run import Run, restore_run

#: columns that name a row, in any table
KEYS = {
    *("dataset", "study", "fold", "fit", "role", "run", "insertion", "hole", "specimen", "medium"),
    *("method", "boundaries", "comparison", "grouping", "layers", "layer", "specimen_treatment"),
    *("parameter", "metric", "quantity", "level", "seed"),
    *("start", "curve", "draw", "scan", "marker", "name", "mark"),
}
RUN_JSON, IDENTITY = "run.json", "identity"


def compare_runs(before: Path, after: Path) -> pd.DataFrame:
    """Return how run `after` differs from `before`: a row for each column of a table, or key of `run.json`.

    Where they are of different fits, the row of the column "identity" states in `row` what changed.
    `row`, `before`, `after` and `change` are those of the greatest change, for each unit in a column; `rows`
    is how many rows differ. What one run alone has is missing (None) in the other.

    DataError as of `restore_run`, or if the runs are of different kinds.
    """
    runs = [restore_run(folder) for folder in (before, after)]
    if runs[0].kind != runs[1].kind:
        problem, expected = f"is of kind {runs[1].kind}, and {before} of kind {runs[0].kind}", "one kind"
        raise DataError(problem, where=after, expected=expected, fix="compare runs of the same command")
    first, second = (
        {f"{name}.csv": run_file for name, run_file in list_run_files(run).items()} for run in runs
    )
    changed = describe_change(runs[0].metadata.identity, runs[1].metadata.identity)
    first[RUN_JSON], second[RUN_JSON] = (_tabulate_keys(run) for run in runs)
    joined = []
    for table, frame in first.items():
        other = second.get(table)
        if isinstance(frame, pd.DataFrame) and isinstance(other, pd.DataFrame):
            keys = [key for key in frame if key in KEYS and key in other] if table != RUN_JSON else []
            a, b = _melt(frame, keys, "before"), _melt(other, keys, "after")
            joined.append(a.merge(b, how="outer", sort=False).assign(table=table))
    both = pd.concat(joined, ignore_index=True)
    both = both[(both["before"] != both["after"]) & both[["before", "after"]].notna().any(axis=1)]
    numbers = both[["before", "after"]].apply(pd.to_numeric, errors="coerce").astype(float)
    both = both.assign(change=(numbers["after"] - numbers["before"]).abs())
    both["rows"] = both.groupby(["table", "column", "unit"])["row"].transform("size")
    most = both.sort_values("change", ascending=False, kind="stable")
    most = most.drop_duplicates(["table", "column", "unit"]).sort_index()
    most.loc[most["column"] == IDENTITY, "row"] = changed
    columns = most[["table", "column", "row", "before", "after", "rows", "change"]].astype(object)
    return columns.where(columns.notna(), None)


def _tabulate_keys(run: Run) -> pd.DataFrame:
    """Return `run.json` as a row, with the digest of the identity alone."""
    stated = run.metadata.identity
    return pd.json_normalize(run.run_json | {IDENTITY: stated and stated.sha256[:PART_DIGITS]})


def _melt(frame: pd.DataFrame, keys: list[str], value: str) -> pd.DataFrame:
    """Return a row for each cell of the columns that are no keys; `repeat` numbers rows of equal keys."""
    words = frame[keys].astype(object).fillna("").astype(str)
    rows = pd.Series([", ".join(filter(None, row)) for row in words.itertuples(index=False)], frame.index)
    units = words[[key for key in keys if key in ("parameter", "metric", "quantity")]].agg(" ".join, axis=1)
    names = pd.DataFrame({"row": rows, "unit": units, "repeat": rows.groupby(rows).cumcount()})
    named = pd.concat([frame.drop(columns=keys).astype(object), names], axis=1)
    return named.melt(["row", "unit", "repeat"], var_name="column", value_name=value)
