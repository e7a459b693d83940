"""Specimens made up: drawn about a mean, measured with the errors that a dataset states, and inferred."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.insertion import Insertion
from needlefit.errors import FitError
from needlefit.inference.optimize import minimize
from needlefit.inference.problem import Problem
from needlefit.inference.specimens import KERNELS, Specimen, specimen
from needlefit.inference.weighing.about_fit import of_fit
from needlefit.inference.weighing.importance import Effort
from needlefit.validation.calibration.measured import measured
from needlefit.validation.job import Job

Floats = NDArray[np.float64]

STARTS, EFFORT = 2, Effort(draws=120, enough=150.0)
"""Of each made-up specimen: its search, and the weighing of its posterior."""

POINTS = 30
"""At which a made-up needle is measured, about."""

ATTEMPTS = 100
"""Draws of a specimen among which one must have a solution."""


def made_up(job: Job, mean: Floats, spread: float, rng: np.random.Generator) -> Problem:
    """Return the problem of one specimen drawn about the mean, its needles measured with errors as stated.

    Raises
    ------
    FitError
        If hardly any such specimen has a solution.
    """
    everything = job.problem(job.folds[0])
    for _ in range(ATTEMPTS):
        theta = mean + spread * rng.standard_normal(len(mean))
        if np.any(theta < everything.lower) or np.any(theta > everything.upper):
            continue
        values = everything.values(theta)
        seen = [measured(job.dataset, _thinned(one), values, job.medium, rng) for one in job.folds[0].tune]
        known = tuple(one for one in seen if one is not None)
        if len(known) == len(seen):
            return replace(everything, insertions=known)
    raise FitError(
        "specimens about this mean have no solution, or lie outside the bounds",
        where="recovery",
        mend="choose a mean farther within the bounds, or smaller spreads",
    )


def _thinned(insertion: Insertion) -> Insertion:
    """Return an insertion with about `POINTS` of its points: neighbours err alike."""
    step = max(1, len(insertion.planar) // POINTS)
    kept = np.arange(len(insertion.planar) - 1, -1, -step)[::-1]
    sd = None if insertion.sd is None else insertion.sd[kept]
    return replace(insertion, planar=insertion.planar[kept], sd=sd)


def inferred(job: Job, problem: Problem, rng: np.random.Generator) -> Specimen:
    """Return the posterior of a made-up specimen; nothing of it is known before."""
    recipe = job.recipe.model_copy(update={"starts": STARTS, "minimize": "posterior"})
    found = of_fit(problem, minimize(problem, recipe, rng), rng, 1, EFFORT)
    chosen = rng.choice(len(found.thetas), size=KERNELS, p=np.exp(found.log_weights))
    return specimen(found.thetas[chosen])
