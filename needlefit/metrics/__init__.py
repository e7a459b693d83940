"""Error metrics: each is one file here, or of a plugin. Whatever shows errors iterates over them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from needlefit.arrays import Floats
from needlefit.geometry.curves import ComparedCurves
from needlefit.registry import Registry


@dataclass(frozen=True)
class Metric:
    """An error of a simulated curve against a measured one; smaller is better."""

    #: its name in files: the value of the column `metric`. It ends in its unit, `_mm` or `_percent`.
    name: str
    label: str  #: its heading in tables
    unit: Literal["mm", "%"]
    explanation: str  #: one sentence for the glossary
    #: compared curves of one insertion -> the error. Over insertions its mean is taken.
    compute: Callable[[ComparedCurves], float]
    #: compared curves of several insertions -> one error of all their points together; None: the mean
    pool: Callable[[Sequence[ComparedCurves]], float] | None = None
    #: whether its noise floor is given: the mean of `compute` over draws of the stated noise
    has_floor: bool = True
    #: whether it stands in sentences and comparisons of methods too, and not in tables of errors alone
    headline: bool = False
    #: whether it is relative to the measured deflection, and so means little where that is within the noise
    relative: bool = False
    spread_of: str = ""  #: the metric behind which it is printed as "± value"; empty: in a column of its own
    macro: str = ""  #: its name in LaTeX macros; empty: `name` without unit
    order: int = 100  #: its place in tables, from the left

    @property
    def macro_name(self) -> str:
        """The name in LaTeX macros."""
        return self.macro or self.name.removesuffix("_mm").removesuffix("_percent").replace("_", "-")


METRICS = Registry(Metric, __name__, "metric")


def list_metrics() -> tuple[Metric, ...]:
    """Return all metrics in the order of tables."""
    return tuple(sorted(METRICS.values(), key=lambda metric: (metric.order, metric.name)))


def headline_metrics() -> tuple[Metric, ...]:
    """Return the metrics of sentences and comparisons."""
    return tuple(metric for metric in list_metrics() if metric.headline)


def compute_metrics(curves: ComparedCurves) -> dict[str, float]:
    """Return all errors of one insertion, by metric.

    Raises ConfigError if a metric of a plugin fails.
    """
    found = {}
    for metric in list_metrics():
        with METRICS.plugin_error_context(metric.name):
            found[metric.name] = float(metric.compute(curves))
    return found


def pool_metric(metric: Metric, curves: Sequence[ComparedCurves]) -> float:
    """Return an error of all points of several insertions together, or the mean over the insertions.

    NaN without insertions.
    """
    if not curves:
        return float("nan")
    with METRICS.plugin_error_context(metric.name):
        if metric.pool is not None:
            return float(metric.pool(curves))
        values = np.array([metric.compute(one) for one in curves])
        return float(np.mean(values[np.isfinite(values)])) if np.isfinite(values).any() else float("nan")


def pool_distances(curves: Sequence[ComparedCurves]) -> Floats:
    """Return the in-plane errors of all points of several insertions together, mm."""
    return np.concatenate([one.distances for one in curves])
