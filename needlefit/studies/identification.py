"""Find what is identifiable, and the 95 % interval of every fitted parameter.

Every fitted parameter has one 95 % interval: of certified draws, else of its profile. Verdicts follow it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np
import pandas as pd

from needlefit.arrays import Floats
from needlefit.inference.draws import Draws
from needlefit.inference.identifiability import directions
from needlefit.inference.identifiability.fit_profiles import FitProfiles, is_determined_by_profile
from needlefit.inference.identifiability.information import prior_information
from needlefit.inference.identifiability.loosened_assumptions import Loosened, find_condition
from needlefit.inference.identifiability.profile import DEVIANCE_95
from needlefit.inference.identifiability.verdict import Identifiability
from needlefit.inference.parameter_names import is_logarithmic, to_coordinate, to_value
from needlefit.inference.parameters import Parameters
from needlefit.inference.predictive_mixture import estimate_end_errors
from needlefit.inference.prior_shift import PriorShift, central_range
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.posterior import Posterior
from needlefit.reporting.number_format import (
    choose_interval_unit,
    choose_printed_unit,
    interval_width,
    typeset_interval,
)
from needlefit.reporting.table import Table, TableLayout
from needlefit.reporting.table_files import Row, to_records

#: columns of the table "identification": per fold and free parameter the information (`sd`), the profile
#: likelihood (the 95 % interval, how its ends came about, how far the deviance rises at most), and posterior
#: SD over prior SD
IDENTIFICATION_COLUMNS = (
    *("fold", "parameter", "determined", "note", "value", "prior_sd"),
    *("sd", "fisher_sd", "sd_ratio", "low", "high", "end_low", "end_high"),
    *("interval_low", "interval_high", "draw_source", "bound_low", "bound_high"),
    *("rise", "tip_shift_mm"),
)
#: columns of the table "profiles": deviances and their derivatives by ln (by alpha itself); then a column per
#: parameter
PROFILE_COLUMNS = ("fold", "parameter", "value", "deviance", "slope", "threshold")

FROM_PRIOR = "from the prior"  #: words for what limits a parameter whose posterior is about its prior


class ParameterRow(NamedTuple):
    """A row of the table "parameters": the value of a parameter by one method, in one fold.

    `sd` is of ln for moduli and lengths, of the value for alpha; `low`, `high` is the range among starts
    within tolerance of the best; `interval_low`, `interval_high` is the 95 % interval that is printed, with
    the Monte Carlo standard errors of its ends; `draw_source` is what it is from, `median` that of the same
    draws. `status` is "prior" where the posterior of a parameter is its prior, which moves a tip by
    `tip_shift_mm` at most. `determined` is "yes", "only together" (with the others held it is), or "no".
    """

    fold: str
    method: str
    parameter: str
    value: float
    status: str
    bound_low: float = math.nan
    bound_high: float = math.nan
    interval_low: float = math.nan
    interval_high: float = math.nan
    interval_low_error: float = math.nan
    interval_high_error: float = math.nan
    draw_source: str = ""
    median: float = math.nan
    sd: float = math.nan
    low: float = math.nan
    high: float = math.nan
    tip_shift_mm: float = math.nan
    determined: str = ""
    condition: str = ""
    note: str = ""

    @classmethod
    def read(cls, frame: pd.DataFrame) -> list[Self]:
        """Return the rows of a table; what is missing is NaN."""
        return [cls(*row) for row in frame[list(cls._fields)].itertuples(index=False, name=None)]

    @property
    def interval(self) -> tuple[float, float]:
        return self.interval_low, self.interval_high


@dataclass(frozen=True)
class IdentificationRows:
    """The rows about every parameter of one fold, before or after the fit."""

    by_profile: Mapping[str, bool]  #: whether a parameter is determined by its profile
    #: rows, points: of the frames "identification" and "profiles"
    rows: tuple[Row, ...]
    points: tuple[Row, ...]


def identify_parameters(
    problem: Problem,
    examination: FitProfiles,
    sds: Mapping[str, float],
    verdict: Identifiability | None = None,
    loosened: Sequence[Loosened] = (),
    together: Mapping[str, bool] | None = None,
) -> IdentificationRows:
    """Judge every parameter by its profile and its posterior SD.

    `sds`: posterior SDs by the information, bounds and prior included. `verdict`: of the fit. Before one a
    parameter is determined if its SD, its profile and `loosened` assumptions agree, and `together` are those
    that are determined while all others are held.
    """
    held = verdict.together if verdict is not None else together or {}
    spread = np.linalg.inv(prior_information(problem)) if problem.names else np.zeros((0, 0))
    before = dict(zip(problem.names, np.sqrt(np.diag(spread)).tolist(), strict=True))
    by_profile, rows, points = {}, [], []
    for k, parameter in enumerate(examination.parameters):
        prior_sd = before[parameter.name]
        sd = sds.get(parameter.name, 1 / math.hypot(1 / parameter.sd, 1 / prior_sd))
        by_profile[parameter.name] = is_determined_by_profile(parameter, prior_sd)
        if verdict is None:
            is_determined = directions.is_determined_by_data(parameter.name, sd, prior_sd)
            condition = find_condition(parameter.name, prior_sd, loosened) if is_determined else ""
        else:
            is_determined = verdict.determined.get(parameter.name, False)
            condition = verdict.conditions.get(parameter.name, "")
        is_known = is_determined and not condition and by_profile[parameter.name]
        word = directions.name_determined(is_known, held.get(parameter.name, False))
        name = parameter.name
        low, high = (to_value(name, end) for end in (parameter.low, parameter.high))
        rows.append(
            {
                "parameter": name,
                "value": to_value(name, parameter.best),
                "prior_sd": prior_sd,
                "sd": sd,
                "fisher_sd": parameter.sd,
                "sd_ratio": sd / prior_sd,
                "low": low,
                "high": high,
                "end_low": parameter.ends[0],
                "end_high": parameter.ends[1],
                **ParameterInterval(low, high, "profile").columns(),
                "bound_low": to_value(name, float(problem.lower[k])),
                "bound_high": to_value(name, float(problem.upper[k])),
                "rise": parameter.rise,
                "tip_shift_mm": math.nan,
                "determined": word,
                "note": condition,
            }
        )
        points += [  # with where all other parameters went
            {
                "parameter": name,
                "value": to_value(name, float(coordinate)),
                "deviance": float(deviance),
                "slope": float(slope),
                "threshold": DEVIANCE_95,
                **{n: to_value(n, float(other)) for n, other in zip(problem.names, theta, strict=True)},
            }
            for coordinate, deviance, slope, theta in zip(
                parameter.at, parameter.deviance, parameter.slope, parameter.thetas, strict=True
            )
        ]
    return IdentificationRows(by_profile, tuple(rows), tuple(points))


def list_held(parameters: Parameters, shifts: Mapping[str, PriorShift]) -> list[Row]:
    """Return the rows of parameters whose posterior is their prior, and of those tied to them.

    `tip_shift_mm` is by how much the prior moves a tip, at most.
    """
    rows, centre = list[Row](), parameters.values(parameters.expected)
    sources = {name: (1.0, name) for name in parameters.held}
    sources |= {name: tie for name, tie in parameters.ties.items() if tie[1] in sources}
    for name in (name for name in parameters.names if name in sources):
        factor, source = sources[name]
        sd = abs(factor) * parameters.prior.sd(source)
        low, high = sorted(factor * end for end in central_range(parameters, source))
        bounds = sorted(factor * end for end in parameters.bounds[source])
        row: Row = {"parameter": name, "value": centre[name], "status": "prior", "prior_sd": sd, "sd": sd}
        row |= {"sd_ratio": 1.0, "low": low, "high": high, "end_low": "prior", "end_high": "prior"}
        row |= ParameterInterval(low, high, "prior").columns() | {"median": centre[name]}
        row |= dict(zip(("bound_low", "bound_high"), bounds, strict=True))
        row |= {"tip_shift_mm": shifts[source].tip_mm} if source in shifts else {}
        rows.append(row | {"determined": "", "note": ""})
    return rows


def reconcile_verdict(verdict: Identifiability, by_profile: Mapping[str, bool]) -> Identifiability:
    """Return the verdict without the parameters whose profiles contradict it; notes state that."""
    denied = {n for n, is_found in by_profile.items() if verdict.determined.get(n) and not is_found}
    determined = {n: is_found and n not in denied for n, is_found in verdict.determined.items()}
    notes = {**verdict.notes, **dict.fromkeys(denied, "not determined: its profile is open or wide")}
    return replace(verdict, determined=determined, notes=notes)


# ---- intervals


@dataclass(frozen=True)
class ParameterInterval:
    """A 95 % interval, Pa or mm; `source` is "posterior" (sampled), "importance" or "profile"."""

    low: float
    high: float
    source: str
    median: float = math.nan
    errors: Sequence[float] = (math.nan, math.nan)  #: Monte Carlo standard errors of the ends

    def is_narrow(self, name: str) -> bool:
        """Return whether it is no wider than a Gaussian one of the largest SD of a determined parameter."""
        return interval_width(name, self.low, self.high) < directions.widest_interval(name)

    def scale(self, factor: float) -> "ParameterInterval":
        """Return the interval of a parameter that is exactly so many times as large."""
        low, high, median = (factor * value for value in (self.low, self.high, self.median))
        return replace(self, low=low, high=high, median=median, errors=[factor * e for e in self.errors])

    def allow_for(self, sd: float, row: ParameterRow) -> "ParameterInterval":
        """Return the interval as wide as with an independent error of this SD (of ln for moduli and lengths).

        Its median, else the value of `row`, is kept; the bounds of `row` stay the limits.
        """
        name = row.parameter
        half_width = interval_width(name, self.low, self.high) / (2 * directions.NORMAL_95_HALF_WIDTH_SD)
        wider = math.hypot(half_width, sd) / half_width if half_width > 0 else 1.0
        centre = to_coordinate(name, row.value if math.isnan(self.median) else self.median)
        low, high = (
            to_value(name, centre + wider * (to_coordinate(name, end) - centre))
            for end in (self.low, self.high)
        )
        # fmax, fmin: an exactly tied parameter has no bounds of its own
        low, high = float(np.fmax(low, row.bound_low)), float(np.fmin(high, row.bound_high))
        return replace(self, low=low, high=high)

    def columns(self) -> Row:
        return {"interval_low": self.low, "interval_high": self.high, "draw_source": self.source}


#: probability of an interval, and the percentiles of its lower end, the median and its upper end
_LEVEL, _PERCENTILES = 0.95, (2.5, 50, 97.5)


def intervals_of_draws(
    parameters: Parameters, draws: Draws | None, posterior: Posterior | None
) -> dict[str, ParameterInterval]:
    """Return the intervals of all estimated parameters: of the posterior if it has converged, else of draws.

    Draws that are not certified have none.
    """
    drawn, source, kinds = dict[str, tuple[Floats, float]](), "", {"free", "tied"}
    if draws is not None and draws.certified is not None:
        table, source = pd.DataFrame([parameters.values(theta) for theta in draws.thetas]), draws.source
        drawn = {str(name): (values.to_numpy(), len(table)) for name, values in table.items()}
    if posterior is not None and not posterior.faults:
        columns, source, kinds = posterior.draws.reshape(-1, len(posterior.names)).T, "posterior", {"free"}
        drawn = dict(zip(posterior.names, zip(columns, posterior.ess, strict=False), strict=True))
    intervals = {}
    for name, (values, independent) in drawn.items():
        if parameters.status[name] in kinds:
            low, median, high = np.percentile(values, _PERCENTILES).tolist()
            errors = estimate_end_errors(values, _LEVEL, independent).tolist()
            intervals[name] = ParameterInterval(low, high, source, median, errors)
    return intervals


def add_intervals(
    parameters: Sequence[ParameterRow],
    identification: Sequence[Row],
    sampled: Mapping[str, ParameterInterval],
    ties: Mapping[str, tuple[float, str]],
    together: Mapping[str, bool],
    model_error: Mapping[str, float],
) -> tuple[list[ParameterRow], list[Row]]:
    """Return the rows of one fold's fit and of its identifiability with their intervals, verdicts corrected.

    `sampled`: from `intervals_of_draws`. `ties`: factor and source. `together`: whether a parameter is
    determined while all others are held. `model_error`: SD that an error of the model adds to each free
    parameter, of ln for moduli and lengths.
    """
    judged = {row["parameter"]: row for row in identification}
    profiles = {name: ParameterInterval(row["low"], row["high"], "profile") for name, row in judged.items()}
    rows = list[ParameterRow]()
    for row in parameters:
        if row.status == "prior":
            rows.append(row)
            continue
        name, (factor, source) = row.parameter, ties.get(row.parameter, (1.0, row.parameter))
        intervals = None
        if row.status != "fixed":
            intervals = sampled.get(name, profiles.get(name))
            if intervals is None and (of_source := sampled.get(source, profiles.get(source))):
                intervals = of_source.scale(factor)
        if intervals is not None:
            intervals = intervals.allow_for(model_error.get(source, 0.0), row)
            row = row._replace(**intervals.columns(), median=intervals.median)
            at_low, at_high = intervals.errors
            row = row._replace(interval_low_error=at_low, interval_high_error=at_high)
        if row.determined == "yes" and not (intervals and intervals.is_narrow(name)):
            row = row._replace(
                determined=directions.name_determined(False, together.get(source, False)),
                condition="",
                note=f"its 95 % interval is {'too wide' if intervals else 'not known'}",
            )
        if name in judged:
            ends = (intervals or profiles[name]).columns()
            judged[name] = {**judged[name], **ends, "determined": row.determined}
        rows.append(row)
    return rows, list(judged.values())


# ---- the table of what is identifiable, of a fit and of a design

_INTERVAL_NOTE = "All other values are in identify.csv."


def lay_out_identification(identification: pd.DataFrame, expected: bool = False) -> TableLayout:
    """Return one row per parameter."""
    several = identification["fold"].nunique() > 1
    rows = [
        {**row, **_format_cells(row, expected), "fold": row["fold"] if several else ""}
        for row in to_records(identification)
    ]
    columns_shown = ("sd", "profile_low", "profile_high", "sd_ratio") if expected else ("interval_95",)
    columns = ("fold", "parameter", "determined", *columns_shown, "note")
    caption = f"Identifiability of each parameter from the {'design' if expected else 'data'}."
    notes = () if expected else (_INTERVAL_NOTE,)  # what a design has stands in the text of its report
    table = Table("identification", rows, columns, groups=("fold",), caption=caption, notes=notes)
    return table.lay_out(drop_empty=True)


def _format_cells(row: Row, expected: bool) -> Row:
    name = str(row["parameter"])
    closed = {side: row[side] for side in ("low", "high") if row[f"end_{side}"] in ("closed", "prior")}
    if expected:
        label, unit = choose_printed_unit(name, [row["value"], *closed.values()])
    else:
        label, unit = choose_interval_unit(row, row["value"])
    return {
        **{side: closed[side] / unit if side in closed else "open" for side in ("low", "high")},
        "sd": None if row["sd"] is None else directions.format_sd(row["sd"], is_logarithmic(name)),
        "parameter": label,
        "interval_95": typeset_interval(row, unit),
        **({} if row["tip_shift_mm"] is None else {"note": describe_prior(row["tip_shift_mm"])}),
    }


def describe_prior(tip_shift_mm: float | None) -> str:
    """Return in words that a parameter is known by its prior alone, which moves a tip by so much at most."""
    if tip_shift_mm is None:
        return "the prior"
    return f"the prior: moves tips by at most {max(1, math.ceil(1000 * tip_shift_mm)) / 1000:g} mm"
