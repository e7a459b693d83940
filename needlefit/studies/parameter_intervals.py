"""Give every fitted parameter one 95 % interval: of certified draws, else of its profile.

Verdicts follow it: what is called determined has a narrow one.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from needlefit.inference.identifiability.identify import NORMAL_95_HALF_WIDTH_SD
from needlefit.inference.identifiability.precision import MAX_LOG_SD, MAX_SHAPE_SD
from needlefit.inference.parameters import Parameters, is_logarithmic
from needlefit.inference.predict import Draws
from needlefit.inference.sampling.posterior import Posterior
from needlefit.reporting.number_format import interval_width

Row = dict[str, Any]

NO_SOURCE = {"interval_low": math.nan, "interval_high": math.nan, "draw_source": ""}
_PERCENTILES = (2.5, 97.5)


@dataclass(frozen=True)
class ParameterInterval:
    """A 95 % interval, Pa or mm; `source` is "posterior" (sampled), "importance" or "profile"."""

    low: float
    high: float
    source: str

    def width(self, name: str) -> float:
        """Return the width of the coordinate: of ln for moduli and lengths."""
        return interval_width(name, self.low, self.high)

    def is_narrow(self, name: str) -> bool:
        """Return whether it is no wider than a Gaussian one of the largest SD of a determined parameter."""
        sd = MAX_LOG_SD if is_logarithmic(name) else MAX_SHAPE_SD
        return self.width(name) < 2 * NORMAL_95_HALF_WIDTH_SD * sd

    def columns(self) -> Row:
        """Return the columns of a table of parameters."""
        return {"interval_low": self.low, "interval_high": self.high, "draw_source": self.source}


def intervals_of_draws(
    parameters: Parameters, draws: Draws | None, posterior: Posterior | None
) -> dict[str, ParameterInterval]:
    """Return the intervals of all estimated parameters from the draws, if these are certified."""
    if posterior is not None:
        found = posterior.percentiles(_PERCENTILES) if posterior.converged else {}
        return {name: ParameterInterval(low, high, "posterior") for name, (low, high) in found.items()}
    if draws is None or draws.certified is None:
        return {}
    sets = [parameters.values(theta) for theta in draws.thetas]
    estimated = [name for name in sets[0] if parameters.status[name] != "fixed"]
    ends = np.percentile([[one[name] for name in estimated] for one in sets], _PERCENTILES, axis=0)
    return {
        name: ParameterInterval(low, high, draws.source)
        for name, (low, high) in zip(estimated, ends.T.tolist(), strict=True)
    }


def add_intervals(
    parameters: Sequence[Row],
    identification: Sequence[Row],
    sampled: Mapping[str, ParameterInterval],
    ties: Mapping[str, tuple[float, str]],
) -> None:
    """Add the interval to the rows of one fold's fit and of its identifiability, and correct the verdicts.

    Parameters
    ----------
    parameters, identification : sequence of rows
        Of the frames "parameters", the fit's alone, and "identification".
    sampled : mapping
        By parameter, from `intervals_of_draws`.
    ties : mapping
        Exact ties: factor and source.
    """
    profiles = {row["parameter"]: ParameterInterval(row["low"], row["high"], "profile")
                for row in identification}  # fmt: skip
    judged = {row["parameter"]: row for row in identification}
    for row in parameters:
        name = str(row["parameter"])
        found = None if row["status"] == "fixed" else sampled.get(name, profiles.get(name))
        if found is None and name in ties and row["status"] != "fixed":
            factor, source = ties[name]
            one = sampled.get(source, profiles.get(source))
            found = one and ParameterInterval(factor * one.low, factor * one.high, one.source)
        row |= NO_SOURCE if found is None else found.columns()
        if found is not None and row["determined"] and not found.is_narrow(name):
            row |= {"determined": False, "condition": "", "note": "not determined: its 95 % interval is wide"}
        if name in judged:
            judged[name] |= found.columns() if found else profiles[name].columns()
            judged[name]["determined"] = bool(judged[name]["determined"] and row["determined"])
