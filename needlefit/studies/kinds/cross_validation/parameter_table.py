"""The table of parameters: ours beside the paper's; undetermined parameters are marked."""

from collections.abc import Callable

import pandas as pd

from needlefit.inference.parameters import HYPERPARAMETERS
from needlefit.reporting.number_format import format_number
from needlefit.reporting.table_files import Row, to_records
from needlefit.studies.run import Run
from needlefit.studies.scored_groups import compare_parameter_row, study_label

NOT_DETERMINED, CONDITIONAL = "not determined", "conditional"
"""Printed in place of a value: the data do not determine it, or only under an assumption."""

_SEARCHED_STATUSES = ("free", "tied")
_PARAMETER_COLUMNS = (
    *("study", "medium", "fold", "parameter", "method", "value", "value_used"),
    *("determined", "condition", "status"),
    *("sd", "interval_low", "interval_high", "draw_source"),
    *("low", "high", "bound_low", "bound_high", "note", "comparable", "origin"),
)
METHODS = ("fitted", "fitted_metric", "hand_tuned", "hand_tuned_b")
"""The fit, the second fit to IPE, TE and EDP, the paper's set, and that set with b alone re-tuned."""


def tabulate_parameters(*results: Run) -> pd.DataFrame:
    """Return one row per study, fold, parameter and method.

    `value` is as printed: a parameter that the data cannot determine reads "not determined", one that they
    determine only under an assumption "conditional", in both fits alike. `value_used` is the number that the
    predictions were made with; where `determined` is false it is one of many that do as well, and no
    estimate. `sd` is of ln for moduli and lengths, of the value for alpha; it stands where errors have their
    noise floor, for of a parameter there is none. `comparable` says what makes ours and the paper's
    comparable or not.
    """
    rows = [row for one in results for row in _parameter_rows(one)]
    return pd.DataFrame(rows, columns=list(_PARAMETER_COLUMNS))


def arrange_parameters(table: pd.DataFrame) -> list[Row]:
    """Return one row per study, fold and parameter: the fit's, with the printed value of each method."""
    rows: dict[tuple[object, ...], Row] = {}
    for row in to_records(table):
        key = (row["study"], row["fold"], row["parameter"])
        if row["method"] == "fitted":
            rows[key] = {**row, **dict.fromkeys(METHODS, "")}
        if key in rows:
            rows[key][row["method"]] = row["value"]
    return list(rows.values())


def find_undetermined(results: Run) -> list[str]:
    """Return the estimated parameters that some fold could not determine, in the order of the model."""
    return _find_parameters(
        results, lambda row: row["status"] in _SEARCHED_STATUSES and not row["determined"]
    )


def find_conditional(results: Run) -> list[str]:
    """Return those of `find_undetermined` that are determined under an assumption, in every fold."""
    loose = _find_parameters(results, lambda row: not row["determined"] and not is_conditional(row))
    return [name for name in find_undetermined(results) if name not in loose]


def is_conditional(row: Row) -> bool:
    """Return whether a parameter is determined only under an assumption."""
    return bool(row["condition"])


def find_fixed(results: Run) -> list[str]:
    """Return the parameters that were given, not estimated, in the order of the model."""
    return _find_parameters(results, lambda row: row["status"] == "fixed")


def _find_parameters(results: Run, wanted: Callable[[Row], bool]) -> list[str]:
    rows = [
        row for row in to_records(results.frames["parameters"]) if row["method"] == "fitted" and wanted(row)
    ]
    return list(dict.fromkeys(str(row["parameter"]) for row in rows))


def _parameter_rows(results: Run) -> list[Row]:
    rows = to_records(results.frames["parameters"])
    fitted = {(row["fold"], row["parameter"]): row for row in rows if row["method"] == "fitted"}
    published = {(r["fold"], r["parameter"]) for r in rows if r["method"] == "hand_tuned"}
    about = {"study": study_label(results), "medium": results.record.medium, "origin": results.origin}
    found = []
    for row in rows:
        key = (row["fold"], row["parameter"])
        if row["method"] == "fitted_metric" and row["parameter"] in HYPERPARAMETERS:
            continue  # of the likelihood: errors do not depend on them
        of_fit = row["method"] in ("fitted", "fitted_metric")
        judge = fitted[key] if of_fit else row
        words = compare_parameter_row(results, key in published)
        judged = {**row, "determined": bool(judge["determined"]), "condition": judge["condition"]}
        printed = {"value": _format_published(judged), "value_used": row["value"]}
        found.append({**about, **judged, **printed, "comparable": words})
    return found


def _format_published(row: Row) -> str:
    """Return the cell of one parameter: its value if the data determine it or it was given."""
    if row["status"] in _SEARCHED_STATUSES and not row["determined"]:
        return CONDITIONAL if is_conditional(row) else NOT_DETERMINED
    return format_number(row["value"])
