"""The posterior of one replicate, as draws: by importance about its modes, or by the sampler."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from needlefit.inference.draws import from_posterior, of_prior
from needlefit.inference.optimize import minimize
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.sample import sample
from needlefit.inference.weighing.about_fit import modes, weighed
from needlefit.inference.weighing.importance import Weighted, resampled
from needlefit.project.records.recipe import RecipeRecord

Floats = NDArray[np.float64]
By = Literal["importance", "sampler", "prior"]

STARTS = 4
"""Of each fit; none looks at the truth."""


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
    weights : Weighted or None
        Of importance, whoever drew in the end.
    """

    thetas: Floats
    log_posterior: Floats
    mode: Floats
    by: By
    trusted: bool
    weights: Weighted | None = None


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
    recipe = way.recipe.model_copy(update={"starts": STARTS, "minimize": "posterior"})
    ends = modes(minimize(problem, recipe, rng), problem.upper - problem.lower)
    if way.sampler == "always":
        return _sampled(problem, way, ends, rng)
    found = weighed(problem, ends, rng)
    if way.sampler == "otherwise" and not found.certified:
        return _sampled(problem, way, ends, rng, found)
    chosen = resampled(found, way.draws, rng)
    thetas, density = found.thetas[chosen], found.log_density[chosen]
    return Inferred(thetas, density, ends[0], "importance", found.certified, found)


def _sampled(
    problem: Problem, way: Way, ends: Floats, rng: np.random.Generator, weights: Weighted | None = None
) -> Inferred:
    posterior = sample(problem, ends, way.recipe.sample, rng)
    thetas = from_posterior(posterior, problem.parameters, way.draws).thetas
    density = problem.log_posteriors(thetas)
    return Inferred(thetas, density, ends[0], "sampler", posterior.converged, weights)


def of_prior_alone(problem: Problem, way: Way, rng: np.random.Generator) -> Inferred:
    """Return the prior where it has a solution, as if it were the posterior."""
    thetas = np.empty((0, len(problem.names)))
    while len(thetas) < way.draws:
        drawn = of_prior(problem.parameters, way.draws, rng)
        thetas = np.concatenate([thetas, drawn[np.isfinite(problem.log_posteriors(drawn))]])
    thetas = thetas[: way.draws]
    density = problem.log_posteriors(thetas)
    return Inferred(thetas, density, thetas[int(np.argmax(density))], "prior", True)
