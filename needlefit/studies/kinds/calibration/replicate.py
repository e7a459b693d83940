"""Compute one replicate: parameters from the prior, needles simulated with them, their posterior."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion
from needlefit.datasets.tip_tracks import TipTrack
from needlefit.errors import FitError
from needlefit.inference.optimize import minimize
from needlefit.inference.parameters import NOISE_SCALE
from needlefit.inference.predict import draw_from_prior, thin_posterior
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.importance import (
    WeightedDraws,
    escalate_effort,
    find_modes,
    resample,
    sample_about_modes,
)
from needlefit.inference.sampling.sample import sample
from needlefit.project.random_streams import random_stream
from needlefit.schemas.recipe import RecipeRecord
from needlefit.studies.job import Job
from needlefit.studies.kinds.calibration.quantities import RankedQuantities, best_determined_direction
from needlefit.studies.kinds.calibration.schema import Control
from needlefit.studies.planned_insertions import simulate_design
from needlefit.studies.rank_statistics import RANK_DRAWS, rank_truth
from needlefit.studies.simulated_data import draw_bevels, simulate_measurement

UNDERSTATED_SD_FACTOR = 0.7
"""Factor on the true deviation of the noise that the control "sigma" assumes."""


def corrupt_problem(problem: Problem, control: Control | None, scale: float) -> Problem:
    """Return the problem with a deliberate error; `scale` is the true noise scale.

    "sigma" underrates the noise and does not estimate it, "pose" takes every pose as it was measured,
    "shuffled" confounds the shapes of the shallowest and the deepest insertion (of one alone, and of the
    deepest tip track, the side of its bevel). "prior" leaves the problem as it is, for there nothing is
    inferred at all.
    """
    if control == "sigma":
        how = problem.likelihood.model_copy(update={"noise_scale": UNDERSTATED_SD_FACTOR * scale})
        parameters = problem.parameters
        if NOISE_SCALE in parameters.names:
            others = [name for name in parameters.free if name != NOISE_SCALE]
            parameters = parameters.with_only(others, {NOISE_SCALE: UNDERSTATED_SD_FACTOR * scale})
        scaled = _scale_pose(problem, UNDERSTATED_SD_FACTOR)
        return replace(scaled, likelihood=how, parameters=parameters)
    if control == "pose":
        sure = _scale_pose(problem, 0.0)
        return replace(sure, dataset=replace(sure.dataset, pose="known"))
    if control == "shuffled":
        return replace(problem, insertions=_swap_shapes(problem.insertions))
    return problem


def _scale_pose(problem: Problem, factor: float) -> Problem:
    """Return the problem with stated errors of the pose that are `factor` times as large."""
    noise = problem.dataset.noise
    noise = replace(noise, registration_mean=factor * noise.registration_mean)
    scaled = (
        one
        if isinstance(one, TipTrack)
        else replace(one, pose_shift_sd=factor * one.pose_shift_sd, pose_angle_sd=factor * one.pose_angle_sd)
        for one in problem.insertions
    )
    return replace(problem, dataset=replace(problem.dataset, noise=noise), insertions=tuple(scaled))


def _swap_shapes(insertions: tuple[Insertion, ...]) -> tuple[Insertion, ...]:
    if len(insertions) == 1 or any(isinstance(one, TipTrack) for one in insertions):
        deepest = max(insertions, key=lambda one: one.depth)
        return tuple(replace(one, side=-one.side) if one is deepest else one for one in insertions)
    order = np.argsort([one.depth for one in insertions], kind="stable")
    first, last = int(order[0]), int(order[-1])
    swapped = list(insertions)
    swapped[first] = _with_shape(insertions[first], insertions[last])
    swapped[last] = _with_shape(insertions[last], insertions[first])
    return tuple(swapped)


def _with_shape(one: Insertion, other: Insertion) -> Insertion:
    """Return an insertion with the measured shape of another."""
    sections = other.sections
    if sections is not None:
        sections = replace(sections, points=one.frame.to_world(other.frame.to_local(sections.points)))
    return replace(
        one,
        planar=other.planar,
        centerline=other.centerline,
        out_of_plane=other.out_of_plane,
        sd=other.sd,
        sections=sections,
    )


DrawSource = Literal["importance", "sampler", "prior"]


@dataclass(frozen=True)
class InferredPosterior:
    """One computed posterior: its draws and how they were computed.

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
    draw_source: DrawSource
    trusted: bool
    weights: WeightedDraws | None = None


