"""Tabulate what is identifiable: one row per parameter, and the points of its profile."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from needlefit.inference.identifiability.identify import (
    AGREEMENT,
    Assessment,
    FitProfiles,
    Identifiability,
    ParameterProfile,
    assess_parameter,
)
from needlefit.inference.identifiability.precision import (
    Loosened,
    find_condition,
    is_determined_by_data,
    prior_information,
)
from needlefit.inference.identifiability.profile import DEVIANCE_95
from needlefit.inference.parameters import Parameters, is_logarithmic, to_value
from needlefit.inference.problem import Problem

Row = dict[str, Any]

IDENTIFICATION_COLUMNS = (
    "fold", "parameter", "status", "determined", "note", "value", "prior_sd", "sd", "sd_low", "sd_high",
    "fisher_sd", "sd_ratio", "low", "high", "end_low", "end_high", "interval_low", "interval_high",
    "draw_source", "bound_low", "bound_high", "rise", "minima", "tip_range_mm", "profile_verdict",
    "agreement",
)  # fmt: skip
PROFILE_COLUMNS = ("fold", "parameter", "value", "deviance", "slope", "fisher_deviance", "threshold")


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
    loosened: Sequence[Loosened] = (),
) -> IdentificationRows:
    """Return what profiles and standard deviations together say about every parameter.

    Parameters
    ----------
    sds : mapping
        Standard deviations of the posterior as expected from the information, bounds and prior included.
    verdict : Verdict, optional
        Of the fit; before one, a parameter counts as determined if its sd and its profile say so.
    loosened : sequence of Loosened
        With assumptions loosened: it must stay so.
    """
    spread = np.linalg.inv(prior_information(problem)) if problem.names else np.zeros((0, 0))
    before = dict(zip(problem.names, np.sqrt(np.diag(spread)).tolist(), strict=True))
    judgements, rows, points = {}, [], []
    for one in examination.parameters:
        prior_sd = before.get(one.name, (one.bounds[1] - one.bounds[0]) / math.sqrt(12))
        sd = sds.get(one.name, 1 / math.hypot(1 / one.profile.sd, 1 / prior_sd))
        judged = assess_parameter(one, (sd, prior_sd), _equal_starts_range(one, verdict))
        judgements[one.name] = judged
        condition = ""
        if verdict is None:
            is_determined = is_determined_by_data(one.name, sd, prior_sd)
            if is_determined and one.fixed_at is None:
                condition = find_condition(one.name, prior_sd, loosened)
        else:
            is_determined = verdict.determined.get(one.name, False)
            condition = verdict.conditions.get(one.name, "")
        known = is_determined and not condition and judged.determined and one.fixed_at is None
        rows.append(_parameter_row(one, judged, prior_sd, sd) | {"determined": known, "note": condition})
        points += _profile_rows(problem.parameters, one)
    return IdentificationRows(judgements, tuple(rows), tuple(points))


def reconcile_verdict(verdict: Identifiability, judgements: Mapping[str, Assessment]) -> Identifiability:
    """Return the verdict without the parameters whose profiles contradict it.

    Notes state that, and of determined parameters where profile and standard deviation differ.
    """
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


def _equal_starts_range(one: ParameterProfile, verdict: Identifiability | None) -> tuple[float, float] | None:
    """Return between which coordinates equally good starts ended, where there are several."""
    if verdict is None or verdict.equal_starts < 2 or one.name not in verdict.spread_low:
        return None
    ends = verdict.spread_low[one.name], verdict.spread_high[one.name]
    return (math.log(ends[0]), math.log(ends[1])) if is_logarithmic(one.name) else ends


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
