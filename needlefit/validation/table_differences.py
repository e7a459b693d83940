"""Find differences between the tables of two runs, and judge them by thresholds."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from needlefit.validation.analyses.kinds import ANALYSIS_KINDS
from needlefit.validation.csv_tables import ANY_COLUMNS, TableSchema, read_table

MIN_SHIFT_SD = 0.5
"""Part of its standard deviation by which a parameter that is determined may move and stay what it was."""

VISIBLE_ERROR_MM = 0.005
"""mm: a mean error that changes by less is printed alike."""

CRPS_NOISE_FRACTION = 0.1
"""Part of a CRPS that changes with the draws it is computed from."""

ROUNDING_FRACTION = 0.02
"""Part of `MIN_SHIFT_SD` or `VISIBLE_ERROR_MM` under which a change is slight: of rounding, or of a search's
tolerance."""

SIGNIFICANT_SE = 2.0
"""Standard errors from which on a mean difference is taken for one."""


@dataclass(frozen=True)
class Difference:
    """One difference of run B from run A.

    Attributes
    ----------
    what : "input", "parameter", "error" or "state"
    where : str
        Which key, parameter or insertions.
    before, after : object
        In A and in B, as JSON knows values; None where one of them has none.
    matters : bool or None
        None for inputs: they are why results differ, and no result.
    why : str
        In words.
    slight : bool
        Whether it is of the size of rounding.
    """

    what: str
    where: str
    before: object
    after: object
    matters: bool | None
    why: str
    slight: bool = False


def compare_means(
    where: str, rows: pd.DataFrame, column: str, visible: float = VISIBLE_ERROR_MM
) -> Iterator[Difference]:
    """Yield the change of the mean of a column in mm, over the rows that both runs have.

    Where only one of them has a finite value, as of a simulation that did not converge, that is a difference.
    """
    pairs = rows[[f"{column}_a", f"{column}_b"]].to_numpy(dtype=np.float64)
    there = np.isfinite(pairs)
    if np.any(there[:, 0] != there[:, 1]):
        before, after = (int(count) for count in there.sum(axis=0))
        yield Difference("state", where, before, after, True, "values that are finite, of the same rows")
    pairs = pairs[there.all(axis=1)]
    gap = pairs[:, 1] - pairs[:, 0]
    if not np.any(gap):
        return
    mean, error = float(np.mean(gap)), math.nan
    words = f"{mean:+.4f} mm on 1 insertion"
    if gap.size > 1:
        error = float(np.std(gap, ddof=1) / math.sqrt(gap.size))
        words = f"{mean:+.4f} ± {error:.4f} mm on {gap.size} insertions"
    matters = abs(mean) > visible and not abs(mean) <= SIGNIFICANT_SE * error
    slight = float(np.max(np.abs(gap))) < ROUNDING_FRACTION * VISIBLE_ERROR_MM
    one, two = (float(value) for value in pairs.mean(axis=0))
    yield Difference("error", where, one, two, matters, words.replace("-", "−"), slight)


MIN_SD_CHANGE = 0.1
"""Part by which a standard deviation may change and say the same."""

NORMAL_95_WIDTH_SD = 2 * 1.959963984540054
"""Width of the central 95 % of a normal distribution, in standard deviations."""


def compare_other_tables(before: Path, after: Path) -> Iterator[Difference]:
    """Yield the differences in tables of single kinds of run, where both folders have them."""
    for name, compared in _COMPARISONS.items():
        files = [folder / f"{name}.csv" for folder in (before, after)]
        if all(file.is_file() for file in files):
            form, compare = compared
            one, two = (read_table(file, form) for file in files)
            yield from compare(one, two)


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


def _compare_forecasts(before: pd.DataFrame, after: pd.DataFrame) -> Iterator[Difference]:
    """Yield how the tip predicted moved, in standard deviations of where the needle is, and its band."""
    one, two = before.iloc[-1], after.iloc[-1]
    widths = _interval_width(one), _interval_width(two)
    medians = float(one["needle_median_mm"]), float(two["needle_median_mm"])
    sd = max(widths) / NORMAL_95_WIDTH_SD
    if medians[0] != medians[1] and sd > 0:
        part = abs(medians[1] - medians[0]) / sd
        why = f"{part:.2g} of its standard deviation"
        yield Difference(
            "error",
            "tip, median (mm)",
            *medians,
            part > MIN_SHIFT_SD,
            why,
            part < ROUNDING_FRACTION * MIN_SHIFT_SD,
        )
    if widths[0] != widths[1] and min(widths) > 0:
        factor = abs(math.log(widths[1] / widths[0]))
        why = f"{widths[1] / widths[0]:.3g} times as wide"
        yield Difference(
            "error",
            "tip, width of 95 % (mm)",
            *widths,
            factor > MIN_SD_CHANGE,
            why,
            factor < ROUNDING_FRACTION * MIN_SD_CHANGE,
        )


def _interval_width(tip: "pd.Series[float]") -> float:
    return float(tip["needle_95_high_mm"] - tip["needle_95_low_mm"])


def _compare_coverages(before: pd.DataFrame, after: pd.DataFrame) -> Iterator[Difference]:
    """Yield counts of a calibration that changed; it matters where one is now within chance, or out of it."""
    if "quantity" not in before or "quantity" not in after:  # of tip tracks, whose runs say it all
        return
    both = before.merge(after, validate="1:1", on=["quantity", "level"], suffixes=("_a", "_b"), sort=False)
    for _, row in both.iterrows():
        counts = int(row["covered_a"]), int(row["covered_b"])
        matters = bool(row["passes_a"]) != bool(row["passes_b"])
        if counts[0] != counts[1] or matters:
            where = f"{row['quantity']}, {100 * row['level']:.0f} % interval"
            why = "the verdict changed" if matters else "both as chance allows, or both not"
            yield Difference("state", where, *counts, matters, why)


def _compare_tracks(before: pd.DataFrame, after: pd.DataFrame) -> Iterator[Difference]:
    """Yield how errors of runs predicted changed, by role and method."""
    both = before.merge(
        after, validate="1:1", on=["fit", "role", "run", "method"], suffixes=("_a", "_b"), sort=False
    )
    for (role, method), rows in both.groupby(["role", "method"], sort=False):
        for column, words in (("rms_mm", "error"), ("crps_mm", "CRPS"), ("aligned_rms_mm", "shape")):
            yield from compare_means(f"{words} of runs, {method}, {role}", rows, column)


_Compare = Callable[[pd.DataFrame, pd.DataFrame], Iterator[Difference]]
_BAND = ("needle_median_mm", "needle_95_low_mm", "needle_95_high_mm")
_RUNS = TableSchema(("fit", "role", "run", "method"), numbers=("rms_mm", "crps_mm", "aligned_rms_mm"))

_COMPARISONS: dict[str, tuple[TableSchema, _Compare]] = {
    "identify": (
        TableSchema(texts=("parameter",), numbers=("sd",), flags=("determined",)),
        _compare_identifications,
    ),
    "forecast": (TableSchema(numbers=_BAND), _compare_forecasts),
    "coverage": (ANY_COLUMNS, _compare_coverages),  # that of tip tracks has other columns
    "runs": (_RUNS, _compare_tracks),
}
"""The columns that are read from each table, and the function that compares two of them."""


MIN_RELATIVE_CHANGE = 0.1
"""Part by which a number that is no length may change and say the same."""


def compare_results(before: Path, after: Path) -> Iterator[Difference]:
    """Yield, for every table that both folders hold, the changes of rows, lengths and other numbers.

    Rows are the same if all their words, counts and verdicts are.
    """
    for path in sorted(before.glob("*.csv")):
        if (after / path.name).is_file():
            yield from _compare_tables(path.stem, read_table(path), read_table(after / path.name))


def find_analysis_kind(run: Mapping[str, Any]) -> str | None:
    """Return the kind of analysis of a run, or None if it is not an analysis."""
    study = run.get("study")
    kind = study.get("kind") if isinstance(study, dict) else None
    return kind if isinstance(kind, str) and kind in ANALYSIS_KINDS else None


def _compare_tables(name: str, before: pd.DataFrame, after: pd.DataFrame) -> Iterator[Difference]:
    numbers = [str(one) for one in before if _is_number(before, one) and _is_number(after, one)]
    keys = [str(one) for one in before if one in after and str(one) not in numbers]
    both = _number_repeats(before, keys).merge(
        _number_repeats(after, keys),
        on=[*keys, _REPEAT],
        how="outer",
        suffixes=("_a", "_b"),
        indicator="in",
        sort=False,
    )
    alone = both[both["in"] != "both"]
    if len(alone):
        first = ", ".join(str(alone.iloc[0][key]) for key in keys)
        why = f"{len(alone)} rows are in one run only, the first of them: {first}"
        yield Difference("state", f"rows of {name}", len(before), len(after), True, why)
    same = both[both["in"] == "both"].reset_index(drop=True)
    for column in numbers:
        where = f"{name}, {column}"
        if column.endswith("_mm") and "insertion" in keys:
            yield from compare_means(where, same, column)
        else:
            yield from _find_greatest_change(where, same, column, keys)


_REPEAT = "__repeat"


def _number_repeats(frame: pd.DataFrame, keys: list[str]) -> pd.DataFrame:
    """Return a frame whose rows are told apart by their words, and by their order where these are alike."""
    words = frame.assign(**{key: frame[key].astype(str) for key in keys})
    return words.assign(
        **{_REPEAT: words.groupby(keys, sort=False).cumcount() if keys else range(len(frame))}
    )


def _is_number(frame: pd.DataFrame, column: object) -> bool:
    return column in frame and pd.api.types.is_float_dtype(frame[column])


def _find_greatest_change(
    where: str, rows: pd.DataFrame, column: str, keys: list[str]
) -> Iterator[Difference]:
    """Yield the greatest change of a number: of a length in mm, of others beside the size of their column."""
    before, after = (rows[f"{column}_{run}"].to_numpy(dtype=np.float64) for run in "ab")
    gap = np.abs(after - before)
    if not np.any(gap > 0):
        return
    row = int(np.nanargmax(gap))
    at = ", ".join(str(rows.loc[row, key]) for key in keys)
    if column.endswith("_mm"):
        part, why = float(gap[row]) / VISIBLE_ERROR_MM, f"at most {gap[row]:.3g} mm"
        matters, slight = part > 1, part < ROUNDING_FRACTION
    else:
        size = float(np.nanmax(np.abs(before)))
        part = float(gap[row]) / size if size else np.inf
        why = f"at most {part:.2g} of the largest of its column"
        matters, slight = part > MIN_RELATIVE_CHANGE, part < ROUNDING_FRACTION * MIN_RELATIVE_CHANGE
    why = f"{why}: {at}" if at else why
    yield Difference("parameter", where, float(before[row]), float(after[row]), matters, why, slight)
