"""Compare two fits or cross-validations: parameters, errors and predictions."""

import math
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd

from needlefit.datasets.select import group_independent
from needlefit.inference.parameters import is_logarithmic
from needlefit.inference.proportions import Proportion, estimate_proportion
from needlefit.metrics import list_metrics
from needlefit.reporting.labels import group_name
from needlefit.studies.csv_tables import TableSchema
from needlefit.studies.identification_tables import IDENTIFICATION_COMPARISON
from needlefit.studies.kinds.cross_validation.tables import CONDITIONAL, NOT_DETERMINED
from needlefit.studies.run_differences import (
    CRPS_NOISE_FRACTION,
    MIN_SD_CHANGE,
    MIN_SHIFT_SD,
    ROUNDING_FRACTION,
    Difference,
    TableComparison,
    compare_means,
    is_number,
)

_PREDICTED_QUANTITIES = {"tip": "CRPS of the tip predicted", "shape": "CRPS of the shape predicted"}
_BESIDE = "training only"


_PARAMETERS = TableSchema(
    ("fold", "method", "parameter"),
    ("status", "value"),
    ("value_used", "sd"),
    ("determined",),
    ("value_used",),
)
_SCORES = TableSchema(
    ("fold", "role", "insertion", "method", "boundaries"),
    numbers=("ipe_mean_mm", "te_mm"),
    finite=("ipe_mean_mm", "te_mm"),
    finite_where="converged",
)
_PREDICTIVE = TableSchema(
    ("fold", "insertion", "specimen_treatment", "quantity", "level"),
    ("specimen", "medium", "layers"),
    ("crps_mm", "low_mm", "high_mm", "covered"),
)


def _compare_parameters(before: pd.DataFrame, after: pd.DataFrame) -> Iterator[Difference]:
    if before.empty or after.empty:
        return
    fits = [frame[frame["method"] == "fitted"] for frame in (before, after)]
    both = fits[0].merge(fits[1], on=["fold", "parameter"], how="outer", suffixes=("_a", "_b"), sort=False)
    several = before["fold"].nunique() > 1
    for _, row in both.iterrows():
        name = f"{row['parameter']} ({row['fold']})" if several else str(row["parameter"])
        one, two = (_name_verdict(row[f"determined_{end}"], row[f"value_{end}"]) for end in "ab")
        if one != two:
            yield Difference("state", name, one, two, True, "the verdict changed")
        yield from _compare_parameter(name, row, one == two == "determined")


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


def _name_verdict(determined: object, printed: object) -> str:
    """Return what the data say of a parameter; "absent" where a run lacks it."""
    if not isinstance(determined, bool):
        return "absent"
    return CONDITIONAL if printed == CONDITIONAL else "determined" if determined else NOT_DETERMINED


def _compare_errors(before: pd.DataFrame, after: pd.DataFrame) -> Iterator[Difference]:
    """Yield how mean errors changed on the insertions that both scored, by role and method."""
    if before.empty or after.empty:
        return
    both = before.merge(after, on=list(_SCORES.keys), suffixes=("_a", "_b"), sort=False)
    for (role, method, boundaries), rows in both.groupby(["role", "method", "boundaries"], sort=False):
        for metric in list_metrics():
            if is_number(before, metric.name) and is_number(after, metric.name):
                where = f"mean {metric.label}, {method}, {role}, {boundaries} boundaries"
                yield from compare_means(where, rows, metric.name, unit=metric.unit)
    lost = len(before) + len(after) - 2 * len(both)
    if lost:
        counts = (len(before), len(after))
        yield Difference("state", "scored rows", *counts, True, f"{lost} rows are in one run only")


def _compare_predictions(before: pd.DataFrame, after: pd.DataFrame) -> Iterator[Difference]:
    """Yield how predictions changed: those that the run makes by default, and those beside them."""
    if before.empty or after.empty:
        return
    keys = ["fold", "insertion", "beside", "quantity", "level"]
    one, two = map(_mark_predictions_beside, (before, after))
    both = one.merge(two, on=keys, suffixes=("_a", "_b"), sort=False)
    yield from _compare_scores(both[~both["beside"]], "")
    yield from _compare_scores(both[both["beside"]], f", {_BESIDE}")
    default = both[~both["beside"]]
    several = len(default[["medium_a", "layers_a"]].drop_duplicates()) > 1
    for (medium, layers), rows in default.groupby(["medium_a", "layers_a"], sort=False):
        where = f", {group_name(str(medium), int(str(layers)))}" if several else ""
        yield from _compare_coverage(rows, where)
        tips = rows[(rows["quantity"] == "tip") & (rows["level"] == "0.95")]
        yield from _compare_width(tips, where)


def _mark_predictions_beside(predicted: pd.DataFrame) -> pd.DataFrame:
    """Mark the rows "training only" of insertions that the run predicts with the spread of specimens too.

    By default a run predicts the others: those rows alone stand for what it concludes.
    """
    spread = predicted["specimen_treatment"] != _BESIDE
    insertions = [predicted["fold"], predicted["insertion"]]
    return predicted.assign(beside=~spread & spread.groupby(insertions).transform("any"))


def _compare_scores(both: pd.DataFrame, which: str) -> Iterator[Difference]:
    for quantity, words in _PREDICTED_QUANTITIES.items():
        rows = both[both["quantity"] == quantity].drop_duplicates(["fold", "insertion"])
        yield from compare_means(
            words + which, rows, "crps_mm", CRPS_NOISE_FRACTION * float(rows["crps_mm_a"].mean())
        )


def _compare_coverage(rows: pd.DataFrame, where: str) -> Iterator[Difference]:
    """Yield which intervals cover another number of insertions; it matters where the verdict changes."""
    for (quantity, level), some in rows.groupby(["quantity", "level"], sort=False):
        known = some.dropna(subset=["covered_a", "covered_b"])
        if quantity not in _PREDICTED_QUANTITIES or (known["covered_a"] == known["covered_b"]).all():
            continue
        groups = group_independent(list(known["insertion"]), list(known["specimen_a"]))
        before, after = (estimate_proportion(list(known[f"covered_{run}"]), groups) for run in "ab")
        nominal = float(str(level))
        one, two = (_judge_coverage(share, nominal) for share in (before, after))
        verdict = f"{two} in both runs" if one == two else f"{two}, before {one}"
        yield Difference(
            "error",
            f"{quantity}s in their {100 * nominal:.0f} % interval{where}",
            before.hits,
            after.hits,
            one != two,
            f"of {len(known)} insertions; {verdict}",
        )


def _judge_coverage(share: Proportion, level: float) -> str:
    return "too few" if share.high < level else "too many" if share.low > level else "as expected"


def _compare_width(tips: pd.DataFrame, where: str) -> Iterator[Difference]:
    one, two = (float((tips[f"high_mm_{run}"] - tips[f"low_mm_{run}"]).median()) for run in "ab")
    if one == two or not (one > 0 and two > 0):
        return
    change = abs(math.log(two / one))
    yield Difference(
        "error",
        f"tip, median width of 95 % (mm){where}",
        one,
        two,
        change > MIN_SD_CHANGE,
        f"{two / one:.3g} times as wide",
        change < ROUNDING_FRACTION * MIN_SD_CHANGE,
    )


COMPARISONS: Mapping[str, TableComparison] = MappingProxyType(
    {
        "parameters": TableComparison(_PARAMETERS, _compare_parameters),
        "errors": TableComparison(_SCORES, _compare_errors),
        "predictive": TableComparison(_PREDICTIVE, _compare_predictions),
        "identify": IDENTIFICATION_COMPARISON,
    }
)