@dataclass(frozen=True)
class InferenceOptions:
    """How a posterior is computed.

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


def infer_posterior(
    problem: Problem, options: InferenceOptions, rng: np.random.Generator
) -> InferredPosterior:
    """Return the posterior of a problem, from its prior; no start of the search uses the truth."""
    recipe = options.recipe.model_copy(update={"minimize": "posterior"})
    ends = find_modes(minimize(problem, recipe, rng), problem.upper - problem.lower)
    if options.sampler == "always":
        return _sample_posterior(problem, options, ends, rng)
    found = escalate_effort(lambda effort: sample_about_modes(problem, ends, rng, effort=effort))
    if options.sampler == "otherwise" and not found.certified:
        return _sample_posterior(problem, options, ends, rng, found)
    chosen = resample(found, options.draws, rng)
    thetas, density = found.thetas[chosen], found.log_density[chosen]
    return InferredPosterior(thetas, density, ends[0], "importance", found.certified, found)


def _sample_posterior(
    problem: Problem,
    options: InferenceOptions,
    ends: Floats,
    rng: np.random.Generator,
    weights: WeightedDraws | None = None,
) -> InferredPosterior:
    posterior = sample(problem, ends, options.recipe.sample, rng)
    thetas = thin_posterior(posterior, problem.parameters, options.draws).thetas
    density = problem.log_posteriors(thetas)
    return InferredPosterior(thetas, density, ends[0], "sampler", posterior.converged, weights)


def draw_prior_only(
    problem: Problem, options: InferenceOptions, rng: np.random.Generator
) -> InferredPosterior:
    """Return draws of the prior where the model has a solution, in place of the posterior."""
    thetas = np.empty((0, len(problem.names)))
    while len(thetas) < options.draws:
        drawn = draw_from_prior(problem.parameters, options.draws, rng)
        thetas = np.concatenate([thetas, drawn[np.isfinite(problem.log_posteriors(drawn))]])
    thetas = thetas[: options.draws]
    density = problem.log_posteriors(thetas)
    return InferredPosterior(thetas, density, thetas[int(np.argmax(density))], "prior", True)


MAX_PRIOR_DRAWS = 1000
"""Draws of the prior among which one must have a solution."""


@dataclass(frozen=True)
class Experiment:
    """The data that all replicates share.

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
class SimulatedExperiment:
    """True parameters, the problem of inferring them, and how often they were drawn again."""

    theta: Floats
    problem: Problem
    redrawn: int


def replicate(number: int, experiment: Experiment) -> dict[str, Any]:
    """Return one row: the truth, its ranks among draws of its posterior, and how these were computed."""
    seed, name = experiment.job.recipe.seed, experiment.job.name
    simulated = simulate_experiment(experiment.job, random_stream(seed, name, "calibrate", number, "data"))
    truth = simulated.problem.values(simulated.theta)
    scale = truth.get(NOISE_SCALE, simulated.problem.density.scale)
    problem = corrupt_problem(simulated.problem, experiment.control, scale)
    rng = random_stream(seed, name, "calibrate", number, "inference")
    found = _infer(problem, experiment, rng)
    tip = max(simulated.problem.insertions, key=lambda one: one.depth)
    design = np.array([experiment.stiff[name] for name in problem.names])
    quantities = RankedQuantities(
        problem, np.array([design, best_determined_direction(problem, found.mode)]), tip
    )
    theta = problem.parameters.theta(truth)[None]
    true = quantities(theta, problem.log_posteriors(theta))[0]
    placed = rank_truth(true, quantities(found.thetas, found.log_posterior), rng)
    return {
        "replicate": number,
        **{name: truth[name] for name in simulated.problem.names},
        "redrawn": simulated.redrawn,
        **summarize_inference(found),
        **{f"rank_{name}": int(rank) for name, rank in zip(quantities.names, placed, strict=True)},
    }


def summarize_inference(found: InferredPosterior) -> dict[str, Any]:
    """Return the cells of a replicate that say how its posterior was computed."""
    return {
        "draw_source": found.draw_source,
        "certified": found.trusted,
        "pareto_k": None if found.weights is None else found.weights.k,
        "ess": None if found.weights is None else found.weights.effective_sample_size,
        "evaluations": None if found.weights is None else len(found.weights.thetas),
    }


def simulate_experiment(job: Job, rng: np.random.Generator) -> SimulatedExperiment:
    """Draw parameters from the prior, and simulate the measurement of the design with them.

    Raises
    ------
    FitError
        If the prior hardly holds parameters that the design has a solution for.
    """
    (fold,) = job.folds
    everything = job.problem(fold)
    for redrawn in range(MAX_PRIOR_DRAWS):
        theta = draw_from_prior(job.parameters, 1, rng)[0]
        values = everything.values(theta)
        design = simulate_design(job, fold, values)
        if design is None:
            continue
        true = {NOISE_SCALE: everything.density.scale, **values}
        shared = draw_bevels(job.dataset, design.insertions, rng) if everything.linear_bevels else {}
        measurements = [
            simulate_measurement(job.dataset, one, true, job.medium, rng, shared) for one in design.insertions
        ]
        known = tuple(one for one in measurements if one is not None)
        if len(known) < len(measurements):
            continue
        problem = replace(everything, insertions=known)
        if np.isfinite(problem.log_posterior(theta)):
            return SimulatedExperiment(theta, problem, redrawn)
    raise FitError(
        f"of {MAX_PRIOR_DRAWS} parameter sets drawn from the prior the design has a solution for none",
        fix="narrow the bounds of the medium",
    )


def _infer(problem: Problem, experiment: Experiment, rng: np.random.Generator) -> InferredPosterior:
    recipe = experiment.job.recipe
    if experiment.control == "prior":
        return draw_prior_only(problem, InferenceOptions(recipe, RANK_DRAWS), rng)
    if experiment.sampled:
        return infer_posterior(problem, InferenceOptions(recipe, RANK_DRAWS, "always"), rng)
    # a wrong likelihood is to be noticed, not to be sampled well
    return infer_posterior(
        problem,
        InferenceOptions(recipe, RANK_DRAWS, "otherwise" if experiment.control is None else "never"),
        rng,
    )
