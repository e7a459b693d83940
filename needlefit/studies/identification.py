"""Find what is identifiable, and the 95 % interval of every fitted parameter.

Every fitted parameter has one 95 % interval: of certified draws, else of its profile. Verdicts follow it. A
fixed shape parameter has that of the posterior that it would have if it were free, by its profile.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from needlefit.inference.identifiability import directions, precision
from needlefit.inference.identifiability.identify import (
    Assessment,
    FitProfiles,
    Identifiability,
    ParameterProfile,
    assess_parameter,
)
from needlefit.inference.identifiability.profile import DEVIANCE_95
from needlefit.inference.parameters import Parameters, to_coordinate, to_value
from needlefit.inference.predict import Draws
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.posterior import Posterior
from needlefit.reporting.number_format import (
    interval_width,
)
from needlefit.reporting.table_files import Row


@dataclass(frozen=True)
class IdentificationRows:
    """The rows about every parameter of one fold, before or after the fit."""

    judgements: Mapping[str, Assessment]  #: by parameter
    #: rows, points: of the frames "identification" and "profiles"
    rows: tuple[Row, ...]
    points: tuple[Row, ...]


def identify_parameters(
    problem: Problem,
    examination: FitProfiles,
    sds: Mapping[str, float],
    verdict: Identifiability | None = None,
    loosened: Sequence[precision.Loosened] = (),
    together: Mapping[str, bool] | None = None,
) -> IdentificationRows:
    """Judge every parameter by its profile and its posterior SD.

    `sds`: posterior SDs by the information, bounds and prior included. `verdict`: of the fit. Before one a
    parameter is determined if its SD, its profile and `loosened` assumptions agree, and `together` are those
    that are determined while all others are held.
    """
    held = verdict.together if verdict is not None else together or {}
    spread = np.linalg.inv(precision.prior_information(problem)) if problem.names else np.zeros((0, 0))
    before = dict(zip(problem.names, np.sqrt(np.diag(spread)).tolist(), strict=True))
    judgements, rows, points = {}, [], []
    for one in examination.parameters:
        prior_sd = before.get(one.name, (one.bounds[1] - one.bounds[0]) / math.sqrt(12))
        density = one.profile.density(one.bounds) if one.fixed_at is not None else None
        by_profile = 1 / math.hypot(1 / one.profile.sd, 1 / prior_sd) if density is None else density.sd
        sd = sds.get(one.name, by_profile)
        equal = None  # between which coordinates equally good starts ended
        if verdict is not None and verdict.equal_starts > 1 and one.name in verdict.spread_low:
            low, high = verdict.spread_low[one.name], verdict.spread_high[one.name]
            equal = (to_coordinate(one.name, low), to_coordinate(one.name, high))
        judged = assess_parameter(one, (sd, prior_sd), equal)
        judgements[one.name] = judged
        condition = ""
        if verdict is None:
            is_determined = directions.is_determined_by_data(one.name, sd, prior_sd)
            if is_determined and one.fixed_at is None:
                condition = precision.find_condition(one.name, prior_sd, loosened)
        else:
            is_determined = verdict.determined.get(one.name, False)
            condition = verdict.conditions.get(one.name, "")
        known = is_determined and not condition and judged.determined and one.fixed_at is None
        word = directions.name_determined(known, held.get(one.name, False))
        rows.append(_parameter_row(one, judged, prior_sd, sd) | {"determined": word, "note": condition})
        if density is not None:
            rows[-1] |= {"interval_low": density.low, "interval_high": density.high}
        rows += [{**rows[-1], "parameter": name, "note": f"freed with {one.name}"} for name in one.same]
        points += _profile_rows(problem.parameters, one)
    return IdentificationRows(judgements, tuple(rows), tuple(points))


def reconcile_verdict(verdict: Identifiability, judgements: Mapping[str, Assessment]) -> Identifiability:
    """Return the verdict without the parameters whose profiles contradict it; notes state that."""
    denied = {n for n, one in judgements.items() if verdict.determined.get(n) and not one.determined}
    known = {n: found and n not in denied for n, found in verdict.determined.items()}
    notes = dict(verdict.notes)
    for n, one in judgements.items():
        if n in denied:
            shape = one.profile_verdict.removeprefix("not identifiable: ")
            notes[n] = f"not determined: by its profile {shape}"
        elif known.get(n) and one.agreement != directions.AGREEMENT:
            notes[n] += f"; {one.agreement}"
    return replace(verdict, determined=known, notes=notes)


def _parameter_row(one: ParameterProfile, judged: Assessment, prior_sd: float, sd: float) -> Row:
    profile, nothing = one.profile, math.nan
    return {
        "parameter": one.name,
        "status": "free" if one.fixed_at is None else "fixed",
        "value": to_value(one.name, profile.best) if one.fixed_at is None else one.fixed_at,
        "prior_sd": prior_sd,
        "sd": sd,
        "fisher_sd": profile.sd,
        "sd_ratio": sd / prior_sd,
        "low": judged.interval[0],
        "high": judged.interval[1],
        "end_low": profile.ends[0],
        "end_high": profile.ends[1],
        "interval_low": judged.interval[0],
        "interval_high": judged.interval[1],
        "draw_source": "profile",
        "bound_low": to_value(one.name, one.bounds[0]),
        "bound_high": to_value(one.name, one.bounds[1]),
        "rise": profile.rise,
        "log_posterior_rise": nothing if one.log_posterior_rise is None else one.log_posterior_rise,
        "minima": profile.minima,
        "tip_range_mm": nothing if one.tip_range_mm is None else one.tip_range_mm,
        "profile_verdict": judged.profile_verdict,
        "agreement": judged.agreement,
    }


def _profile_rows(parameters: Parameters, one: ParameterProfile) -> list[Row]:
    """Return the computed points of one profile, with where all other parameters went."""
    profile = one.profile
    # a freed alpha is not among the fit's parameters: it stands under its own name, theirs keep theirs
    names = [name for name in parameters.names if name in parameters.bounds or name == one.name]
    return [
        {
            "parameter": one.name,
            "value": to_value(one.name, float(profile.at[k])),
            "deviance": float(profile.deviance[k]),
            "slope": float(profile.slope[k]),
            "fisher_deviance": float(profile.parabola(profile.at[k : k + 1])[0]),
            "threshold": DEVIANCE_95,
            **{name: to_value(name, float(at)) for name, at in zip(names, profile.thetas[k], strict=True)},
        }
        for k in range(len(profile.at))
    ]


# ---- intervals


@dataclass(frozen=True)
class ParameterInterval:
    """A 95 % interval, Pa or mm; `source` is "posterior" (sampled), "importance" or "profile"."""

    low: float
    high: float
    source: str
    median: float = math.nan

    def is_narrow(self, name: str) -> bool:
        """Return whether it is no wider than a Gaussian one of the largest SD of a determined parameter."""
        return interval_width(name, self.low, self.high) < directions.widest_interval(name)

    def scale(self, factor: float) -> "ParameterInterval":
        """Return the interval of a parameter that is exactly so many times as large."""
        low, high, median = (factor * one for one in (self.low, self.high, self.median))
        return replace(self, low=low, high=high, median=median)

    def allow_for(self, name: str, sd: float, row: Row) -> "ParameterInterval":
        """Return the interval as wide as with an independent error of this SD (of ln for moduli and lengths).

        Its median, else the value of `row`, is kept; the bounds of `row` stay the limits.
        """
        own = interval_width(name, self.low, self.high) / (2 * directions.NORMAL_95_HALF_WIDTH_SD)
        wider = math.hypot(own, sd) / own if own > 0 else 1.0
        centre = to_coordinate(name, row["value"] if math.isnan(self.median) else self.median)
        low, high = (
            to_value(name, centre + wider * (to_coordinate(name, end) - centre))
            for end in (self.low, self.high)
        )
        # fmax, fmin: an exactly tied parameter has no bounds of its own
        low, high = float(np.fmax(low, row["bound_low"])), float(np.fmin(high, row["bound_high"]))
        return replace(self, low=low, high=high)

    def columns(self) -> Row:
        return {"interval_low": self.low, "interval_high": self.high, "draw_source": self.source}


NO_SOURCE: Row = ParameterInterval(math.nan, math.nan, "").columns() | {"median": math.nan}
_PERCENTILES = (2.5, 50, 97.5)


def intervals_of_draws(
    parameters: Parameters, draws: Draws | None, posterior: Posterior | None
) -> dict[str, ParameterInterval]:
    """Return the intervals of all estimated parameters: of the posterior if it has converged, else of draws.

    Draws that are not certified have none.
    """
    found: dict[str, tuple[float, ...]] = {}
    source = "" if draws is None else draws.source
    if draws is not None and draws.certified is not None:
        sets = [parameters.values(theta) for theta in draws.thetas]
        for name in (name for name in sets[0] if parameters.status[name] != "fixed"):
            found[name] = tuple(np.percentile([values[name] for values in sets], _PERCENTILES).tolist())
    if posterior is not None and not posterior.faults:
        found, source = posterior.percentiles(_PERCENTILES), "posterior"
    return {name: ParameterInterval(low, high, source, median) for name, (low, median, high) in found.items()}


def add_intervals(
    parameters: Sequence[Row],
    identification: Sequence[Row],
    sampled: Mapping[str, ParameterInterval],
    ties: Mapping[str, tuple[float, str]],
    together: Mapping[str, bool],
    model_error: Mapping[str, float],
) -> None:
    """Add the interval to the rows of one fold's fit and of its identifiability, and correct the verdicts.

    `sampled`: from `intervals_of_draws`. `ties`: factor and source. `together`: whether a parameter is
    determined while all others are held. `model_error`: SD that an error of the model adds to each free
    parameter, of ln for moduli and lengths.
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
            found = one and one.scale(factor)
        if found is not None:
            found = found.allow_for(name, model_error.get(ties.get(name, (1.0, name))[1], 0.0), row)
        row |= NO_SOURCE if found is None else found.columns() | {"median": found.median}
        if row["determined"] == "yes" and not (found and found.is_narrow(name)):
            held = together.get(ties.get(name, (1.0, name))[1], False)
            row |= {"determined": directions.name_determined(False, held), "condition": ""}
            row["note"] = f"its 95 % interval is {'too wide' if found else 'not known'}"
        if name in judged and row["status"] != "fixed":
            judged[name] |= found.columns() if found else profiles[name].columns()
            judged[name]["determined"] = row["determined"]
