"""Decide which parameters the data determine, and which only in combination.

A parameter is called determined if the shapes could determine it (its Cramer-Rao standard deviation is
below `MAX_LOG_SD` in the logarithm, `MAX_ALPHA_SD` for alpha; where a prior is stated, below the part
`MAX_SD_RATIO` of the prior's too), if the starts that ended practically as well as
the best agree on it (their range is below `MAX_RANGE_SD` such deviations), and if it does not lie at a bound.

The information is J^T J of the whitened residuals plus that of the stated prior or, without one, of the
bounds, 12 / width^2 (the precision of a uniform distribution): without it, an alpha free to be 300 would
take mu with it. Where the residuals are larger than the noise explains (reduced chi-square above 1),
J^T J is divided by that ratio; and where there are needles enough, no deviation is smaller than their
scatter implies. Even so they hold only as far as the model does.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.select import MIN_GROUPS, group_independent
from needlefit.inference.fit import Fit, Start
from needlefit.inference.identifiability.information import (
    Direction,
    cramer_rao,
    describe_precision,
    principal_directions,
)
from needlefit.inference.parameters import is_logarithmic
from needlefit.inference.problem import Problem
from needlefit.inference.ties import NOISE_SCALE

Floats = NDArray[np.float64]

MAX_LOG_SD, MAX_ALPHA_SD = 0.3, 0.5
"""Largest standard deviations, of a logarithm and of alpha, of a parameter called determined."""

MAX_SD_RATIO = 0.5
"""Largest part of its prior's standard deviation of a parameter that the shapes, not the prior, determine."""

MAX_RANGE_SD = 4.0
"""Largest range among equal starts, in these standard deviations, of a parameter called determined."""

LOG_POSTERIOR_TOLERANCE = 0.1
"""A start is practically as good as the best if its log posterior is within this of the best one's."""

METRIC_RELATIVE_TOLERANCE, METRIC_TOLERANCE_MM = 0.01, 0.002
"""The same for the metric objective: within 1 % or 0.002 mm of the best one's."""

BOUND_FRACTION = 1e-3
"""A parameter closer to a bound than this part of its range lies at it."""

MIN_NAMED_WEIGHT = 0.1
"""Weight from which on a direction is named in the note of a parameter."""


