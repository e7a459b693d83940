"""What differs in runs that are no study and no fit: of identify, predict, calibrate, and tip tracks."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path

import pandas as pd

from needlefit.validation.csv_tables import ANY, TableForm, read_table
from needlefit.validation.difference import SHIFT, SLIGHT, Difference, changed

APART = 0.1
"""Part by which a standard deviation may change and say the same."""

NORMAL_95 = 2 * 1.959963984540054
"""Width of the central 95 % of a normal distribution, in standard deviations."""


def beyond(before: Path, after: Path) -> Iterator[Difference]:
    """Yield the differences in tables that only such runs have, of those that are in both folders."""
    for name, compared in _COMPARED.items():
        files = [folder / f"{name}.csv" for folder in (before, after)]
        if all(file.is_file() for file in files):
            form, compare = compared
            one, two = (read_table(file, form) for file in files)
            yield from compare(one, two)


def _identified(before: pd.DataFrame, after: pd.DataFrame) -> Iterator[Difference]:
    """Yield changed verdicts and deviations, by stage and parameter."""
    keys = [name for name in ("stage", "fold", "parameter") if name in before and name in after]
    for _, row in before.merge(after, validate="1:1", on=keys, suffixes=("_a", "_b"), sort=False).iterrows():
        stage = f", {row['stage']}" if "stage" in keys else ""
        first, second = (_SAID[bool(row[f"determined_{run}"])] for run in "ab")
        if first != second:
            yield Difference(
                "state", f"{row['parameter']}{stage}", first, second, True, "the verdict changed"
            )
        one, two = float(row["sd_a"]), float(row["sd_b"])
        if one != two and one > 0 and two > 0:
            factor, where = abs(math.log(two / one)), f"sd of {row['parameter']}{stage}"
            why = f"{two / one:.3g} times as large"
            yield Difference("parameter", where, one, two, factor > APART, why, factor < SLIGHT * APART)


_SAID = {True: "determined", False: "not determined"}


def _forecast(before: pd.DataFrame, after: pd.DataFrame) -> Iterator[Difference]:
    """Yield how the tip foretold moved, in standard deviations of where the needle is, and its band."""
    one, two = before.iloc[-1], after.iloc[-1]
    widths = _width(one), _width(two)
    medians = float(one["needle_median_mm"]), float(two["needle_median_mm"])
    sd = max(widths) / NORMAL_95
    if medians[0] != medians[1] and sd > 0:
        part = abs(medians[1] - medians[0]) / sd
        why = f"{part:.2g} of its standard deviation"
        yield Difference("error", "tip, median (mm)", *medians, part > SHIFT, why, part < SLIGHT * SHIFT)
    if widths[0] != widths[1] and min(widths) > 0:
        factor = abs(math.log(widths[1] / widths[0]))
        why = f"{widths[1] / widths[0]:.3g} times as wide"
        yield Difference(
            "error", "tip, width of 95 % (mm)", *widths, factor > APART, why, factor < SLIGHT * APART
        )


def _width(tip: "pd.Series[float]") -> float:
    return float(tip["needle_95_high_mm"] - tip["needle_95_low_mm"])


def _covered(before: pd.DataFrame, after: pd.DataFrame) -> Iterator[Difference]:
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


def _tracks(before: pd.DataFrame, after: pd.DataFrame) -> Iterator[Difference]:
    """Yield how errors of runs foretold changed, by role and rival."""
    both = before.merge(
        after, validate="1:1", on=["fit", "role", "run", "rival"], suffixes=("_a", "_b"), sort=False
    )
    for (role, rival), rows in both.groupby(["role", "rival"], sort=False):
        for column, said in (("rms_mm", "error"), ("crps_mm", "CRPS"), ("aligned_rms_mm", "shape")):
            yield from changed(f"{said} of runs, {rival}, {role}", rows, column)


_Compare = Callable[[pd.DataFrame, pd.DataFrame], Iterator[Difference]]
_BAND = ("needle_median_mm", "needle_95_low_mm", "needle_95_high_mm")
_RUNS = TableForm(("fit", "role", "run", "rival"), numbers=("rms_mm", "crps_mm", "aligned_rms_mm"))

_COMPARED: dict[str, tuple[TableForm, _Compare]] = {
    "identify": (TableForm(texts=("parameter",), numbers=("sd",), flags=("determined",)), _identified),
    "forecast": (TableForm(numbers=_BAND), _forecast),
    "coverage": (ANY, _covered),  # that of tip tracks has other columns
    "runs": (_RUNS, _tracks),
}
"""What is read of each table, and what compares two of them."""
