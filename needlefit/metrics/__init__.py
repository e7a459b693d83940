"""Error metrics, here or of a plugin. Whatever shows errors iterates over them.

They are of the coordinates that are compared: of points in the plane of the needle, or in space.
"""

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np

from needlefit.errors import ConfigError
from needlefit.geometry.curves import ComparedCurves, Quantity
from needlefit.registry import Registry

#: words in names for units that are no letters
UNIT_WORDS = {
    "times the noise": "noise",
    "%": "percent",
    "°": "deg",
    "mm²": "mm2",
    "1/mm": "1_per_mm",
    "1/m": "1_per_m",
}


@dataclass(frozen=True)
class Metric:
    """An error of a simulated curve against a measured one; smaller is better."""

    #: its name in files: the value of the column `metric`. It ends in its unit: `_mm`, `_percent`, `_deg`
    name: str
    label: str  #: its heading in tables
    unit: str  #: of any quantity: "mm", "%", "deg", "N"
    explanation: str  #: one sentence for the glossary
    #: compared curves of one insertion -> the error. Over insertions its mean is taken.
    compute: Callable[[ComparedCurves], float]
    #: whether its noise floor is given: the mean of `compute` over draws of the stated noise
    has_floor: bool = True
    #: whether it stands in sentences and comparisons of methods too, and not in tables of errors alone
    headline: bool = False
    #: whether it is relative to the measured deflection, and so means little where that is within the noise
    relative: bool = False
    of_curve: bool = False  #: whether it needs a measured curve: of a tip alone it is NaN
    spread_of: str = ""  #: the metric behind which it is printed as "± value"; empty: in a column of its own
    order: int = 100  #: its place in tables, from the left
    quantity: Quantity = "places"  #: of which compared curves it is an error
    missed: str = ""  #: what a verdict by it says is missed, such as "tips"; empty: no verdict is by it

    def __post_init__(self) -> None:
        """Raise ConfigError if the name does not end in the unit, which files state nowhere else."""
        word = UNIT_WORDS.get(self.unit, self.unit.lower())
        if not self.name.endswith(f"_{word}"):
            problem = f"the metric `{self.name}` has the unit {self.unit!r}"
            fix = f"rename it, or state its unit; words of units: {UNIT_WORDS}"
            raise ConfigError(problem, expected=f"a name that ends in _{word}", fix=fix)


METRICS = Registry(Metric, __name__, "metric")


def _compute_rms(curves: ComparedCurves) -> float:
    """Return the root mean square of the distances, in their unit."""
    return float(np.sqrt(np.mean(curves.distances**2)))


def list_metrics(*quantities: Quantity) -> tuple[Metric, ...]:
    """Return all metrics, or those of some quantities, in the order of tables."""
    some = (metric for metric in METRICS.values() if metric.quantity in (quantities or (metric.quantity,)))
    return tuple(sorted(some, key=lambda metric: (metric.order, metric.name)))


def known_metrics(columns: Collection[str]) -> tuple[Metric, ...]:
    """Return the metrics of a table with these columns: those of places, and others that it has."""
    return tuple(metric for metric in list_metrics() if metric.quantity == "places" or metric.name in columns)


def headline_metrics() -> tuple[Metric, ...]:
    """Return the metrics of sentences and comparisons."""
    return tuple(metric for metric in list_metrics() if metric.headline)


def verdict_metrics() -> tuple[Metric, ...]:
    """Return the metrics of verdicts; one is by the first that is known of the insertions."""
    return tuple(metric for metric in list_metrics() if metric.missed)


def compute_metrics(curves: ComparedCurves) -> dict[str, float]:
    """Return the errors of one insertion, by metric: those of what is compared.

    Raises ConfigError if a metric of a plugin fails.
    """
    values = {}
    for metric in list_metrics(curves.quantity):
        with METRICS.plugin_error_context(metric.name):
            is_defined = curves.is_curve or not metric.of_curve
            values[metric.name] = float(metric.compute(curves)) if is_defined else math.nan
    return values


MEDIAN = Metric(
    "median_err_mm",
    "Median",
    "mm",
    "Median distance between simulated and measured points of a curve.",
    compute=lambda curves: float(np.median(curves.distances)),
    of_curve=True,
    order=10,
)

IPE = Metric(
    "ipe_mean_mm",
    "IPE",
    "mm",
    "In-plane error (IPE): mean distance between simulated and measured points at equal fractions of the "
    "length.",
    compute=lambda curves: float(np.mean(curves.distances)),
    headline=True,
    of_curve=True,
    order=20,
)

IPE_SPREAD = Metric(
    "ipe_std_mm",
    "SD of IPE",
    "mm",
    "Standard deviation of the in-plane error over a curve.",
    compute=lambda curves: float(np.std(curves.distances)),
    has_floor=False,
    spread_of="ipe_mean_mm",
    of_curve=True,
    order=21,
)

MAX_IPE = Metric(
    "ipe_max_mm",
    "Max IPE",
    "mm",
    "Largest in-plane error of a curve.",
    compute=lambda curves: float(np.max(curves.distances)),
    of_curve=True,
    order=30,
)

TE = Metric(
    "te_mm",
    "TE",
    "mm",
    "Tip error (TE): distance between the simulated and the measured tip.",
    compute=lambda curves: curves.tip_error,
    headline=True,
    order=40,
    missed="tips",
)

TRACK_RMS = Metric(
    "track_rms_mm",
    "RMS",
    "mm",
    "Root mean square distance between simulated and measured tips over the readings of a track.",
    compute=_compute_rms,
    headline=True,
    order=35,
    quantity="readings",
    missed="readings",
)

OVER_NOISE = Metric(
    "error_over_noise",
    "Error",
    "times the noise",
    "TE, or RMS of readings or curvatures, over its noise floor, where needles are measured in several ways.",
    compute=lambda curves: math.nan,
    has_floor=False,
    headline=True,
    order=5,
    quantity="noise",
    missed="measurements",
)  # metric of tables of errors alone

CURVATURE_RMS = Metric(
    "curvature_rms_1_per_m",
    "RMS curvature error",
    "1/m",
    "Root mean square distance between simulated and measured curvatures.",
    compute=_compute_rms,
    headline=True,
    order=60,
    quantity="curvatures",
    missed="curvatures",
)

INTEGRATED_TE = Metric(
    "te_integrated_mm",
    "TE from the base",
    "mm",
    "Tip error of curvatures: distance between the tips to which simulated and measured readings lead from "
    "the needle's base, or from a guide.",
    compute=lambda curves: curves.tip_error,
    headline=True,
    order=70,
    quantity="integrated",
)


def _relate(error: float, deflection: float) -> float:
    """Return 100 error / deflection; infinite where the measured needle stayed straight."""
    if not deflection:
        return np.inf if error else 0.0
    return 100 * error / deflection


EDP = Metric(
    "edp_percent",
    "EDP",
    "%",
    "Error-to-deflection percentage (EDP): tip error in percent of the tip's measured deflection.",
    compute=lambda curves: _relate(curves.tip_error, curves.deflection),
    has_floor=False,
    relative=True,
    order=50,
)
