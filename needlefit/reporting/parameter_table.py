"""The table of parameters: ours beside the paper's; undetermined parameters are marked."""

from collections.abc import Callable

import pandas as pd

from needlefit.reporting.comparability import compare_parameter_row
from needlefit.reporting.number_format import format_number
from needlefit.reporting.tables import Row, study_label, to_records
from needlefit.validation.results import Results

NOT_DETERMINED = "not determined"
_SEARCHED_STATUSES = ("free", "tied")
_PARAMETER_COLUMNS = (
    *("study", "medium", "fold", "parameter", "fitted", "determined", "status"),
    *("sd", "sd_of", "spread_low", "spread_high", "bound_low", "bound_high", "value_used"),
    *("fitted_metric", "fitted_metric_value_used"),
    *("hand_tuned", "hand_tuned_b", "hand_tuned_b_value_used", "note", "comparable", "origin"),
)


def tabulate_parameters(*results: Results) -> pd.DataFrame:
    """Return one row per study, fold and parameter.

    `fitted`, `fitted_metric` (the second fit, to IPE, TE, EDP), `hand_tuned` (the paper's set) and
    `hand_tuned_b` (that set with b alone re-tuned) are as printed: a parameter that the data cannot
    determine reads "not determined", in both fits alike. `value_used` is the number
    that the predictions of this run were made with; where `determined` is false it is one of many that do
    as well, and no estimate. `sd` is of ln for moduli and lengths, of the value for alpha (`sd_of`); it
    stands where errors have their noise floor, for of a parameter there is none. `comparable` says what
    makes ours and the paper's comparable or not.
    """
    return pd.DataFrame([row for one in results for row in _parameter_rows(one)], columns=_PARAMETER_COLUMNS)


def find_undetermined(results: Results) -> list[str]:
    """Return the estimated parameters that some fold could not determine, in the order of the model."""
    return _find_parameters(
        results, lambda row: row["status"] in _SEARCHED_STATUSES and not row["determined"]
    )


def find_fixed(results: Results) -> list[str]:
    """Return the parameters that were given, not estimated, in the order of the model."""
    return _find_parameters(results, lambda row: row["status"] == "fixed")


def _find_parameters(results: Results, wanted: Callable[[Row], bool]) -> list[str]:
    rows = [row for row in to_records(results.parameters) if row["method"] == "fitted" and wanted(row)]
    return list(dict.fromkeys(str(row["parameter"]) for row in rows))


def _parameter_rows(results: Results) -> list[Row]:
    cells = {(r["method"], r["fold"], r["parameter"]): r for r in to_records(results.parameters)}
    rows = []
    for (method, fold, name), ours in cells.items():
        if method != "fitted":
            continue
        retuned = cells.get(("hand_tuned_b", fold, name))
        metric = cells.get(("fitted_metric", fold, name))
        rows.append(
            {"study": study_label(results), "medium": results.record.medium, "fold": fold}
            | {"parameter": name, "fitted": _format_published(ours), "determined": bool(ours["determined"])}
            | {key: ours[key] for key in ("status", "sd", "spread_low", "spread_high")}
            | {"sd_of": "" if ours["sd"] is None else "value" if name.startswith("alpha") else "ln"}
            | {key: ours[key] for key in ("bound_low", "bound_high", "note")}
            | {"fitted_metric": _format_published(metric and {**metric, "determined": ours["determined"]})}
            | {"fitted_metric_value_used": None if metric is None else metric["value"]}
            | {
                "value_used": ours["value"],
                "hand_tuned": _format_published(cells.get(("hand_tuned", fold, name))),
            }
            | {"hand_tuned_b": _format_published(retuned)}
            | {"hand_tuned_b_value_used": None if retuned is None else retuned["value"]}
            | {"comparable": compare_parameter_row(results, ("hand_tuned", fold, name) in cells)}
            | {"origin": results.origin}
        )
    return rows


def _format_published(row: Row | None) -> str:
    """Return the cell of one parameter; the status decides whether it could have been determined at all."""
    if row is None:
        return ""
    if row["status"] in _SEARCHED_STATUSES and not row["determined"]:
        return NOT_DETERMINED
    return format_number(row["value"])
