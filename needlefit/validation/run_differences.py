"""Find in what two runs differ, and whether it matters.

Runs are compared by what they wrote for readers (`run.json` and CSVs), so that a run may be compared with
committed evidence too. A difference matters where it could change what is concluded: a parameter that moved
by more than `MIN_SHIFT_SD` of its standard deviation, errors on the same insertions that changed visibly and
by more than two standard errors, a verdict, what converged.
"""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from needlefit.errors import DataError
from needlefit.inference.parameters import is_logarithmic
from needlefit.project.input_files import convert_stored_errors
from needlefit.project.run_file import read_run
from needlefit.validation.csv_tables import TableSchema, read_table
from needlefit.validation.table_differences import (
    CRPS_NOISE_FRACTION,
    MIN_SHIFT_SD,
    ROUNDING_FRACTION,
    Difference,
    compare_means,
    compare_other_tables,
    compare_results,
    find_analysis_kind,
)

_ERRORS = {"ipe_mean_mm": "mean IPE", "te_mm": "mean TE"}
_PREDICTION_SCORES = {
    "tip_crps_mm": "CRPS of the tip predicted",
    "shape_crps_mm": "CRPS of the shape predicted",
}


_PARAMETERS = TableSchema(
    ("fold", "parameter"), ("status",), ("value_used", "sd"), ("determined",), ("value_used",)
)
_SCORES = TableSchema(
    ("fold", "role", "insertion", "method", "boundaries"),
    numbers=tuple(_ERRORS),
    finite=tuple(_ERRORS),
    finite_where="converged",
)
_PREDICTIVE = TableSchema(("fold", "insertion"), numbers=tuple(_PREDICTION_SCORES))
_TABLES = {"parameters": _PARAMETERS, "errors": _SCORES, "predictive": _PREDICTIVE}

_STATES = (
    "interrupted",
    "budget_limited",
    "posteriors",
    "passes",
    "not_calibrated",
    "not_converged",
    "faults",
)
_INPUTS = (
    "dataset",
    "medium",
    "recipe",
    "rules",
    "study",
    "fit",
    "folds",
    "hand_tuned",
    "versions",
    "datasets",
    "parts",
    "scene",
    "fits",
    "control",
    "sampled",
    "replicates",
)
_KIND_NAMES = {
    "errors": "a study or fit",
    "identify": "an identification",
    "forecast": "a prediction",
    "replicates": "a calibration",
    "runs": "a study of tip tracks",
    "verification": "a verification",
    "credibility": "a credibility bundle",
}
"""Kinds of runs by the table that each of them has; of a fit, which has an identification too, the first."""


def compare_runs(before: Path, after: Path) -> list[Difference]:
    """Return all differences of run folder `after` from `before`: inputs, states, parameters, errors.

    Raises
    ------
    DataError
        If a `run.json` is missing, a file is damaged, or the runs are of different kinds.
    """
    with convert_stored_errors(f"{before} or {after}"):
        return _compare_contents(before, after)


def _compare_contents(before: Path, after: Path) -> list[Difference]:
    runs = [_read_configuration(folder) for folder in (before, after)]
    _require_alike(before, after, runs)
    if find_analysis_kind(runs[0]) is not None:
        return [*_compare_inputs(*runs), *_compare_states(*runs), *compare_results(before, after)]
    parameters, errors, predictions = (
        [_read_frame(folder, one) for folder in (before, after)] for one in _TABLES
    )
    return [
        *_compare_inputs(*runs),
        *_compare_states(*runs),
        *_compare_parameters(*parameters),
        *_compare_errors(*errors),
        *_compare_predictions(*predictions),
        *compare_other_tables(before, after),
    ]


def _read_frame(folder: Path, name: str) -> pd.DataFrame:
    path = folder / f"{name}.csv"
    return read_table(path, _TABLES[name]) if path.is_file() else pd.DataFrame()


def _read_configuration(folder: Path) -> dict[str, Any]:
    """Return what a run says of itself; an identification says it of each stage, of the design at least."""
    run = read_run(folder)
    design = run.get("design")
    return design if isinstance(design, dict) else run


def _require_alike(before: Path, after: Path, runs: list[dict[str, Any]]) -> None:
    """Raise DataError where one run answers another question than the other."""
    one, two = (_describe_kind(folder, run) for folder, run in zip((before, after), runs, strict=True))
    if one != two:
        raise DataError(
            f"is {two}, and {before} is {one}: they answer different questions",
            where=str(after),
            expected=f"{one}, too",
            fix="compare runs of the same command",
        )