@dataclass(frozen=True)
class Identifiability:
    """Which free parameters the data determine, and how well; mappings are keyed by parameter name.

    Attributes
    ----------
    sds : mapping
        Cramer-Rao standard deviation, of the logarithm (of alpha itself for alpha).
    determined : mapping
        Whether the data determine it.
    at_bound : mapping
        "lower" or "upper" where the best point lies at a bound, else "".
    spread_low, spread_high : mapping
        Its range among the starts practically as good as the best (Pa, mm).
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


def identify(problem: Problem, fit: Fit) -> Identifiability:
    """Return what the data determine at the best point of a fit."""
    theta, names = np.array(fit.theta), problem.names
    noisy = add_estimated_noise(problem, theta)
    residuals, slope, chi_square = linearize(noisy, theta)
    prior_part = prior_and_noise_information(noisy)
    # a chi-square above 1 means that the noise is understated; one below 1 is not taken as extra precision
    information = slope.T @ slope / max(1.0, chi_square) + prior_part
    between = between_needle_sds(noisy, slope, residuals, slope.T @ slope + prior_part)
    sds = dict(zip(names, np.maximum(cramer_rao(information), between).tolist(), strict=True))
    found = principal_directions(information, names)
    ends = [s.theta for s in select_within_tolerance(fit)] or [fit.theta]
    equal = np.array(ends, dtype=np.float64).reshape(len(ends), len(names))
    bounds = dict(zip(names, _find_bounds(problem, theta), strict=True))
    ranges = dict(zip(names, np.ptp(equal, axis=0).tolist(), strict=True))
    prior = problem.parameters.prior
    informed = {n: not bounds[n] and sds[n] < MAX_SD_RATIO * prior.sd(n) for n in names}
    determined = {n: informed[n] and _is_determined(n, sds[n], ranges[n]) for n in names}
    low, high = (problem.values(end(equal, axis=0)) for end in (np.min, np.max))
    notes = {n: _explain_undetermined(problem, theta, n, sds[n]) for n in names}
    for k, n in enumerate(names):
        if bounds[n]:
            notes[n] = f"at its {bounds[n]} bound: the data say no more than this"
        elif determined[n]:
            notes[n] = f"determined {describe_precision(sds[n], is_logarithmic(n))}"
        else:
            notes[n] += _describe_combination(k, found)
        notes[n] += prior.describe(n)
    return Identifiability(
        sds=sds,
        determined=determined,
        at_bound=bounds,
        spread_low={n: low[n] for n in names},
        spread_high={n: high[n] for n in names},
        equal_starts=len(equal),
        directions=found,
        notes=notes,
        chi_square=chi_square,
        noise_estimated=noisy is not problem,
    )


def between_needle_sds(problem: Problem, slope: Floats, residuals: Floats, information: Floats) -> Floats:
    """Return the standard deviations (P,) of theta that the scatter between needles implies.

    The sandwich estimate over independent groups: each one's pull J^T r on theta, about their mean (the fit
    minimises another objective, so the pulls need not sum to 0). Where the model misses something that
    varies from needle to needle, this is larger than what the noise within needles says. 0 where there are
    too few groups for it.
    """
    ends = np.cumsum(problem.density.residual_counts)[:-1]
    parts = zip(np.split(slope, ends), np.split(residuals, ends), strict=True)
    ids, specimens = zip(*((i.id, i.specimen) for i in problem.insertions), strict=True)
    scores: dict[str, Floats] = {}
    for group, (j, r) in zip(group_independent(ids, specimens), parts, strict=True):
        scores[group] = scores.get(group, np.zeros(j.shape[1])) + j.T @ r
    n = len(scores)
    # the scatter of n groups has rank n - 1 at most: fewer groups than parameters would underestimate it
    if n < max(MIN_GROUPS, len(problem.names) + 2) or not problem.names:
        return np.zeros(len(problem.names))
    scatter = np.array(list(scores.values()))  # (n, P)
    scatter = scatter - scatter.mean(axis=0)
    inverse = np.linalg.inv(information)
    # the sandwich: bread is the inverse information, the filling the scatter of the groups' scores
    covariance = n / (n - 1) * inverse @ (scatter.T @ scatter) @ inverse
    sd: Floats = np.sqrt(np.diag(covariance))
    return sd


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


def add_estimated_noise(problem: Problem, theta: Floats) -> Problem:
    """Return the problem with a noise model: the stated one, or else the rms residual at `theta`."""
    stated = problem.dataset.noise if problem.noise is None else problem.noise
    if stated.stated:
        return problem
    squares = [np.mean((sim - measured)[:, 1] ** 2) for sim, measured in problem.points(theta)]
    # 1e-6 mm: a fit without residuals must not give a noise of 0
    rms = max(math.sqrt(float(np.mean(squares))), 1e-6)
    return replace(problem, noise=replace(stated, point_sd=rms))


def tip_range(problem: Problem, theta: Floats, name: str) -> float:
    """Return the largest tip movement, mm, as one parameter goes through its bounds and the others are
    held.
    """
    k = problem.names.index(name)
    tips = []
    for end in (problem.lower[k], problem.upper[k]):
        moved = theta.copy()
        moved[k] = end
        tips.append([s.deflection if s.converged else math.nan for s in problem.shapes(moved)])
    low, high = np.array(tips)
    return float(np.max(np.abs(high - low)))


def linearize(problem: Problem, theta: Floats) -> tuple[Floats, Floats, float]:
    """Return the linearised observations: residuals (R,), derivatives (R, P), reduced chi-square."""
    # residuals of the observations come first; the normalising one and the prior's follow, and the prior is
    # added by `prior_information`
    count = sum(problem.density.residual_counts)
    residuals, slope = (np.nan_to_num(part[:count]) for part in problem.jacobian(theta))
    # what a scale of the noise does to residuals is no information on the other parameters, on average
    slope = slope * (np.array(problem.names, dtype=object) != NOISE_SCALE)
    rows = sum(known.rows for known in problem.density.observations)
    return residuals, slope, float(residuals @ residuals) / max(1, rows - len(problem.names))


def prior_information(problem: Problem) -> Floats:
    """Return the information (P, P) of the stated prior; parameters without one get that of their bounds."""
    stated = problem.parameters.prior
    flat = np.array([name not in stated.names for name in problem.names])
    # 12 / width^2 is the precision of a uniform distribution of this width
    bounds: Floats = np.diag(np.where(flat, 12.0 / (problem.upper - problem.lower) ** 2, 0.0))
    known: Floats = bounds + stated.information(problem.names)
    return known


def prior_and_noise_information(problem: Problem) -> Floats:
    """Return `prior_information` plus the information that the residuals hold on the noise scale."""
    rows = sum(known.rows for known in problem.density.observations)  # Fisher: 2 of each, of the logarithm
    known: Floats = prior_information(problem) + np.diag(
        [2.0 * rows * (n == NOISE_SCALE) for n in problem.names]
    )
    return known


def _is_determined(name: str, sd: float, spread: float) -> bool:
    limit = MAX_LOG_SD if is_logarithmic(name) else MAX_ALPHA_SD
    return sd < limit and spread < MAX_RANGE_SD * limit


def _find_bounds(problem: Problem, theta: Floats) -> list[str]:
    place = (theta - problem.lower) / (problem.upper - problem.lower)
    return ["lower" if p < BOUND_FRACTION else "upper" if p > 1 - BOUND_FRACTION else "" for p in place]


def _explain_undetermined(problem: Problem, theta: Floats, name: str, sd: float) -> str:
    """Return why a parameter is not determined."""
    if is_logarithmic(name):
        disagree = ", but equally good starts disagree" if sd < MAX_LOG_SD else ""
        return f"not determined (known {describe_precision(sd, True)}{disagree})"
    moved = tip_range(problem, theta, name)
    low, high = problem.parameters.bounds[name]
    return (
        f"not determined: going through its whole range, {low:g} to {high:g}, it moves no tip by more "
        f"than {moved:.2g} mm"
    )


def _describe_combination(k: int, found: tuple[Direction, ...]) -> str:
    """Return in which best-known combination the parameter k is known, if it is known in any."""
    for direction in found:
        if abs(direction.weights[k]) >= MIN_NAMED_WEIGHT and direction.sd < MAX_LOG_SD:
            return f"; only a combination is: {direction.words}"
    return ""
