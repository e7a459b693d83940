"""Decide which parameters the data determine, and which only in combination.

A parameter is called determined if the shapes could determine it (its standard deviation is below
`MAX_LOG_SD` in the logarithm, `MAX_SHAPE_SD` for shape parameters of a law, and below the part
`MAX_SD_RATIO` of the prior's), if it stays so with ties loosened and an error of the model (`conditions`), if
the starts that ended within tolerance of the best agree on it (their range is below `MAX_RANGE_SD` such
deviations), and if it does not lie at a bound.

Standard deviations and directions are those of the posterior's draws where there are any and no bound cuts
them off, else by the information. That is J^T J of the whitened residuals plus that of the stated prior or,
without one, of the bounds, 12 / width^2 (the precision of a uniform distribution): without it, an alpha free
to be 300 would take mu with it. Where the residuals are larger than the noise explains (reduced chi-square
above 1), J^T J is divided by that ratio. With five independent groups of insertions or more (repeats in one
specimen are one group), and two more than parameters, no deviation is smaller than the scatter between groups
implies (`precision.between_needle_sds`).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from needlefit.arrays import Floats
from needlefit.inference.fit import Fit, Start
from needlefit.inference.identifiability.conditions import (
    LOOSENED,
    Loosened,
    find_condition,
    find_tie_conditions,
    loosen,
)
from needlefit.inference.identifiability.information import (
    Direction,
    principal_directions,
)
from needlefit.inference.identifiability.precision import (
    MAX_LOG_SD,
    MAX_SD_RATIO,
    MAX_SHAPE_SD,
    add_estimated_noise,
    compute_sds,
    find_bounds,
    prior_information,
)
from needlefit.inference.parameters import is_logarithmic
from needlefit.inference.problem import Problem

MAX_RANGE_SD = 4.0
"""Largest range among equal starts, in these standard deviations, of a parameter called determined."""

LOG_POSTERIOR_TOLERANCE = 0.1
"""A start is within tolerance of the best if its log posterior is within this of the best one's."""

METRIC_RELATIVE_TOLERANCE, METRIC_TOLERANCE_MM = 0.01, 0.002
"""The same for the metric objective: within 1 % or 0.002 mm of the best one's."""

MIN_NAMED_WEIGHT = 0.1
"""Weight from which on a direction is named in the note of a parameter."""


@dataclass(frozen=True)
class Identifiability:
    """Which free parameters the data determine, and how well; mappings are keyed by parameter name.

    Attributes
    ----------
    sds : mapping
        Posterior standard deviation, of the logarithm (of a shape parameter itself).
    determined : mapping
        Whether the data determine it.
    at_bound : mapping
        "lower" or "upper" where the best point lies at a bound, else "".
    spread_low, spread_high : mapping
        Its range among the starts within tolerance of the best (Pa, mm).
    equal_starts : int
        How many starts these are.
    directions : tuple of Direction
        Principal directions of the information, best known first.
    notes : mapping
        One sentence for a person.
    chi_square : float
        Reduced: mean square of the whitened residuals at the best point; 1 where the noise explains them.
    noise_estimated : bool
        Whether the dataset states no noise, so that the fit's residuals had to stand for it.
    conditions : mapping
        Under which assumption alone the data determine it, "" otherwise.
    loosened : tuple of Loosened
        The standard deviations with assumptions loosened; none where nothing is determined anyway.
    """

    sds: Mapping[str, float]
    determined: Mapping[str, bool]
    at_bound: Mapping[str, str]
    spread_low: Mapping[str, float]
    spread_high: Mapping[str, float]
    equal_starts: int
    directions: tuple[Direction, ...]
    notes: Mapping[str, str]
    chi_square: float
    noise_estimated: bool
    conditions: Mapping[str, str] = field(default_factory=dict)
    loosened: tuple[Loosened, ...] = ()


