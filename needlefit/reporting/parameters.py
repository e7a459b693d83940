"""The parameter table: ours beside the paper's, and what cannot be determined said instead of printed."""

from collections.abc import Callable

import pandas as pd

from needlefit.reporting.comparability import comparable_parameters
from needlefit.reporting.numbers import number
from needlefit.reporting.tables import Row, records, study_label
from needlefit.validation.results import Results

NOT_DETERMINED = "not determined"
_SEARCHED = ("free", "tied")
_COLUMNS = (
    *("study", "medium", "fold", "parameter", "fitted", "determined", "status"),
    *("sd", "sd_of", "spread_low", "spread_high", "bound_low", "bound_high", "value_used"),
    *("fitted_metric", "fitted_metric_value_used"),
    *("hand_tuned", "hand_tuned_b", "hand_tuned_b_value_used", "note", "comparable", "origin"),
)


def parameters_table(*results: Results) -> pd.DataFrame:
    """Return one row per study, fold and parameter.

    `fitted`, `fitted_metric` (the second fit, to IPE, TE, EDP), `hand_tuned` (the paper's set) and
    `hand_tuned_b` (that set with b alone re-tuned) are as printed: a parameter that the data cannot
    determine reads "not determined", in both fits alike. `value_used` is the number
    that the predictions of this run were made with; where `determined` is false it is one of many that do
    as well, and no estimate. `sd` is of ln for moduli and lengths, of the value for alpha (`sd_of`); it
    stands where errors have their noise floor, for of a parameter there is none. `comparable` says what
    makes ours and the paper's comparable or not.
    """
    return pd.DataFrame([row for one in results for row in _rows(one)], columns=_COLUMNS)


def undetermined(results: Results) -> list[str]:
    """Return the searched parameters that some fold could not determine, in the order of the model."""
    return _named(results, lambda row: row["status"] in _SEARCHED and not row["determined"])


def held_fixed(results: Results) -> list[str]:
    """Return the parameters that were given, not searched, in the order of the model."""
    return _named(results, lambda row: row["status"] == "fixed")


def _named(results: Results, wanted: Callable[[Row], bool]) -> list[str]:
    rows = [row for row in records(results.parameters) if row["method"] == "fitted" and wanted(row)]
    return list(dict.fromkeys(str(row["parameter"]) for row in rows))


def _rows(results: Results) -> list[Row]:
    cells = {(r["method"], r["fold"], r["parameter"]): r for r in records(results.parameters)}
    rows = []
    for (method, fold, name), ours in cells.items():
        if method != "fitted":
            continue
        retuned = cells.get(("hand_tuned_b", fold, name))
        metric = cells.get(("fitted_metric", fold, name))
        rows.append(
            {"study": study_label(results), "medium": results.record.medium, "fold": fold}
            | {"parameter": name, "fitted": _printed(ours), "determined": bool(ours["determined"])}
            | {key: ours[key] for key in ("status", "sd", "spread_low", "spread_high")}
            | {"sd_of": "" if ours["sd"] is None else "value" if name.startswith("alpha") else "ln"}
            | {key: ours[key] for key in ("bound_low", "bound_high", "note")}
            | {"fitted_metric": _printed(metric and {**metric, "determined": ours["determined"]})}
            | {"fitted_metric_value_used": None if metric is None else metric["value"]}
            | {"value_used": ours["value"], "hand_tuned": _printed(cells.get(("hand_tuned", fold, name)))}
            | {"hand_tuned_b": _printed(retuned)}
            | {"hand_tuned_b_value_used": None if retuned is None else retuned["value"]}
            | {"comparable": comparable_parameters(results, ("hand_tuned", fold, name) in cells)}
            | {"origin": results.origin}
        )
    return rows


def _printed(row: Row | None) -> str:
    """Return the cell of one parameter; the status decides whether it could have been determined at all."""
    if row is None:
        return ""
    if row["status"] in _SEARCHED and not row["determined"]:
        return NOT_DETERMINED
    return number(row["value"])
