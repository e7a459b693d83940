"""How well predictive intervals cover insertions, and how wide they are: also after one more insertion."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import pandas as pd

from needlefit.arrays import Floats
from needlefit.datasets.select import group_rows
from needlefit.inference.predict import Proportion, estimate_proportion
from needlefit.project.result_warnings import ResultWarning
from needlefit.reporting.table_files import Row
from needlefit.reporting.text import KindText
from needlefit.studies.run import BestBaseline, Verdict, qualify


def count_covered(predictive: pd.DataFrame, column: str) -> Proportion:
    """Return how many insertions lie in their predicted interval; `column` is such as "tip_in_95"."""
    return estimate_proportion(list(predictive[column]), group_rows(predictive))


def list_coverages(predictive: pd.DataFrame) -> Iterator[tuple[str, int, Proportion]]:
    """Yield "tip" or "shape", level (%) and share of insertions that the interval covers."""
    if not predictive.empty:
        for level in (95, 50):
            for what in ("tip", "shape"):
                yield what, level, count_covered(predictive, f"{what}_in_{level}")


FindingKey = Literal["coverage", "wide_coverage", "wide_intervals", "off_centre"]


@dataclass(frozen=True)
class Finding:
    """What is wrong with the predictions of some needles; `key` names its text."""

    key: FindingKey
    what: str = "tip"  #: or "shape"
    level: int = 95  #: of the interval, %
    found: Proportion | None = None  #: share that the interval covers, or that lies on one side of medians
    side: str = ""  #: "more" or "less": how far most tips deflect, beside their medians
    width_mm: float = math.nan  #: medians, of the widths of tips' intervals, and of their deflections
    deflection_mm: float = math.nan


def find_miscalibration(predictive: pd.DataFrame) -> list[Finding]:
    """Return whether intervals cover too few, cover too many, are too wide for aiming, or are off centre.

    Groups of repeats are trials (`group_rows`). Too few: the level lies above the 95 % confidence interval of
    the share. Too many, or a share of tips beyond their predictive median that is not a half: it lies outside
    the exact one. Needles predicted from one fit all follow its error, so that even "14 of 14" is one
    observation of that fit: a finding says that these predictions err alike, not that another fit would.
    """
    if predictive.empty:
        return []
    findings = []
    for what, level, found in list_coverages(predictive):
        if found.high < level / 100:
            findings.append(Finding("coverage", what, level, found))
        elif found.exact[0] > level / 100:
            findings.append(Finding("wide_coverage", what, level, found))
    measured, median = predictive["tip_measured_mm"], predictive["tip_median_mm"]
    beyond = (measured - median) * np.sign(median)
    for side, on_side in (("more", beyond > 0), ("less", beyond < 0)):
        found = estimate_proportion(list(on_side), group_rows(predictive))
        if found.exact[0] > 0.5:
            findings.append(Finding("off_centre", found=found, side=side))
    width, deflection = median_width(predictive), float(measured.abs().median())
    if is_too_wide(width, deflection):
        findings.append(Finding("wide_intervals", width_mm=width, deflection_mm=deflection))
    return findings


def judge_predictions(verdict: Verdict, predictive: pd.DataFrame, best: BestBaseline | None) -> Verdict:
    """Return a verdict that also states the scores of the predictions, and what is wrong with them.

    With a finding, or a baseline whose tips are closer than the medians or the scores, it does not pass. The
    error of a point prediction is its CRPS.
    """
    if predictive.empty:
        return verdict
    numbers = {
        "predictive_median_te_mm": tip_error_of_medians(predictive),
        **{name: float(predictive[name].mean()) for name in ("tip_crps_mm", "tip_interval_score_mm")},
    }
    nearest = math.inf if best is None or best.error_mm is None else best.error_mm
    findings = find_miscalibration(predictive)
    values = {**numbers, "findings": findings, "fits": predictive["fold"].nunique()}
    values["better_point"] = best.description if best and nearest < numbers["tip_crps_mm"] else ""
    part = KindText("verdicts").sentence("predictions", values)
    found = replace(verdict, sentence=f"{verdict.sentence}; {part}", numbers={**verdict.numbers, **numbers})
    worse = nearest < max(numbers["predictive_median_te_mm"], numbers["tip_crps_mm"])
    return qualify(found, found.sentence) if findings or worse else found


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
    *("shape_in_50", "shape_in_95", "tip_crps_mm", "tip_interval_score_mm"),
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
        **{name: predictions[name].mean() for name in ("tip_crps_mm", "tip_interval_score_mm")},
    }


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
