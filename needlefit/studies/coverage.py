"""How well predictive intervals cover insertions."""

from collections.abc import Iterator

import pandas as pd

from needlefit.datasets.select import group_independent
from needlefit.inference.proportions import Proportion, estimate_proportion
from needlefit.reporting.table_files import Row


def count_covered(predictive: pd.DataFrame, column: str) -> Proportion:
    """Return how many insertions lie in their predicted interval; `column` is such as "tip_in_95"."""
    independent = group_independent(list(predictive["insertion"]), list(predictive["specimen"]))
    return estimate_proportion(list(predictive[column]), independent)


def list_coverages(predictive: pd.DataFrame) -> Iterator[tuple[str, int, Proportion]]:
    """Yield "tip" or "shape", level (%) and share of insertions that the interval covers."""
    if not predictive.empty:
        for level in (95, 50):
            for what in ("tip", "shape"):
                yield what, level, count_covered(predictive, f"{what}_in_{level}")


def list_missed_levels(predictive: pd.DataFrame) -> list[tuple[str, int, Proportion]]:
    """Return the intervals that cover too few insertions, as `list_coverages`.

    That is where the 95 % confidence interval of the share lies below the level.
    """
    return [one for one in list_coverages(predictive) if one[2].high < one[1] / 100]


def median_width(predictive: pd.DataFrame) -> float:
    """Return the median width of the 95 % intervals of tips, mm."""
    return float((predictive["tip_95_high_mm"] - predictive["tip_95_low_mm"]).median())


def median_error(predictive: pd.DataFrame) -> float:
    """Return the mean distance of the medians of predicted tips from the measured ones, mm.

    That is the tip error of the predictions; `te_mm` is of the posterior mode.
    """
    return float((predictive["tip_median_mm"] - predictive["tip_measured_mm"]).abs().mean())


COVERAGE_COLUMNS = (
    *("insertions", "tip_in_50", "tip_in_95", "tip_95_width_mm", "tip_median_error_mm"),
    *("shape_in_50", "shape_in_95", "tip_crps_mm"),
)
"""Columns of how well needles were predicted."""


def tabulate_coverage(predictions: pd.DataFrame) -> Row:
    """Return the cells of `COVERAGE_COLUMNS` for some needles: shares within intervals, width, mean score."""
    shares = (name for name in COVERAGE_COLUMNS if "_in_" in name)
    return {
        **{name: format_share(count_covered(predictions, name)) for name in shares},
        "insertions": len(predictions),
        "tip_95_width_mm": median_width(predictions),
        "tip_median_error_mm": median_error(predictions),
        "tip_crps_mm": predictions["tip_crps_mm"].mean(),
    }


def format_share(found: Proportion) -> str:
    """Return how many of a number in the same row, with the interval of the share: "9 (60–98 %)"."""
    return f"{found.hits} ({100 * found.low:.0f}–{100 * found.high:.0f} %)"


def format_proportion(found: Proportion) -> str:
    """Return a proportion with its interval as text: "9 of 10 (60–98 %)"."""
    return f"{found.hits} of {found.trials} ({100 * found.low:.0f}–{100 * found.high:.0f} %)"
