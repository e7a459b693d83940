"""How well predictive intervals cover insertions, and how wide they are: also after one more insertion."""

import math
from typing import Any

import numpy as np
import pandas as pd

from needlefit.arrays import Floats
from needlefit.inference.predict import Proportion, estimate_proportion
from needlefit.reporting.table_files import Row

#: Monte Carlo standard error of the width of the 95 % interval of a tip
WIDTH_ERROR_COLUMN = "tip_95_width_error_mm"
#: expected width of the 95 % interval of the tip after one measured insertion into the new specimen
AFTER_ONE_COLUMN = "tip_95_width_after_one_mm"


def join_trials(rows: pd.DataFrame) -> list[int]:
    """Return the trial of each row: rows of the same fold, specimen or hole are of one trial."""
    trial = list(range(len(rows)))
    for key in (rows["fold"], rows["specimen"], rows["specimen"] + "/" + rows["hole"]):
        first: dict[Any, int] = {}
        for number, name in enumerate(key):
            old, new = trial[number], trial[first.setdefault(name, number)]
            trial = [new if number == old else number for number in trial]
    return trial


def count_covered(predictive: pd.DataFrame, column: str) -> Proportion:
    """Return how many insertions lie in their predicted interval; `column` is such as "tip_in_95".

    Its interval counts trials (`join_trials`); of one trial it says nothing.
    """
    return estimate_proportion(list(predictive[column]), [str(trial) for trial in join_trials(predictive)])


def measure_tips(predictive: pd.DataFrame, which: str) -> "pd.Series[float]":
    """Return how far tips deflect, mm: "measured", or the "median" predicted."""
    y, z = f"tip_{which}_mm", f"tip_z_{which}_mm"
    across = predictive[y].abs()
    return across.combine(predictive[z], math.hypot) if z in predictive else across


def median_width(predictive: pd.DataFrame) -> float:
    """Return the median width of the 95 % intervals of tips, mm; in space of the wider one of y and z."""
    width = predictive["tip_95_high_mm"] - predictive["tip_95_low_mm"]
    if "tip_z_95_high_mm" in predictive:
        width = width.combine(predictive["tip_z_95_high_mm"] - predictive["tip_z_95_low_mm"], max)
    return float(width.median())


def tip_error_of_medians(predictive: pd.DataFrame) -> float:
    """Return the mean distance of the medians of predicted tips from the measured ones, mm."""
    off = (predictive["tip_median_mm"] - predictive["tip_measured_mm"]).abs()
    if "tip_z_median_mm" in predictive:
        out = predictive["tip_z_median_mm"] - predictive["tip_z_measured_mm"]
        off = off.combine(out, math.hypot)
    return float(off.mean())


COVERAGE_COLUMNS = (
    *("insertions", "tip_in_50", "tip_in_95", "tip_95_width_mm", "tip_median_error_mm"),
    *("shape_in_50", "shape_in_95", "tip_crps_mm", "tip_interval_score_mm"),
)
"""Columns of how well needles were predicted."""


def tabulate_coverage(predictions: pd.DataFrame) -> Row:
    """Return the cells of `COVERAGE_COLUMNS` for some needles: shares within intervals, width, mean score."""
    proportions = {name: count_covered(predictions, name) for name in COVERAGE_COLUMNS if "_in_" in name}
    shares = {
        name: f"{proportion.hits} ({100 * proportion.low:.0f}–{100 * proportion.high:.0f} %)"
        if proportion.groups > 1
        else str(proportion.hits)
        for name, proportion in proportions.items()
    }
    return {
        **shares,
        "insertions": len(predictions),
        "tip_95_width_mm": median_width(predictions),
        "tip_median_error_mm": tip_error_of_medians(predictions),
        **{name: predictions[name].mean() for name in ("tip_crps_mm", "tip_interval_score_mm")},
    }


#: width of the 95 % interval of a tip up to which it serves for aiming, unless a recipe states another
MAX_AIMING_WIDTH_MM = 2.0


def estimate_width_after_one(tips: Floats, known_tips: Floats) -> float:
    """Return how wide the central 95 % of tips are once the tip of another insertion is measured, mm.

    `tips` (B,) are those of an insertion, one for each draw of the parameters, mm; NaN where there is none.
    `known` (B,) are measured tips of another insertion into the same specimen with the same parameters, mm:
    what tips share with them is subtracted, linear in them.
    """
    solved = np.isfinite(tips) & np.isfinite(known_tips)
    (variance, shared), _ = np.cov(known_tips[solved], tips[solved])
    low, high = np.nanquantile(tips - shared / variance * known_tips, [0.025, 0.975])
    return float(high - low)
