"""What is identifiable, as rows: one per parameter, and the points of its profile."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from needlefit.inference.identifiability.agreement import Judgement, is_small, judge, unlike
from needlefit.inference.identifiability.examine import Examination, Examined
from needlefit.inference.identifiability.identify import Verdict, known_before
from needlefit.inference.identifiability.profile import THRESHOLD
from needlefit.inference.parameters import Parameters, in_logarithm
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.posterior import Posterior

Row = dict[str, Any]

IDENTIFICATION_COLUMNS = (
    *(
        "fold",
        "parameter",
        "status",
        "determined",
        "value",
        "prior_sd",
        "sd",
        "sd_low",
        "sd_high",
        "fisher_sd",
    ),
    *("sd_ratio", "sd_ratio_sampled", "interval_low", "interval_high", "end_low", "end_high"),
    *("rise", "minima", "tip_range_mm", "profile_verdict", "agreement"),
)
PROFILE_COLUMNS = ("fold", "parameter", "value", "deviance", "slope", "fisher_deviance", "threshold")


@dataclass(frozen=True)
class IdentificationRows:
    """What was found out about every parameter of one fold, before or after the fit.

    Attributes
    ----------
    judgements : mapping
        By parameter.
    rows, points : tuple of rows
        Of the frames "identification" and "profiles".
    """

    judgements: Mapping[str, Judgement]
    rows: tuple[Row, ...]
    points: tuple[Row, ...]


def identify_parameters(
    problem: Problem, examination: Examination, sds: Mapping[str, float], verdict: Verdict | None = None
) -> IdentificationRows:
    """Return what examination and deviations say together.

    Parameters
    ----------
    problem : Problem
    examination : Examination
    sds : mapping
        Standard deviations of the posterior as expected from the information, bounds and prior included.
    verdict : Verdict, optional
        Of the fit; before one, a parameter counts as determined if its sd and its profile say so.
    """
    spread = np.linalg.inv(known_before(problem)) if problem.names else np.zeros((0, 0))
    before = dict(zip(problem.names, np.sqrt(np.diag(spread)).tolist(), strict=True))
    judgements, rows, points = {}, [], []
    for one in examination.parameters:
        prior_sd = before.get(one.name, (one.bounds[1] - one.bounds[0]) / math.sqrt(12))
        alone = 1 / math.hypot(1 / one.profile.sd, 1 / prior_sd)
        sd = sds.get(one.name, alone)
        scatter = 1.0 if verdict is None else sd / alone
        judged = judge(one, (sd, prior_sd), _equal_starts_range(one, verdict), scatter)
        judgements[one.name] = judged
        if verdict is None:
            is_determined = is_small(one.name, sd, prior_sd)
        else:
            is_determined = verdict.determined.get(one.name, False)
        known = is_determined and judged.determined and one.fixed_at is None
        rows.append(_parameter_row(one, judged, prior_sd, sd) | {"determined": known})
        points += _profile_rows(problem.parameters, one)
    return IdentificationRows(judgements, tuple(rows), tuple(points))


def reconcile_verdict(verdict: Verdict, judgements: Mapping[str, Judgement]) -> Verdict:
    """Return the verdict without the parameters whose profiles contradict it, and say so in their notes."""
    denied = {n for n, one in judgements.items() if verdict.determined.get(n) and not one.determined}
    return replace(
        verdict,
        determined={n: known and n not in denied for n, known in verdict.determined.items()},
        notes={
            n: f"not determined: its profile is {judgements[n].says}" if n in denied else note
            for n, note in verdict.notes.items()
        },
    )


def add_sampled_ratios(posterior: Posterior, rows: list[Row]) -> None:
    """Write into `rows`, of one fold, what the draws say of the contraction."""
    flat = posterior.draws.reshape(-1, len(posterior.names))
    for row in rows:
        if row["parameter"] in posterior.names:
            draws = flat[:, posterior.names.index(row["parameter"])]
            draws = np.log(draws) if in_logarithm(row["parameter"]) else draws
            row["sd_ratio_sampled"] = float(np.std(draws)) / row["prior_sd"]
            row["agreement"] = unlike(row["agreement"], row["sd_ratio"], row["sd_ratio_sampled"])


def _equal_starts_range(one: Examined, verdict: Verdict | None) -> tuple[float, float] | None:
    """Return between which coordinates equally good starts ended, where there are several."""
    if verdict is None or verdict.equal_starts < 2 or one.name not in verdict.spread_low:
        return None
    ends = verdict.spread_low[one.name], verdict.spread_high[one.name]
    return (math.log(ends[0]), math.log(ends[1])) if in_logarithm(one.name) else ends


def _parameter_row(one: Examined, judged: Judgement, prior_sd: float, sd: float) -> Row:
    profile, nothing = one.profile, math.nan
    return {
        "parameter": one.name,
        "status": "free" if one.fixed_at is None else "fixed",
        "value": _to_value(one.name, profile.best) if one.fixed_at is None else one.fixed_at,
        "prior_sd": prior_sd,
        "sd": sd,
        "sd_low": nothing,
        "sd_high": nothing,
        "fisher_sd": profile.sd,
        "sd_ratio": sd / prior_sd,
        "sd_ratio_sampled": nothing,
        "interval_low": judged.interval[0],
        "interval_high": judged.interval[1],
        "end_low": profile.ends[0],
        "end_high": profile.ends[1],
        "rise": profile.rise,
        "minima": profile.minima,
        "tip_range_mm": nothing if one.tip_moves is None else one.tip_moves,
        "profile_verdict": judged.says,
        "agreement": judged.agreement,
    }


def _profile_rows(parameters: Parameters, one: Examined) -> list[Row]:
    """Return the computed points of one profile, with where all other parameters went."""
    profile = one.profile
    # a freed alpha is not among the fit's parameters: it stands under its own name, theirs keep theirs
    names = parameters.free if one.fixed_at is None else _names_with(parameters, one.name)
    return [
        {
            "parameter": one.name,
            "value": _to_value(one.name, float(profile.at[k])),
            "deviance": float(profile.deviance[k]),
            "slope": float(profile.slope[k]),
            "fisher_deviance": float(profile.parabola(profile.at[k : k + 1])[0]),
            "threshold": THRESHOLD,
            **{name: _to_value(name, float(at)) for name, at in zip(names, profile.thetas[k], strict=True)},
        }
        for k in range(len(profile.at))
    ]


def _names_with(parameters: Parameters, name: str) -> tuple[str, ...]:
    return tuple(n for n in parameters.names if n in parameters.bounds or n == name)


def _to_value(name: str, coordinate: float) -> float:
    return math.exp(coordinate) if in_logarithm(name) else coordinate
