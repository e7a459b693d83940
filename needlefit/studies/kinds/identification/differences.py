"""Compare two identifications: verdicts and standard deviations."""

import math
from collections.abc import Iterator

import pandas as pd

from needlefit.studies.csv_tables import TableSchema
from needlefit.studies.run_differences import (
    MIN_SD_CHANGE,
    ROUNDING_FRACTION,
    Difference,
    TableComparison,
)


def _compare_identifications(before: pd.DataFrame, after: pd.DataFrame) -> Iterator[Difference]:
    """Yield changed verdicts and deviations, by stage and parameter."""
    keys = [name for name in ("stage", "fold", "parameter") if name in before and name in after]
    for _, row in before.merge(after, validate="1:1", on=keys, suffixes=("_a", "_b"), sort=False).iterrows():
        stage = f", {row['stage']}" if "stage" in keys else ""
        first, second = (_VERDICT_NAMES[bool(row[f"determined_{run}"])] for run in "ab")
        if first != second:
            yield Difference(
                "state", f"{row['parameter']}{stage}", first, second, True, "the verdict changed"
            )
        one, two = float(row["sd_a"]), float(row["sd_b"])
        if one != two and one > 0 and two > 0:
            factor, where = abs(math.log(two / one)), f"sd of {row['parameter']}{stage}"
            why = f"{two / one:.3g} times as large"
            yield Difference(
                "parameter",
                where,
                one,
                two,
                factor > MIN_SD_CHANGE,
                why,
                factor < ROUNDING_FRACTION * MIN_SD_CHANGE,
            )


_VERDICT_NAMES = {True: "determined", False: "not determined"}

IDENTIFICATION_COMPARISON = TableComparison(
    TableSchema(texts=("parameter",), numbers=("sd",), flags=("determined",)), _compare_identifications
)
