"""The posterior of one replicate, as draws: by importance about its modes, or by the sampler."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from needlefit.inference.draws import from_posterior, of_prior
from needlefit.inference.evaluator import Evaluator
from needlefit.inference.importance import Effort, importance, resampled
from needlefit.inference.laplace import laplace
from needlefit.inference.modes import modes
from needlefit.inference.problem import Problem
from needlefit.inference.sample import sample
from needlefit.inference.starts import Watch
from needlefit.project.records.recipe import RecipeRecord

Floats = NDArray[np.float64]
By = Literal["importance", "sampler", "prior"]

CANDIDATES = 256
"""Draws of the prior from the best of which the searches start."""

EFFORT = Effort()


@dataclass(frozen=True)
class Inferred:
    """What was computed of one posterior.

    Attributes
    ----------
    thetas : (L, P) array
        Draws of equal weight.
    log_posterior : (L,) array
    mode : (P,) array
    by : "importance", "sampler" or "prior"
    trusted : bool
        Whether the weights were certified, or the sampler converged.
    k, independent : float
        Of the weights, whoever drew in the end; NaN where there were none.
    evaluations : int
        Log densities asked for by importance.
    """

    thetas: Floats
    log_posterior: Floats
    mode: Floats
    by: By
    trusted: bool
    k: float = float("nan")
    independent: float = float("nan")
    evaluations: int = 0


@dataclass(frozen=True)
class Way:
    """How a posterior is inferred.

    Attributes
    ----------
    recipe : RecipeRecord
        For its search algorithm and its sampler.
    draws : int
        L.
    sampler : "always", "otherwise" or "never"
        Whether the sampler draws: instead of importance, or where its weights are not certified.
    """

    recipe: RecipeRecord
    draws: int
    sampler: Literal["always", "otherwise", "never"] = "otherwise"


def inferred(problem: Problem, way: Way, rng: np.random.Generator) -> Inferred:
    """Return the posterior of a problem; nothing of it is known before."""
    evaluator = Evaluator(problem, 1)
    candidates = of_prior(problem.parameters, CANDIDATES, rng)
    ends = modes(problem, way.recipe, candidates)
    if not len(ends):
        ends = candidates[[int(np.argmax(evaluator(candidates)))]]
    if way.sampler == "always":
        return _sampled(problem, way, ends, rng)
    about = [laplace(evaluator, end, problem.lower, problem.upper) for end in ends]
    found = importance(evaluator, about, (problem.lower, problem.upper), rng, EFFORT)
    weights = {"k": found.k, "independent": found.independent, "evaluations": len(found.thetas)}
    if way.sampler == "otherwise" and not found.certified:
        return _sampled(problem, way, ends, rng, **weights)
    chosen = resampled(found, way.draws, rng)
    thetas, density = found.thetas[chosen], found.log_density[chosen]
    return Inferred(thetas, density, ends[0], "importance", found.certified, **weights)


def _sampled(
    problem: Problem, way: Way, ends: Floats, rng: np.random.Generator, **weights: float
) -> Inferred:
    posterior = sample(problem, ends, way.recipe.sample, rng, Watch())
    thetas = from_posterior(posterior, problem.parameters, way.draws).thetas
    density = problem.log_posteriors(thetas)
    return Inferred(thetas, density, ends[0], "sampler", posterior.converged, **weights)


def of_prior_alone(problem: Problem, way: Way, rng: np.random.Generator) -> Inferred:
    """Return the prior where it has a solution, as if it were the posterior."""
    thetas = np.empty((0, len(problem.names)))
    while len(thetas) < way.draws:
        drawn = of_prior(problem.parameters, way.draws, rng)
        thetas = np.concatenate([thetas, drawn[np.isfinite(problem.log_posteriors(drawn))]])
    thetas = thetas[: way.draws]
    density = problem.log_posteriors(thetas)
    return Inferred(thetas, density, thetas[int(np.argmax(density))], "prior", True)
