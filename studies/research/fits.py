"""Fits without a run: errors of all methods, the evidence of a tissue model, draws of a posterior."""

from dataclasses import replace
from itertools import product

import numpy as np
import pandas as pd

from needlefit.datasets.insertion import Dataset
from needlefit.inference.draws import Draws, thin_posterior
from needlefit.inference.fit import Callbacks
from needlefit.inference.optimize import minimize
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.importance import resample_draws, sample_about_fit
from needlefit.inference.sampling.sample import sample
from needlefit.project.processes import count_cores
from needlefit.project.random_streams import random_stream
from needlefit.studies.from_memory import (
    Medium,
    Name,
    Recipe,
    Table,
    change_stated_fit,
    open_fit,
    open_study,
    prepare_job,
    read_recipe,
    replace_inputs,
)
from needlefit.studies.score import make_predictors, make_scorer


def score_study(
    study: Name | Table,
    *,
    dataset: Name | Dataset | None = None,
    medium: Medium | None = None,
    recipe: Recipe | None = None,
    jobs: int | None = None,
) -> pd.DataFrame:
    """Fit a study, and return the errors of every method on every insertion.

    Intervals, predictions and the error-minimising fit of `needlefit.validate` are left out: seconds instead
    of a minute. Layers are where the needle was measured to cross them, as in the paper's tables.

    Parameters
    ----------
    study, dataset, medium, recipe, jobs
        As of `needlefit.validate`; the dataset may be changed in memory.

    Returns
    -------
    DataFrame
        One row per insertion and method: `fold`, `role` ("tune" or "validate"), `insertion`, `medium`,
        `specimen`, `layers`, `depth_mm`, `method`, `converged`, and a column for each metric, mm or percent,
        and for its noise floor, `floor_<metric>`.

    Raises
    ------
    ConfigError, DataError, FitError
        As of `needlefit.validate`.
    """
    changed = replace_inputs(open_study(study), dataset, medium, recipe, stored=False)
    job, jobs = prepare_job(changed, None, jobs)
    scorer, rows = make_scorer(job), []
    for fold in job.folds:
        problem = job.problem(fold)
        fits = {
            search: minimize(
                job.problem(fold, search),
                job.recipe_of(search),
                job.random(fold.name, search, "starts"),
                Callbacks(jobs=jobs),
            )
            for search in job.searches
            if search != "fitted_metric"
        }
        methods = make_predictors(problem, fits, job.hand_tuned)
        for role, insertions in (("tune", fold.tune), ("validate", fold.validate)):
            for insertion, (method, curves) in product(insertions, methods.items()):
                place = {"fold": fold.name, "role": role, "method": method}
                rows += scorer.score(place, replace(insertion, surfaces=()), curves)["errors"]
    return pd.DataFrame(rows).drop(columns=["boundaries", "comparison"])


def estimate_evidence(target: Name | Dataset, medium: Medium | None = None, **changes: object) -> pd.Series:
    """Return the evidence of a tissue model: the probability density of the data, over all its parameters.

    The log density of insertions B predicted from insertions A is the evidence of both, less that of A. The
    integral is by importance sampling about the modes of the fit. The prior is not normalised: evidences of
    models with other parameters or bounds cannot be compared; `needlefit.estimate_elpd` compares them.

    Parameters
    ----------
    target, medium, tune, recipe, priors, free, fix
        As of `needlefit.fit`; the dataset states its noise, and may have no files.

    Returns
    -------
    Series
        `log_evidence` (of lengths in mm), its Monte Carlo error `se`, Pareto's `k` of the weights (above
        0.7 the estimate is not reliable) and their effective sample size `ess`.
    """
    job, jobs = prepare_job(change_stated_fit(open_fit(target, medium, stored=False), **changes), None, None)
    problem, rng = job.problem(job.folds[0]), job.random("evidence")
    results = sample_about_fit(problem, minimize(problem, job.recipe, rng, Callbacks(jobs=jobs)), rng, jobs)
    values = (results.log_evidence, results.log_evidence_se, results.k, results.effective_sample_size)
    return pd.Series(values, index=["log_evidence", "se", "k", "ess"])


def draw_posterior(problem: Problem, count: int, seed: int, recipe: Recipe = "default") -> Draws:
    """Fit a problem whose dataset states its noise, and draw from its posterior.

    Draws are by importance sampling, and by MCMC from these where their weights are not reliable.

    Parameters
    ----------
    problem : Problem
        As from `needlefit.api.make_problem`.
    count : int
        Number of draws.
    seed : int
        Of all random numbers.
    recipe : str, Path, RecipeRecord or table
        How to search and sample; a table changes keys of the recipe `default`.

    Returns
    -------
    Draws
        `thetas` (count, P), the `mode` (P,), and `faults`, empty if the draws are reliable.
        `problem.values(theta)` are a draw's values in Pa and mm.
    """
    chosen, _ = read_recipe(recipe)
    rng, callbacks = random_stream(seed, "posterior"), Callbacks(jobs=count_cores())
    fit = minimize(problem, chosen.model_copy(update={"minimize": "posterior"}), rng, callbacks)
    posterior = sample_about_fit(problem, fit, rng, callbacks.jobs)
    draws = resample_draws(posterior, count, rng)
    if not posterior.certified:
        chains = sample(problem.holding(fit.held), posterior, chosen.sample, rng, callbacks)
        draws = thin_posterior(chains, problem.parameters, count, posterior.k)
    return replace(draws, mode=np.array(fit.theta))
