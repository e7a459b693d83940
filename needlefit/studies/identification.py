"""Find what is identifiable, and the 95 % interval of every fitted parameter.

Every fitted parameter has one 95 % interval: of certified draws, else of its profile. Verdicts follow it. A
fixed shape parameter has that of the posterior that it would have if it were free, by its profile.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.inference.identifiability import directions, precision
from needlefit.inference.identifiability.identify import (
    AGREEMENT,
    Assessment,
    FitProfiles,
    Identifiability,
    ParameterProfile,
    assess_parameter,
)
from needlefit.inference.identifiability.profile import DEVIANCE_95, LikelihoodProfile
from needlefit.inference.parameter_changes import find_freed_bounds
from needlefit.inference.parameters import Parameters, to_coordinate, to_value
from needlefit.inference.predict import Draws
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.posterior import Posterior
from needlefit.mechanics.laws import LAWS
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
    found = examination.parameters
    unmet = _list_unmet(problem, {name for one in found for name in (one.name, *one.same)})
    for n, one in enumerate((*found, *unmet)):
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
        if n >= len(found):
            rows[-1] |= {"note": "no insertion reaches its layer"}
        else:
            points += _profile_rows(problem.parameters, one)
    return IdentificationRows(judgements, tuple(rows), tuple(points))


def _list_unmet(problem: Problem, known: Collection[str]) -> list[ParameterProfile]:
    """Return the flat profiles of fixed shape parameters in layers that no insertion meets."""
    law, parameters = problem.medium.law, problem.parameters
    met = {layer for insertion in problem.insertions for layer in insertion.sequence}
    layers = [layer for layer in range(1, problem.medium.layers + 1) if layer not in met]
    profiles = []
    for name in (name for row in LAWS[law].name_shape(layers) for name in row):
        if name not in parameters.fixed or name in known:
            continue
        low, high = find_freed_bounds(parameters, name, law)
        ends, value, nothing = np.array([low, high]), parameters.fixed[name], np.zeros(2)
        flat = LikelihoodProfile(
            name, ends, nothing, nothing, np.empty((2, 0)), value, math.inf, low, high, ("bound", "bound"),
            minima=1,
        )  # fmt: skip
        profiles.append(ParameterProfile(flat, (low, high), value, tip_range_mm=0.0, log_posterior_rise=0.0))
    return profiles


def reconcile_verdict(verdict: Identifiability, judgements: Mapping[str, Assessment]) -> Identifiability:
    """Return the verdict without the parameters whose profiles contradict it; notes state that."""
    denied = {n for n, one in judgements.items() if verdict.determined.get(n) and not one.determined}
    known = {n: found and n not in denied for n, found in verdict.determined.items()}
    notes = dict(verdict.notes)
    for n, one in judgements.items():
        if n in denied:
            shape = one.profile_verdict.removeprefix("not identifiable: ")
            notes[n] = f"not determined: by its profile {shape}"
        elif known.get(n) and one.agreement != AGREEMENT:
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
        "sd_low": nothing,
        "sd_high": nothing,
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
    importance_low: float = math.nan
    importance_high: float = math.nan

    def is_narrow(self, name: str) -> bool:
        """Return whether it is no wider than a Gaussian one of the largest SD of a determined parameter."""
        return interval_width(name, self.low, self.high) < directions.widest_interval(name)

    def scale(self, factor: float) -> "ParameterInterval":
        """Return the interval of a parameter that is exactly so many times as large."""
        lengths = ("low", "high", "median", "importance_low", "importance_high")
        return replace(self, **{name: factor * getattr(self, name) for name in lengths})

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

    def sampled_columns(self) -> Row:
        """Return what draws alone know, with the columns of the interval."""
        own = {name: getattr(self, name) for name in ("median", "importance_low", "importance_high")}
        return {**self.columns(), **own}


NO_SOURCE = ParameterInterval(math.nan, math.nan, "").sampled_columns()
_PERCENTILES = (2.5, 50, 97.5)


def intervals_of_draws(
    parameters: Parameters, draws: Draws | None, importance: Draws | None, posterior: Posterior | None
) -> dict[str, ParameterInterval]:
    """Return the intervals of all estimated parameters: of the posterior if it has converged, else of draws.

    Beside each stands that of the draws by `importance`. Draws that are not certified have none.
    """
    before = _take_percentiles(parameters, importance)
    found, source = _take_percentiles(parameters, draws), "" if draws is None else draws.source
    if posterior is not None and not posterior.faults:
        found, source = posterior.percentiles(_PERCENTILES), "posterior"
    nothing = (math.nan,) * len(_PERCENTILES)
    intervals = {}
    for name, (low, median, high) in found.items():
        importance_low, _, importance_high = before.get(name, nothing)
        intervals[name] = ParameterInterval(low, high, source, median, importance_low, importance_high)
    return intervals


def _take_percentiles(parameters: Parameters, draws: Draws | None) -> dict[str, tuple[float, ...]]:
    """Return the percentiles of all estimated parameters over draws; none if these are not certified."""
    if draws is None or draws.certified is None:
        return {}
    estimated = _tabulate_estimated(parameters, draws)
    return {name: tuple(np.percentile(values, _PERCENTILES).tolist()) for name, values in estimated.items()}


def _tabulate_estimated(parameters: Parameters, draws: Draws) -> dict[str, Floats]:
    """Return the values (B,) of all estimated parameters over draws, Pa or mm."""
    sets = [parameters.values(theta) for theta in draws.thetas]
    estimated = [name for name in sets[0] if parameters.status[name] != "fixed"]
    return {name: np.array([one[name] for one in sets]) for name in estimated}


MONTE_CARLO_SD = 3.0  #: standard errors within which the end of an interval is looked for


def list_differing_intervals(
    parameters: Parameters, importance: Draws, posterior: Posterior
) -> tuple[str, ...]:
    """Return the parameters whose intervals by both samplers differ by more than their Monte Carlo error.

    Of n independent draws the quantile of p lies between their quantiles of p -+ z sqrt(p (1 - p) / n). None
    where either has not converged, or is not certified.
    """
    if importance.certified is None or posterior.faults:
        return ()
    by_importance, differing = _tabulate_estimated(parameters, importance), []
    for k, name in enumerate(posterior.names):
        for percentile in (_PERCENTILES[0], _PERCENTILES[-1]):
            first = _find_end(posterior.draws[:, :, k], percentile / 100, posterior.ess[k])
            second = _find_end(by_importance[name], percentile / 100, importance.effective_sample_size)
            if max(first[0], second[0]) > min(first[1], second[1]):
                differing.append(name)
    return tuple(dict.fromkeys(differing))


def _find_end(draws: Floats, p: float, independent: float) -> tuple[float, float]:
    """Return between which values the quantile of `p` lies, of so many independent draws."""
    error = MONTE_CARLO_SD * math.sqrt(p * (1 - p) / independent)
    low, high = np.quantile(draws, [max(0.0, p - error), min(1.0, p + error)])
    return float(low), float(high)


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
        row |= NO_SOURCE if found is None else found.sampled_columns()
        if row["determined"] == "yes" and not (found and found.is_narrow(name)):
            held = together.get(ties.get(name, (1.0, name))[1], False)
            row |= {"determined": directions.name_determined(False, held), "condition": ""}
            row["note"] = f"its 95 % interval is {'too wide' if found else 'not known'}"
        if name in judged and row["status"] != "fixed":
            judged[name] |= found.columns() if found else profiles[name].columns()
            judged[name]["determined"] = row["determined"]
