"""Sample the posterior about a fit by importance sampling, and compute the predictive density of further
data.

How probable further data y are, after data D: the evidence of both over that of the first.

    log p(y | D) = log Z(D, y) - log Z(D),      Z = integral of likelihood and prior over theta

The mean of p(y | theta) over draws of the posterior of D is the same, but where y has many exact points it is
decided by the one draw that comes nearest: too low at most times, and its own scatter does not tell. The two
integrals are by importance, each about its own peaks (C. P. Robert, D. Wraith, AIP Conf. Proc. 1193 (2009)
251), so that draws are where the integrand is.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

import numpy as np

from needlefit.arrays import Floats
from needlefit.inference.draws import Draws
from needlefit.inference.fit import Fit
from needlefit.inference.identifiability.gauss_newton import LocalMinimum, minimize_squares
from needlefit.inference.identifiability.precision import add_estimated_noise
from needlefit.inference.identifiability.profile_path import ProfileSteps, trace_profile
from needlefit.inference.importance.pareto import MAX_PARETO_K
from needlefit.inference.importance.sampler import Effort, WeightedDraws, resample, sample_by_importance
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.log_density import (
    Evaluator,
    approximate_by_information,
    approximate_by_laplace,
)
from needlefit.inference.side_by_side import run_side_by_side
from needlefit.project.progress import never_stop
from needlefit.project.tasks import THIS_PROCESS, TaskPool, TaskStop

MAX_LOG_DENSITY_GAP = 10.0
"""A start that ended with a log density this much below the best one's found no mode."""

MIN_MODE_DISTANCE = 1e-3
"""Ends nearer to each other than this part of the bounds are one mode."""

PROFILE_STEPS = ProfileSteps(stop_deviance=14.0, root_rise=1.2, min_gain=0.05)
"""Profiles along which draws begin: coarse ones, down to densities of a thousandth of the peak's."""

EFFORT = Effort()
LARGER_EFFORT = Effort(draws=1000, components=30)
"""Effort of the second attempt; still far less than MCMC needs."""


def find_modes(fit: Fit, width: Floats) -> Floats:
    """Return the distinct modes (M, P) that a fit found, the best first; `width` (P,) of the bounds."""
    starts = sorted(fit.starts, key=lambda start: (start.objective, start.index))
    plausible = [start for start in starts if start.objective <= fit.objective + MAX_LOG_DENSITY_GAP]
    return select_distinct((np.array(start.theta) for start in plausible), width)


def select_distinct(ends: Iterable[Floats], width: Floats) -> Floats:
    """Return the points (P,) that differ from all before them: (M, P)."""
    found: list[Floats] = []
    for end in ends:
        if all(np.max(np.abs(end - other) / width) > MIN_MODE_DISTANCE for other in found):
            found.append(end)
    return np.array(found)


def escalate_effort(sample: Callable[[Effort], WeightedDraws]) -> WeightedDraws:
    """Sample with the small effort, and again with the large one if the weights cannot be trusted."""
    found = sample(EFFORT)
    return found if found.certified else sample(LARGER_EFFORT)


def sample_about_modes(
    problem: Problem,
    ends: Floats,
    rng: np.random.Generator,
    jobs: int = 1,
    effort: Effort = EFFORT,
    pool: TaskPool = THIS_PROCESS,
) -> WeightedDraws:
    """Return weighted draws of a posterior whose modes (M, P), the best first, are known."""
    evaluator, bounds = Evaluator(problem, jobs), (problem.lower, problem.upper)
    approximations = [approximate_by_laplace(evaluator, end, *bounds) for end in ends]
    if effort.profiles:
        points = trace_profiles(problem, ends[0], jobs, pool)
        approximations += [approximate_by_information(one.information, one.theta, *bounds) for one in points]
    return sample_by_importance(evaluator, approximations, bounds, rng, effort)


