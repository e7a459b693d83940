"""Fit to some insertions, and draw from the posterior: by importance sampling, or by MCMC if that fails.

The posterior is sampled by importance about the modes that the search found (`inference.importance`). Where
Pareto's k shows that the weights cannot be trusted this is repeated with more draws, and MCMC runs only where
that fails too: it costs a hundred times as much.
"""

from dataclasses import dataclass

import numpy as np

from needlefit.errors import FitError
from needlefit.inference.draws import Draws, thin_posterior
from needlefit.inference.fit import Callbacks, Fit
from needlefit.inference.identifiability.identify import add_estimated_noise, select_within_tolerance
from needlefit.inference.importance.fit_posterior import escalate_effort, resample_draws, sample_about_fit
from needlefit.inference.importance.pareto import MAX_PARETO_K
from needlefit.inference.optimize import minimize
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.sample import sample
from needlefit.project.random_streams import random_stream
from needlefit.validation.job import Job, Settings

POSTERIOR_DRAWS = 100
"""Parameter sets that stand for a posterior."""


@dataclass(frozen=True)
class PosteriorFit:
    """A fit and `POSTERIOR_DRAWS` draws of its posterior; Pareto's k of the weights, and whether it was
    sampled.

    `k` is NaN where nothing is free.
    """

    fit: Fit
    draws: Draws
    k: float
    sampled: bool = False


def fit_posterior(job: Job, problem: Problem, key: tuple[str, ...], settings: Settings) -> PosteriorFit:
    """Fit the free parameters of a problem, and draw from their posterior, by the recipe of the job.

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

    Raises
    ------
    FitError
        If the search finds no point that can be solved.
    """
    fit = find_fit(job, problem, key, settings)
    if not len(fit.theta) or settings.stop():
        return PosteriorFit(
            fit, Draws(np.empty((POSTERIOR_DRAWS, len(fit.theta))), "importance"), float("nan")
        )
    rng = random_stream(job.recipe.seed, job.name, *key, "weighed")
    found = escalate_effort(lambda effort: sample_about_fit(problem, fit, rng, settings.jobs, effort))
    if found.k <= MAX_PARETO_K:
        return PosteriorFit(fit, resample_draws(found, POSTERIOR_DRAWS, rng), found.k)
    return PosteriorFit(fit, _sample_posterior(job, problem, fit, key, settings), found.k, sampled=True)


def find_fit(job: Job, problem: Problem, key: tuple[str, ...], settings: Settings) -> Fit:
    """Return the fit alone, by the recipe of the job; arguments and errors as of `fit_posterior`."""
    callbacks = Callbacks(stop=settings.stop, jobs=settings.jobs)
    return minimize(problem, job.recipe, random_stream(job.recipe.seed, job.name, *key, "starts"), callbacks)


def _sample_posterior(
    job: Job, problem: Problem, fit: Fit, key: tuple[str, ...], settings: Settings
) -> Draws:
    known = add_estimated_noise(problem, np.array(fit.theta))
    ends = [fit.theta, *(start.theta for start in select_within_tolerance(fit) if start.theta != fit.theta)]
    rng = random_stream(job.recipe.seed, job.name, *key, "posterior")
    callbacks = Callbacks(stop=settings.stop, jobs=settings.jobs)
    try:
        posterior = sample(known, np.array(ends), job.recipe.sample, rng, callbacks)
    except FitError:
        if settings.stop():  # before there was anything to return
            return Draws(np.empty((0, len(fit.theta))), "posterior")
        raise
    return thin_posterior(posterior, problem.parameters, POSTERIOR_DRAWS)