def identify(problem: Problem, fit: Fit, draws: Floats | None = None) -> Identifiability:
    """Return what the data determine at the best point of a fit, given `draws` (B, P) of its posterior."""
    theta, names = np.array(fit.theta), problem.names
    noisy = add_estimated_noise(problem, theta)
    known, information, chi_square = compute_sds(noisy, theta, draws)
    sds = dict(zip(names, known.tolist(), strict=True))
    found = principal_directions(information, names, prior_information(noisy))
    ends = [s.theta for s in select_within_tolerance(fit)] or [fit.theta]
    equal = np.array(ends, dtype=np.float64).reshape(len(ends), len(names))
    bounds = dict(zip(names, find_bounds(problem, theta), strict=True))
    ranges = dict(zip(names, np.ptp(equal, axis=0).tolist(), strict=True))
    prior = problem.parameters.prior
    informed = {n: not bounds[n] and sds[n] < MAX_SD_RATIO * prior.sd(n) for n in names}
    nominally = {n: informed[n] and _is_determined(n, sds[n], ranges[n]) for n in names}
    loosened = loosen(noisy, theta, sds) if any(nominally.values()) else ()
    conditions = {n: find_condition(n, prior.sd(n), loosened) if nominally[n] else "" for n in names}
    determined = {n: nominally[n] and not conditions[n] for n in names}
    conditions |= find_tie_conditions(problem.parameters, determined, conditions, loosened)
    low, high = (problem.values(end(equal, axis=0)) for end in (np.min, np.max))
    notes = {n: _explain_undetermined(problem, theta, n, sds[n]) for n in names}
    for k, n in enumerate(names):
        if bounds[n]:
            notes[n] = f"not determined: it lies at its {bounds[n]} bound"
        elif determined[n]:
            notes[n] = f"determined, also with {LOOSENED}"
        elif conditions[n]:
            notes[n] = conditions[n]
        elif combination := _describe_combination(k, found):
            notes[n] = notes[n].replace("not determined", "not determined alone", 1) + f"; {combination}"
        notes[n] += prior.describe(n)
    return Identifiability(
        sds=sds,
        determined=determined,
        conditions=conditions,
        loosened=loosened,
        at_bound=bounds,
        spread_low={n: low[n] for n in names},
        spread_high={n: high[n] for n in names},
        equal_starts=len(equal),
        directions=found,
        notes=notes,
        chi_square=chi_square,
        noise_estimated=noisy is not problem,
    )


def select_within_tolerance(fit: Fit) -> tuple[Start, ...]:
    """Return the starts whose objective is within tolerance of the optimum."""
    return tuple(start for start in fit.starts if within_tolerance(start, fit))


def within_tolerance(start: Start, fit: Fit) -> bool:
    """Return whether the objective of a start is within tolerance of the best start's."""
    return objective_excess(start, fit) <= 1.0


def objective_excess(start: Start, fit: Fit) -> float:
    """Return the objective of a start minus the best one, in units of `objective_tolerance`."""
    return (
        (start.objective - fit.objective) / objective_tolerance(fit)
        if math.isfinite(fit.objective)
        else math.inf
    )


def objective_tolerance(fit: Fit) -> float:
    """Return the tolerance of the objective: units of the log posterior, or mm for the metric."""
    if fit.minimized == "posterior":
        return LOG_POSTERIOR_TOLERANCE
    return max(METRIC_RELATIVE_TOLERANCE * abs(fit.objective), METRIC_TOLERANCE_MM)


def tip_range(problem: Problem, theta: Floats, name: str) -> float:
    """Return the largest tip movement, mm, as one parameter alone goes through its bounds."""
    k = problem.names.index(name)
    tips = []
    for end in (problem.lower[k], problem.upper[k]):
        moved = theta.copy()
        moved[k] = end
        tips.append([s.tip_lateral if s.converged else math.nan for s in problem.shapes(moved)])
    low, high = np.array(tips)
    return float(np.max(np.abs(high - low)))


def _is_determined(name: str, sd: float, spread: float) -> bool:
    limit = MAX_LOG_SD if is_logarithmic(name) else MAX_SHAPE_SD
    return sd < limit and spread < MAX_RANGE_SD * limit


def _explain_undetermined(problem: Problem, theta: Floats, name: str, sd: float) -> str:
    """Return why a parameter is not determined."""
    if is_logarithmic(name):
        return "not determined" + (": equally good starts disagree" if sd < MAX_LOG_SD else "")
    moved = tip_range(problem, theta, name)
    low, high = problem.parameters.bounds[name]
    return (
        f"not determined: over its whole range, {low:g} to {high:g}, the tip moves by at most {moved:.2g} mm"
    )


def _describe_combination(k: int, found: tuple[Direction, ...]) -> str:
    """Return the best-known combination that the parameter k is part of, and how well it is known, if any."""
    for direction in found:
        named = abs(direction.weights[k]) >= MIN_NAMED_WEIGHT
        if named and direction.sd < MAX_LOG_SD and direction.is_informed:
            return direction.words
    return ""
