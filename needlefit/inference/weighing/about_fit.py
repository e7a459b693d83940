"""A fit's posterior where nothing was sampled: weighted draws about the modes that the search found."""

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from needlefit.inference.draws import Draws
from needlefit.inference.identifiability.identify import with_noise
from needlefit.inference.identifiability.settle import settle
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.evaluator import Evaluator
from needlefit.inference.sampling.laplace import laplace
from needlefit.inference.starts import Fit
from needlefit.inference.weighing.importance import Effort, Weighted, importance, resampled
from needlefit.inference.weighing.pareto import RELIABLE

Floats = NDArray[np.float64]

PLAUSIBLE = 10.0
"""A start that ended with a log density this much below the best one's found no mode."""

SAME = 1e-3
"""Ends nearer to each other than this part of the bounds are one mode."""

EFFORT = Effort()
MORE = Effort(draws=1000, components=30)
"""Where the first effort did not do: far less than sampling takes."""


def modes(fit: Fit, width: Floats) -> Floats:
    """Return the modes (M, P) that a fit found, the best first; `width` (P,) is that of the bounds."""
    starts = sorted(fit.starts, key=lambda start: (start.objective, start.index))
    plausible = [start for start in starts if start.objective <= fit.objective + PLAUSIBLE]
    return distinct((np.array(start.theta) for start in plausible), width)


def distinct(ends: Iterable[Floats], width: Floats) -> Floats:
    """Return those of some ends (P,) that differ from all before them: (M, P)."""
    found: list[Floats] = []
    for end in ends:
        if all(np.max(np.abs(end - other) / width) > SAME for other in found):
            found.append(end)
    return np.array(found)


def surely(weigh: Callable[[Effort], Weighted]) -> Weighted:
    """Return what is weighed with the first effort, or with more where its weights cannot be trusted."""
    found = weigh(EFFORT)
    return found if found.k <= RELIABLE else weigh(MORE)


def weighed(
    problem: Problem, ends: Floats, rng: np.random.Generator, jobs: int = 1, effort: Effort = EFFORT
) -> Weighted:
    """Return weighted draws of a posterior, known about its modes (M, P)."""
    evaluator = Evaluator(problem, jobs)
    about = [laplace(evaluator, end, problem.lower, problem.upper) for end in ends]
    return importance(evaluator, about, (problem.lower, problem.upper), rng, effort)


def of_fit(
    problem: Problem, fit: Fit, rng: np.random.Generator, jobs: int = 1, effort: Effort = EFFORT
) -> Weighted:
    """Return weighted draws of the posterior about a fit with at least one free parameter.

    Where the dataset states no noise, the fit's residuals stand for it; a fit of the metric objective is
    first led to the posterior's peak.
    """
    theta = np.array(fit.theta)
    known = with_noise(problem, theta)
    if fit.minimized == "posterior":
        ends = modes(fit, problem.upper - problem.lower)
    else:
        ends = settle(known, theta).theta[None]
    return weighed(known, ends, rng, jobs, effort)


def drawn_from(found: Weighted, count: int, rng: np.random.Generator) -> Draws:
    """Return `count` draws without weights; those that are not certified say so in their `faults`."""
    doubt = (
        f"draws by importance are not certified: Pareto k is {found.k:.2f} ({RELIABLE} at most), and they "
        f"are worth {found.independent:.0f} independent ones ({found.enough:.0f} at least)"
    )
    thetas = found.thetas[resampled(found, count, rng)]
    return Draws(thetas, "importance", () if found.certified else (doubt,), found.k)


def by_importance(problem: Problem, fit: Fit, count: int, rng: np.random.Generator, jobs: int = 1) -> Draws:
    """Return `count` draws of the posterior about a fit, without weights; else as `of_fit`."""
    if not len(fit.theta):
        return Draws(np.empty((count, 0)), "importance")
    return drawn_from(of_fit(problem, fit, rng, jobs), count, rng)
