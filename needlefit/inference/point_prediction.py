"""The point of a predictive distribution that is reported: the posterior mode's, or the median.

The needle of the mode is closer on average (`studies/point_predictions.py`). It is no point of the
distribution where the posterior rises up to a bound, whose value someone stated, or where next to no draw
predicts it: then the median of the draws is reported.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from needlefit.arrays import Floats
from needlefit.inference.identifiability.information import find_bounds
from needlefit.inference.parameter_names import HYPERPARAMETERS
from needlefit.inference.predictive_mixture import INTERVAL_PROBABILITIES
from needlefit.inference.problem import Problem

#: half (mm) of the last digit that is printed of a needle: a smaller movement counts as none, and a point
#: less far outside of an interval as inside
PRINTED_MM = 0.005


@dataclass(frozen=True)
class PointPrediction:
    """Which point is reported, and why it is not the mode's."""

    mode_fault: Literal["none", "at_bound", "outside"] = "none"
    #: by parameter of the mode that lies at a bound and moves the needle: "lower" or "upper"
    at_bound: Mapping[str, str] = field(default_factory=dict)

    @property
    def is_median(self) -> bool:
        """Whether the median of the draws is reported."""
        return self.mode_fault != "none"

    def take(self, mode: Floats, draws: Floats) -> Floats:
        """Return the point (...), of what the mode predicts (...) and the draws (B, ...)."""
        median: Floats = np.median(draws, axis=0)
        return median if self.is_median else mode


def choose_point(
    problem: Problem, mode: Floats, draws: Floats, predict: Callable[[Floats], Floats]
) -> PointPrediction:
    """Choose the point by the mode, theta (P,), and what draws predict (B, ...), mm.

    `predict` returns what a theta predicts (...), mm, NaN where it has no solution.
    """
    predicted, parameters = predict(mode), problem.parameters
    at_bound = dict[str, str]()
    for k, (name, end) in enumerate(zip(parameters.free, find_bounds(problem, mode), strict=True)):
        if not end or name in (*HYPERPARAMETERS, *parameters.held):
            continue
        inside = mode.copy()
        inside[k] = (problem.lower[k] + problem.upper[k]) / 2
        if not np.abs(predict(inside) - predicted).max() < PRINTED_MM:  # NaN: it is not known to move nothing
            at_bound[name] = end
    if at_bound:
        return PointPrediction("at_bound", at_bound)
    level = max(INTERVAL_PROBABILITIES)
    low, high = np.quantile(draws, [(1 - level) / 2, (1 + level) / 2], axis=0)
    within = (low - PRINTED_MM <= predicted) & (predicted <= high + PRINTED_MM)
    return PointPrediction("none" if within.all() else "outside")
