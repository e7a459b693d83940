"""How well predictive intervals cover insertions, and how wide they are: also after one more insertion."""

from collections.abc import Iterator

import numpy as np
import pandas as pd

from needlefit.arrays import Floats
from needlefit.datasets.select import group_rows
from needlefit.inference.predict import Proportion, estimate_proportion
from needlefit.project.input_files import read_toml
from needlefit.project.locate import find_file, list_names
from needlefit.project.result_warnings import ResultWarning
from needlefit.reporting.table_files import Row
from needlefit.reporting.text import KindText


def count_covered(predictive: pd.DataFrame, column: str) -> Proportion:
    """Return how many insertions lie in their predicted interval; `column` is such as "tip_in_95"."""
    return estimate_proportion(list(predictive[column]), group_rows(predictive))


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


def tip_error_of_medians(predictive: pd.DataFrame) -> float:
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
    found = {name: count_covered(predictions, name) for name in COVERAGE_COLUMNS if "_in_" in name}
    shares = {name: f"{one.hits} ({100 * one.low:.0f}–{100 * one.high:.0f} %)" for name, one in found.items()}
    return {
        **shares,
        "insertions": len(predictions),
        "tip_95_width_mm": median_width(predictions),
        "tip_median_error_mm": tip_error_of_medians(predictions),
        "tip_crps_mm": predictions["tip_crps_mm"].mean(),
    }


def format_proportion(found: Proportion) -> str:
    """Return a proportion with its interval as text: "9 of 10 (60–98 %)"."""
    return f"{found.hits} of {found.trials} ({100 * found.low:.0f}–{100 * found.high:.0f} %)"


#: width of the 95 % interval of a tip up to which it serves for aiming, whatever the deflection
MAX_AIMING_WIDTH_MM = 2.0


def measure_width(tips: Floats) -> float:
    """Return how wide the central 95 % of tips (B,) are, mm; NaN are left out."""
    low, high = np.nanquantile(tips, [0.025, 0.975])
    return float(high - low)


def estimate_width_after_one(tips: Floats, known: Floats) -> float:
    """Return how wide the central 95 % of tips are once the tip of another insertion is measured, mm.

    `tips` (B,) are those of an insertion, one for each draw of the parameters, mm; NaN where there is none.
    `known` (B,) are measured tips of another insertion into the same specimen with the same parameters, mm:
    what tips share with them is subtracted, linear in them.
    """
    solved = np.isfinite(tips) & np.isfinite(known)
    (variance, shared), _ = np.cov(known[solved], tips[solved])
    return measure_width(tips - shared / variance * known)


def warn_if_too_wide(
    width_mm: float, deflection_mm: float, where: str = "", fix: str = ""
) -> Iterator[ResultWarning]:
    """Yield a warning if an interval is wider than the tip is deflected, and than `MAX_AIMING_WIDTH_MM`.

    `where` is the medium of the tips whose median width and deflection are given; empty: of a single tip.
    `fix` is what narrows the interval; by default more data.
    """
    if is_too_wide(width_mm, deflection_mm):
        values = {"group": where, "width_mm": width_mm, "deflection_mm": deflection_mm, "gain": fix}
        text = KindText("warnings")
        what, remedy = (text.sentence(block, values) for block in ("wide_intervals", "wide_intervals_fix"))
        yield ResultWarning("wide_intervals", what, fix=remedy)


def is_too_wide(width_mm: float, deflection_mm: float) -> bool:
    """Return whether an interval is wider than the tip is deflected, and than `MAX_AIMING_WIDTH_MM`."""
    return width_mm > max(MAX_AIMING_WIDTH_MM, deflection_mm)


def find_adaptation(dataset: str, fitted: str, new: str | None = None) -> str:
    """Return the name of a study that adds insertions of another medium to a fit on a dataset; "" if none.

    `fitted` and `new` are the media; without `new` any will do.
    """
    for name in list_names("study"):
        found = read_toml(find_file("study", name))
        if found.get("kind") == "adaptation" and found.get("dataset") == dataset:
            media = found.get("old", {}).get("medium"), found.get("new", {}).get("medium")
            if media[0] == fitted and new in (None, media[1]):
                return name
    return ""
