"""Fit to some insertions, and draw from the posterior: by importance sampling, or by MCMC if that fails.

The posterior is sampled by importance about the modes that the search found (`inference.sampling`). Where
Pareto's k shows that the weights cannot be trusted this is repeated with more draws, and MCMC runs only where
that fails too: it costs a hundred times as much.
"""

from dataclasses import dataclass

import numpy as np

from needlefit.inference.fit import Callbacks, Fit
from needlefit.inference.identifiability.precision import add_estimated_noise
from needlefit.inference.optimize import minimize
from needlefit.inference.predict import Draws, thin_posterior
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.importance import WeightedDraws, resample_draws, sample_about_fit
from needlefit.inference.sampling.posterior import Posterior
from needlefit.inference.sampling.sample import sample_from_fit
from needlefit.project.random_streams import random_stream
from needlefit.studies.job import Job, Settings

PREDICTION_DRAWS = 1000  #: parameter sets of which a needle is predicted


@dataclass(frozen=True)
class PosteriorFit:
    """A fit and draws of its posterior; Pareto's k of the weights, NaN where nothing is free, and whether it
    was sampled.
    """

    fit: Fit
    draws: Draws
    k: float
    sampled: bool = False


def fit_posterior(
    job: Job, problem: Problem, key: tuple[str, ...], settings: Settings, draws: int = PREDICTION_DRAWS
) -> PosteriorFit:
    """Fit the free parameters of a problem, and draw from their posterior, by the recipe of the job.

    Raises FitError if the search finds no point that can be solved.

    Parameters
    ----------
    job : Job
        For its recipe, seed and name.
    problem : Problem
        Of the job's kind; other insertions or priors than its folds' are welcome.
    key : tuple of str
        What this is, among all that is learned in the job: it keys the random streams.
    settings : Settings
        For `jobs` and `stop`; after a stop the answer means nothing.
    draws : int
        How many; their `faults` say so if they are not certified, nor the sampler converged.
    """
    fit = find_fit(job, problem, key, settings)
    if not len(fit.theta) or settings.stop():
        return PosteriorFit(fit, Draws(np.empty((draws, len(fit.theta))), "importance"), float("nan"))
    rng = random_stream(job.recipe.seed, job.name, *key, "weighed")
    found, posterior = weigh_or_sample(job, problem, fit, rng, key, settings)
    if found.certified:
        return PosteriorFit(fit, resample_draws(found, draws, rng), found.k)
    nothing = Draws(np.empty((0, len(fit.theta))), "posterior")
    drawn = nothing if posterior is None else thin_posterior(posterior, problem.parameters, draws, found.k)
    return PosteriorFit(fit, drawn, found.k, sampled=True)


def weigh_or_sample(
    job: Job, problem: Problem, fit: Fit, rng: np.random.Generator, key: tuple[str, ...], settings: Settings
) -> tuple[WeightedDraws, Posterior | None]:
    """Return weighted draws about a fit, and where they are not certified the posterior by MCMC.

    That is None too after a stop before there is any.
    """
    found = sample_about_fit(problem, fit, rng, settings.jobs, pool=settings.part_pool)
    if found.certified or settings.stop():
        return found, None
    return found, sample_posterior(job, problem, fit, key, settings)


def find_fit(job: Job, problem: Problem, key: tuple[str, ...], settings: Settings) -> Fit:
    """Return the fit alone, by the recipe of the job; arguments and errors as of `fit_posterior`."""
    callbacks = Callbacks(stop=settings.stop, jobs=settings.jobs, pool=settings.part_pool)
    return minimize(problem, job.recipe, random_stream(job.recipe.seed, job.name, *key, "starts"), callbacks)


def sample_posterior(
    job: Job, problem: Problem, fit: Fit, key: tuple[str, ...], settings: Settings
) -> Posterior | None:
    """Return the posterior by MCMC from all equally good starts; None after a stop before there is any."""
    known = add_estimated_noise(problem, np.array(fit.theta))
    rng = random_stream(job.recipe.seed, *key, "posterior")
    callbacks = Callbacks(stop=settings.stop, jobs=settings.jobs)
    return sample_from_fit(known, fit, job.recipe.sample, rng, callbacks)