def _describe_kind(folder: Path, run: Mapping[str, Any]) -> str:
    """Return what a run is, in words."""
    asked = find_analysis_kind(run)
    if asked is not None:
        return f"a study of kind `{asked}`"
    found = (words for name, words in _KIND_NAMES.items() if (folder / f"{name}.csv").is_file())
    return next(found, "a run of another kind")


def _compare_inputs(before: Mapping[str, Any], after: Mapping[str, Any]) -> Iterator[Difference]:
    every = [
        dict(leaf for key in _INPUTS if key in run for leaf in iterate_leaves(run[key], key))
        for run in (before, after)
    ]
    for key in dict.fromkeys([*every[0], *every[1]]):
        one, two = every[0].get(key), every[1].get(key)
        if one != two:
            yield Difference("input", key, one, two, None, "")


def iterate_leaves(value: object, path: str = "") -> Iterator[tuple[str, object]]:
    """Yield every value of nested mappings with its path; a list is one value."""
    if isinstance(value, Mapping) and value:
        for key, inner in value.items():
            yield from iterate_leaves(inner, f"{path}.{key}" if path else str(key))
    else:
        yield path, value


def _compare_states(before: Mapping[str, Any], after: Mapping[str, Any]) -> Iterator[Difference]:
    for key in _STATES:
        one, two = before.get(key), after.get(key)
        if one != two:
            yield Difference("state", key, one, two, key != "posteriors", "")


def _compare_parameters(before: pd.DataFrame, after: pd.DataFrame) -> Iterator[Difference]:
    if before.empty or after.empty:
        return
    both = before.merge(after, on=list(_PARAMETERS.keys), how="outer", suffixes=("_a", "_b"), sort=False)
    several = before["fold"].nunique() > 1
    for _, row in both.iterrows():
        name = f"{row['parameter']} ({row['fold']})" if several else str(row["parameter"])
        one, two = _as_bool(row["determined_a"]), _as_bool(row["determined_b"])
        if one != two:
            words = {True: "determined", False: "not determined", None: "absent"}
            yield Difference("state", name, words[one], words[two], True, "the verdict changed")
        yield from _compare_parameter(name, row, bool(one) and bool(two))


def _compare_parameter(name: str, row: "pd.Series[Any]", determined: bool) -> Iterator[Difference]:
    one, two = float(row["value_used_a"]), float(row["value_used_b"])
    tied = row["status_a"] == row["status_b"] == "tied"  # moves with its source
    if one == two or tied or not (math.isfinite(one) and math.isfinite(two)):
        return
    logarithm = is_logarithmic(str(row["parameter"])) and one > 0 and two > 0
    shift = abs(math.log(two / one)) if logarithm else abs(two - one)
    sd = np.nanmax([row["sd_a"], row["sd_b"], 0.0])
    if not sd > 0:
        yield Difference("parameter", name, one, two, True, "given, not fitted")
        return
    part = shift / sd
    why = f"{part:.2g} of its standard deviation" + ("" if determined else ", not determined")
    yield Difference(
        "parameter",
        name,
        one,
        two,
        determined and part > MIN_SHIFT_SD,
        why,
        part < ROUNDING_FRACTION * MIN_SHIFT_SD,
    )


def _as_bool(value: object) -> bool | None:
    return value if isinstance(value, bool) else None


def _compare_errors(before: pd.DataFrame, after: pd.DataFrame) -> Iterator[Difference]:
    """Yield how mean errors changed on the insertions that both scored, by role and method."""
    if before.empty or after.empty:
        return
    both = before.merge(after, on=list(_SCORES.keys), suffixes=("_a", "_b"), sort=False)
    for (role, method, boundaries), rows in both.groupby(["role", "method", "boundaries"], sort=False):
        for column, words in _ERRORS.items():
            yield from compare_means(f"{words}, {method}, {role}, {boundaries} boundaries", rows, column)
    lost = len(before) + len(after) - 2 * len(both)
    if lost:
        counts = (len(before), len(after))
        yield Difference("state", "scored rows", *counts, True, f"{lost} rows are in one run only")


def _compare_predictions(before: pd.DataFrame, after: pd.DataFrame) -> Iterator[Difference]:
    if before.empty or after.empty:
        return
    both = before.merge(after, on=list(_PREDICTIVE.keys), suffixes=("_a", "_b"), sort=False)
    for column, words in _PREDICTION_SCORES.items():
        yield from compare_means(words, both, column, CRPS_NOISE_FRACTION * float(both[f"{column}_a"].mean()))