def trace_profiles(
    problem: Problem, mode: Floats, jobs: int = 1, pool: TaskPool = THIS_PROCESS
) -> list[LocalMinimum]:
    """Return points along the profiles, about a mode (P,), of parameters neither tied nor a spread.

    A plateau beside the peak, where the data no longer tell a layer from none, may hold a tenth of the
    posterior and end far from the peak. A mixture that grows from the peak alone may never reach it, and the
    weights do not show it.
    """
    stated = {tie.name for tie in problem.parameters.prior.ties} | set(problem.parameters.half_normal)
    optimum = minimize_squares(problem, mode)
    traced = [k for k, name in enumerate(problem.names) if name not in stated]
    work, stop = partial(_trace_one, problem, optimum), TaskStop(never_stop)
    found = dict(run_side_by_side(work, traced, pool, jobs, stop))
    points = [one for n in range(len(traced)) for one in found[n]]
    return [one for one in points if one.value - optimum.value <= 2 * MAX_LOG_DENSITY_GAP]


def _trace_one(problem: Problem, optimum: LocalMinimum, k: int) -> list[LocalMinimum]:
    """Return the points of one profile without its optimum."""
    return trace_profile(problem, k, optimum, steps=PROFILE_STEPS).points[1:]


def sample_about_minimum(
    problem: Problem, minimum: LocalMinimum, rng: np.random.Generator, effort: Effort
) -> WeightedDraws:
    """Return weighted draws of a posterior about its mode, where a search by Gauss-Newton has ended."""
    bounds = (problem.lower, problem.upper)
    approximation = approximate_by_information(minimum.information, minimum.theta, *bounds)
    return sample_by_importance(Evaluator(problem, 1), [approximation], bounds, rng, effort)


def sample_about_fit(
    problem: Problem,
    fit: Fit,
    rng: np.random.Generator,
    jobs: int = 1,
    effort: Effort = EFFORT,
    pool: TaskPool = THIS_PROCESS,
) -> WeightedDraws:
    """Return weighted draws of the posterior about a fit with at least one free parameter.

    Where the dataset states no noise, the fit's residuals stand for it; a fit of the metric objective is
    first led to the posterior's peak.
    """
    theta = np.array(fit.theta)
    known = add_estimated_noise(problem, theta)
    if fit.minimized == "posterior":
        ends = find_modes(fit, problem.upper - problem.lower)
    else:
        # the minimum of the metric is no mode of the posterior
        ends = minimize_squares(known, theta).theta[None]
    return sample_about_modes(known, ends, rng, jobs, effort, pool)


def resample_draws(found: WeightedDraws, count: int, rng: np.random.Generator) -> Draws:
    """Return `count` unweighted draws; their `faults` say so if the weights are not certified."""
    warning = (
        f"draws by importance are not certified: Pareto k is {found.k:.2f} ({MAX_PARETO_K} at most), and "
        f"they "
        f"are worth {found.effective_sample_size:.0f} independent ones ({found.min_ess:.0f} at least)"
    )
    thetas = found.thetas[resample(found, count, rng)]
    faults = () if found.certified else (warning,)
    return Draws(thetas, "importance", faults, found.k, found.effective_sample_size)


@dataclass(frozen=True)
class PredictiveDensity:
    """The predictive density of further data, with its Monte Carlo error.

    Attributes
    ----------
    log_density : float
        log p(y | D).
    se : float
        Its Monte Carlo error.
    shared_se : float
        The part of it that comes from Z(D), and is the same error for all that is asked after D.
    k : float
        Pareto's: the larger of the two integrals'.
    effective_sample_size : float
        Effective number of independent draws: the fewer of the two integrals'.
    """

    log_density: float
    se: float
    shared_se: float
    k: float
    effective_sample_size: float


ZERO_DENSITY = PredictiveDensity(-math.inf, math.inf, math.inf, math.nan, 0.0)
"""Density of data that cannot be predicted."""


def compute_predictive_density(both: WeightedDraws, first: WeightedDraws) -> PredictiveDensity:
    """Return the predictive density of further data, from weighted draws given all data and given the first.

    The two densities must be normalised alike: what the further data add is their likelihood, in full.
    """
    return PredictiveDensity(
        both.log_evidence - first.log_evidence,
        math.hypot(both.log_evidence_se, first.log_evidence_se),
        first.log_evidence_se,
        max(both.k, first.k),
        min(both.effective_sample_size, first.effective_sample_size),
    )
