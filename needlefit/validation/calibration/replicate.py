"""One replicate: parameters drawn from their prior, needles that follow them, and what is inferred."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needlefit.errors import FitError
from needlefit.inference.draws import of_prior
from needlefit.inference.problem import Problem
from needlefit.inference.ties import NOISE_SCALE
from needlefit.project.streams import stream
from needlefit.validation.calibration.controls import Control, broken
from needlefit.validation.calibration.inferred import Inferred, Way, inferred, of_prior_alone
from needlefit.validation.calibration.measured import measured
from needlefit.validation.calibration.quantities import Quantities, stiffest
from needlefit.validation.calibration.ranks import DRAWS, ranks
from needlefit.validation.design import planned
from needlefit.validation.job import Job

Floats = NDArray[np.float64]

ATTEMPTS = 1000
"""Draws of the prior among which one must have a solution."""


@dataclass(frozen=True)
class Experiment:
    """What all replicates share.

    Attributes
    ----------
    job : Job
        Of one fold: its insertions are the design.
    stiff : mapping
        Weights of the combination that the design tells best, by name.
    sampled : bool
        Whether every posterior is drawn by the sampler.
    control : Control or None
        In what the likelihood is wrong.
    """

    job: Job
    stiff: Mapping[str, float]
    sampled: bool = False
    control: Control | None = None


@dataclass(frozen=True)
class Made:
    """True parameters, the problem of inferring them, and how often they were drawn again."""

    theta: Floats
    problem: Problem
    redrawn: int


def replicate(number: int, experiment: Experiment) -> dict[str, Any]:
    """Return a row: the truth, where it stands among draws of its posterior, and how these were computed."""
    seed, name = experiment.job.recipe.seed, experiment.job.name
    made = make(experiment.job, stream(seed, name, "calibrate", number, "data"))
    truth = made.problem.values(made.theta)
    scale = truth.get(NOISE_SCALE, made.problem.density.scale)
    problem = broken(made.problem, experiment.control, scale)
    rng = stream(seed, name, "calibrate", number, "inference")
    found = _inferred(problem, experiment, rng)
    tip = max(made.problem.insertions, key=lambda one: one.depth)
    design = np.array([experiment.stiff[name] for name in problem.names])
    quantities = Quantities(problem, np.array([design, stiffest(problem, found.mode)]), tip)
    theta = problem.parameters.theta(truth)[None]
    true = quantities(theta, problem.log_posteriors(theta))[0]
    placed = ranks(true, quantities(found.thetas, found.log_posterior), rng)
    return {
        "replicate": number,
        **{name: truth[name] for name in made.problem.names},
        "redrawn": made.redrawn,
        "by": found.by,
        "trusted": found.trusted,
        "pareto_k": None if found.weights is None else found.weights.k,
        "independent": None if found.weights is None else found.weights.independent,
        "evaluations": None if found.weights is None else len(found.weights.thetas),
        **{f"rank_{name}": int(rank) for name, rank in zip(quantities.names, placed, strict=True)},
    }


def make(job: Job, rng: np.random.Generator) -> Made:
    """Return parameters drawn from the prior, and the design measured of needles that follow them.

    Raises
    ------
    FitError
        If the prior hardly holds parameters that the design has a solution for.
    """
    (fold,) = job.folds
    everything = job.problem(fold)
    for redrawn in range(ATTEMPTS):
        theta = of_prior(job.parameters, 1, rng)[0]
        values = everything.values(theta)
        design = planned(job, fold, values)
        if design is None:
            continue
        scale = values.get(NOISE_SCALE, everything.density.scale)
        seen = [measured(job.dataset, one, values, job.medium, rng, scale) for one in design.insertions]
        known = tuple(one for one in seen if one is not None)
        if len(known) < len(seen):
            continue
        problem = replace(everything, insertions=known)
        if np.isfinite(problem.log_posterior(theta)):
            return Made(theta, problem, redrawn)
    raise FitError(
        f"of {ATTEMPTS} parameter sets drawn from the prior the design has a solution for none",
        mend="narrow the bounds of the medium",
    )


def _inferred(problem: Problem, experiment: Experiment, rng: np.random.Generator) -> Inferred:
    recipe = experiment.job.recipe
    if experiment.control == "prior":
        return of_prior_alone(problem, Way(recipe, DRAWS), rng)
    if experiment.sampled:
        return inferred(problem, Way(recipe, DRAWS, "always"), rng)
    # a wrong likelihood is to be noticed, not to be sampled well
    return inferred(problem, Way(recipe, DRAWS, "otherwise" if experiment.control is None else "never"), rng)
