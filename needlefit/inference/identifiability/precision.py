"""Find what the data determine: the Fisher information, standard deviations of theta, and verdicts on both.

The assumptions that they rest on are those of docs/fitting.md, "Assumptions loosened"; the rules of verdicts
those of "Identifiability". The information at the optimum is local, profile likelihoods are not: what a
profile leaves open is not determined.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from needlefit.arrays import Floats
from needlefit.datasets.select import MIN_GROUPS, group_insertions
from needlefit.inference.error_fit import find_search_tolerance
from needlefit.inference.fit import Fit, Start
from needlefit.inference.identifiability.directions import (
    BOUND_FRACTION,
    CUT_OFF_FRACTION,
    MAX_LOG_SD,
    MAX_SD_RATIO,
    MAX_SHAPE_SD,
    NORMAL_95_HALF_WIDTH_SD,
    Direction,
    is_determined_by_data,
    principal_directions,
)
from needlefit.inference.identifiability.profile import (
    LikelihoodProfile,
    minimize_squares,
    summarize_profile,
    trace_profiles,
)
from needlefit.inference.likelihood.observations import Discrepancy
from needlefit.inference.parameter_names import HYPERPARAMETERS, NOISE_SCALE, is_logarithmic
from needlefit.inference.parameters import MATERIAL_SPREAD, Parameters, loosen_ties
from needlefit.inference.posterior_density import NodePoints
from needlefit.inference.problem import Problem
from needlefit.project.tasks import Step, Stop, never_stop, no_step


def cramer_rao(information: Floats) -> Floats:
    """Return the Cramer-Rao standard deviations (P,) of theta; infinite where there is no information."""
    precision, vectors = np.linalg.eigh(information)
    with np.errstate(divide="ignore", invalid="ignore"):
        # a singular direction must make only its own parameters infinite: components below rounding would
        # give 0 / 0
        variance = np.where(vectors**2 > 1e-14, vectors**2 / np.maximum(precision, 0.0), 0.0)
    return np.sqrt(variance.sum(axis=1))


class Linearized(NamedTuple):
    """The observations linearised about one theta; who needs it twice computes it once."""

    residuals: Floats  #: (R,)
    slope: Floats  #: (R, P); derivatives of the residuals by theta
    chi_square: float  #: reduced
    points: NodePoints  #: from which all of this follows, also with other errors of the observations


def posterior_sds(problem: Problem, theta: Floats, linearized: Linearized | None = None) -> dict[str, float]:
    """Return the standard deviations of theta by the information, or the scatter between needles, by name."""
    return dict(
        zip(problem.names, compute_sds(problem, theta, linearized=linearized)[0].tolist(), strict=True)
    )


def compute_sds(
    problem: Problem, theta: Floats, draws: Floats | None = None, linearized: Linearized | None = None
) -> tuple[Floats, Floats]:
    """Return the standard deviations (P,) and the information (P, P), given the observations linearised `at`.

    With `draws` (B, P) of the posterior, deviations and information are theirs: where the posterior is not
    Gaussian, the information at one point is smaller or larger. Where bounds cut the draws off, deviations
    are not smaller than by the information, which the bounds hardly limit.
    """
    residuals, slope, chi_square, _ = linearized or linearize(problem, theta)
    prior_part = prior_and_noise_information(problem)
    # a chi-square above 1 means that the noise is understated; one below 1 is not taken as extra precision
    information = slope.T @ slope / max(1.0, chi_square) + prior_part
    between = between_needle_sds(problem, slope, residuals, slope.T @ slope + prior_part)
    least = between
    if draws is not None:
        # does a bound limit the posterior: does it hold theta, or an end of a 95 % interval?
        low, high = np.percentile(draws, (2.5, 97.5), axis=0)
        near = CUT_OFF_FRACTION * (problem.upper - problem.lower)
        cut_off = any(find_bounds(problem, theta)) or np.any(low < problem.lower + near)
        cut_off = cut_off or np.any(high > problem.upper - near)
    if draws is not None and cut_off:
        least = np.maximum(between, np.std(draws, axis=0))
    elif draws is not None:
        # pinv: draws that do not differ along a direction are no reason for an error
        information = np.linalg.pinv(np.atleast_2d(np.cov(draws, rowvar=False)), hermitian=True)
    return np.maximum(cramer_rao(information), least), information


def find_bounds(problem: Problem, theta: Floats) -> list[str]:
    """Return at which bound of its search each parameter lies: `lower`, `upper`, or empty."""
    place = (theta - problem.lower) / (problem.upper - problem.lower)
    return ["lower" if p < BOUND_FRACTION else "upper" if p > 1 - BOUND_FRACTION else "" for p in place]


def between_needle_sds(problem: Problem, slope: Floats, residuals: Floats, information: Floats) -> Floats:
    """Return the standard deviations (P,) of theta that the scatter between needles implies.

    The sandwich estimate over independent groups: each one's pull J^T r on theta, about their mean (the fit
    minimises another objective, so the pulls need not sum to 0). Where the model misses something that
    varies from needle to needle, this is larger than what the noise within needles says. 0 where there are
    too few groups for it.
    """
    ends = np.cumsum(problem.density.residual_counts)[:-1]
    parts = zip(np.split(slope, ends), np.split(residuals, ends), strict=True)
    groups = group_insertions(problem.dataset, problem.insertions)
    scores: dict[str, Floats] = {}
    for group, (j, r) in zip(groups, parts, strict=True):
        scores[group] = scores.get(group, np.zeros(j.shape[1])) + j.T @ r
    n = len(scores)
    # the scatter of n groups has rank n - 1 at most: fewer groups than parameters would underestimate it
    if n < max(MIN_GROUPS, len(problem.names) + 2) or not problem.names:
        return np.zeros(len(problem.names))
    scatter = np.array(list(scores.values()))  # (n, P)
    scatter = scatter - scatter.mean(axis=0)
    inverse = np.linalg.inv(information)
    # the sandwich: bread is the inverse information, the filling the scatter of the groups' scores
    covariance = n / (n - 1) * inverse @ (scatter.T @ scatter) @ inverse
    return np.sqrt(np.diag(covariance))


def add_estimated_noise(problem: Problem, theta: Floats) -> Problem:
    """Return the problem with a noise model: the stated one, or else the rms residual at `theta`."""
    stated = problem.dataset.noise if problem.noise is None else problem.noise
    if stated.stated or problem.dataset.noise_is_stated:
        return problem
    across = slice(1, 1 + problem.dataset.directions)
    squares = [np.mean((sim - measured)[:, across] ** 2) for sim, measured in problem.points(theta)]
    # 1e-6 mm: a fit without residuals must not give a noise of 0
    rms = max(math.sqrt(float(np.mean(squares))), 1e-6)
    return replace(problem, noise=replace(stated, point_sd=rms))


def linearize(problem: Problem, theta: Floats, points: NodePoints | None = None) -> Linearized:
    """Return the observations linearised about theta (P,); `points` are those of their nodes, if known."""
    values, density = problem.values(theta), problem.density
    points = points or density.differentiate_points(values)
    # residuals of the observations come first; the normalising one and the prior's follow, and the prior is
    # added by `prior_information`
    count, (jacobian,) = sum(density.residual_counts), density.jacobians([values], points=points)
    residuals, slope = (np.nan_to_num(part[:count]) for part in jacobian)
    # what a scale of the noise does to residuals is no information on the other parameters, on average
    slope = slope * [float(name not in HYPERPARAMETERS) for name in problem.names]
    rows = sum(observation.rows for observation in density.observations)
    chi_square = float(residuals @ residuals) / max(1, rows - len(problem.names))
    return Linearized(residuals, slope, chi_square, points)


def prior_information(problem: Problem) -> Floats:
    """Return the information (P, P) of the stated prior; parameters without one get that of their bounds."""
    stated = problem.parameters.prior
    stated_names = {*stated.marginals, *(tie.name for tie in stated.ties)}
    flat = np.array([name not in stated_names for name in problem.names])
    # 12 / width^2 is the precision of a uniform distribution of this width
    bounds: Floats = np.diag(np.where(flat, 12.0 / (problem.upper - problem.lower) ** 2, 0.0))
    return bounds + stated.information(problem.names)


def prior_and_noise_information(problem: Problem) -> Floats:
    """Return `prior_information` plus the information that the residuals hold on the noise scale."""
    rows = sum(
        observation.rows for observation in problem.density.observations
    )  # Fisher: 2 of each, of the logarithm
    information: Floats = prior_information(problem)
    return information + np.diag([2.0 * rows * (name == NOISE_SCALE) for name in problem.names])


#: length over which the model's error fades along the needle: about that of a layer
MODEL_ERROR_LENGTH_MM = 15.0
#: standard deviation of the model's error, as part of the rms deflection of the tips, at least: a fit takes
#: up much of what its model misses, so that its residuals are too small to say
MIN_MODEL_ERROR = 0.01

#: assumptions without which a parameter is not determined
MEAN_OF_SPECIMENS = "determined only as the mean of specimens, which differ"
STATED_TIES = "determined only under the stated ties"
NO_MODEL_ERROR = "determined only if the model has no error"

LOOSENED = "ties loosened and a model error"


@dataclass(frozen=True)
class Loosened:
    """Standard deviations of theta with an assumption loosened, by parameter; the earlier ones are too."""

    condition: str
    sds: Mapping[str, float]


def loosen(
    problem: Problem,
    theta: Floats,
    sds: Mapping[str, float] | None = None,
    linearized: Linearized | None = None,
) -> tuple[Loosened, ...]:
    """Return the standard deviations at `theta` (P,) with ties loosened, and then with a model error.

    By `sds`, the standard deviations before, or by default those of the information: loosening adds to their
    squares what it adds by the information.
    """
    linearized = linearized or linearize(problem, theta)
    stated = posterior_sds(problem, theta, linearized)
    sds_before = stated if sds is None else sds
    values, parameters = problem.values(theta), loosen_ties(problem.parameters)
    loosened, problems = list[Loosened](), list[tuple[str, Problem, Linearized]]()
    if parameters != problem.parameters:
        problem, theta = problem.with_parameters(parameters), parameters.theta(values)
        linearized = linearize(problem, theta)
        problems.append((STATED_TIES, problem, linearized))
    allowing = replace(problem, model_error=estimate_model_error(problem, linearized))
    problems.append((NO_MODEL_ERROR, allowing, linearize(allowing, theta, linearized.points)))
    for condition, loosened_problem, there in problems:
        loose = posterior_sds(loosened_problem, theta, there)
        added = {name: math.sqrt(max(0.0, sd**2 - stated.get(name, 0.0) ** 2)) for name, sd in loose.items()}
        loosened.append(
            Loosened(condition, {n: math.hypot(sds_before.get(n, 0.0), more) for n, more in added.items()})
        )
    return tuple(loosened)


def find_condition(name: str, prior_sd: float, loosened: Sequence[Loosened]) -> str:
    """Return the condition under which alone a parameter is determined; empty if there is none."""
    for condition in loosened:
        if not is_determined_by_data(name, condition.sds[name], prior_sd):
            return condition.condition
    return ""


def find_tie_conditions(
    parameters: Parameters,
    determined: Mapping[str, bool],
    conditions: Mapping[str, str],
    loosened: Sequence[Loosened],
) -> dict[str, str]:
    """Return the conditions of exactly tied parameters: their source's, else that of the tie.

    Where the source is not determined, what is tied to it is neither. `determined` and `conditions` are of
    free parameters.
    """
    tie_conditions = {}
    for name, (_, source) in parameters.ties.items():
        if determined.get(source, False) and is_logarithmic(name):  # the tie alone gives it its spread
            tie_conditions[name] = find_condition(name, math.log(MATERIAL_SPREAD), loosened)
        else:
            tie_conditions[name] = conditions.get(source, "")
    return tie_conditions


def find_model_error(problem: Problem, theta: Floats) -> dict[str, float]:
    """Return the standard deviation that a model error adds to each free parameter, by its name."""
    noisy = add_estimated_noise(problem, theta)
    added = add_model_error(noisy, theta, linearize(noisy, theta))
    return dict(zip(problem.names, np.sqrt(np.diag(added)).tolist(), strict=True))


def add_model_error(problem: Problem, theta: Floats, linearized: Linearized) -> Floats:
    """Return the covariance (P, P) that a model error adds to that of theta, by the information there."""
    allowing = replace(problem, model_error=estimate_model_error(problem, linearized))
    covariances = [
        np.linalg.pinv(slope.T @ slope + prior_and_noise_information(variant), hermitian=True)
        for variant, slope in (
            (problem, linearized.slope),
            (allowing, linearize(allowing, theta, linearized.points).slope),
        )
    ]
    # the allowance adds variance in every direction; rounding may say otherwise where it adds none
    added, vectors = np.linalg.eigh(covariances[1] - covariances[0])
    return vectors * np.maximum(added, 0.0) @ vectors.T


def estimate_model_error(problem: Problem, linearized: Linearized) -> Discrepancy:
    """Return a model error of the size of the residuals beyond the noise, `MIN_MODEL_ERROR` at least.

    By moments: chi^2 exceeds the degrees of freedom by the sum of the variances that the error adds to the
    whitened residuals.
    """
    unit = Discrepancy(1.0, MODEL_ERROR_LENGTH_MM)
    squares = float(linearized.residuals @ linearized.residuals)
    excess = squares * (1.0 - 1.0 / linearized.chi_square) if linearized.chi_square > 1 else 0.0
    added = sum(
        float(
            np.sum(
                (observation.whitening @ block_diag(*[unit.covariance(s)] * observation.directions))
                * observation.whitening
            )
        )
        for observation in problem.density.observations
        for s in observation.nodes.s[:1]
    )
    tips = [insertion.deflection for insertion in problem.insertions]
    least = MIN_MODEL_ERROR * math.sqrt(float(np.mean(np.square(tips))))
    return Discrepancy(max(math.sqrt(excess / added), least), MODEL_ERROR_LENGTH_MM)


# ---- what the direction of insertion would determine, of shapes that are known only up to a rigid motion

DIRECTION_SD_DEG = 0.5  #: of a needle that is set by hand


def predict_factors(problem: Problem, theta: Sequence[float]) -> dict[str, float]:
    """Return the factor between the ends of each 95 % interval if all directions were stated, by parameter.

    By the information at `theta` (P,), without the measured residuals: these are of shapes that were turned.
    Only moduli and lengths have a factor.
    """
    searched, problem = problem.parameters.restrict(np.array(theta)), problem.searched
    angle_sd = math.radians(DIRECTION_SD_DEG)
    insertions = tuple(
        replace(insertion, pose_source="first_point", pose_angle_sd=angle_sd)
        for insertion in problem.insertions
    )
    stated = replace(problem, dataset=replace(problem.dataset, pose="known"), insertions=insertions)
    slope = linearize(stated, searched).slope
    sds = cramer_rao(slope.T @ slope + prior_and_noise_information(stated))
    return {
        name: math.exp(2 * NORMAL_95_HALF_WIDTH_SD * sd)
        for name, sd in zip(stated.names, sds.tolist(), strict=True)
        if is_logarithmic(name) and name not in HYPERPARAMETERS
    }


# ---- which parameters the data determine, and which only in combination

#: largest range among equal starts, in these standard deviations, of a parameter called determined
MAX_RANGE_SD = 4.0
#: a start is within tolerance of the best if its log posterior is within this of the best one's
LOG_POSTERIOR_TOLERANCE = 0.1
MIN_NAMED_WEIGHT = 0.1  #: weight from which on a direction is named in the note of a parameter


@dataclass(frozen=True)
class Identifiability:
    """Which free parameters the data determine, and how well; mappings are keyed by parameter name."""

    sds: Mapping[str, float]  #: posterior standard deviation, of the logarithm (of a shape parameter itself)
    determined: Mapping[str, bool]  #: whether the data determine it by itself
    at_bound: Mapping[str, str]  #: "lower" or "upper" where the best point lies at a bound, else ""
    #: spread_low, spread_high: its range among the starts within tolerance of the best (Pa, mm)
    spread_low: Mapping[str, float]
    spread_high: Mapping[str, float]
    directions: tuple[Direction, ...]  #: principal directions of the information, best known first
    notes: Mapping[str, str]  #: one sentence for a person
    together: Mapping[str, bool] = field(default_factory=dict)  #: the same while all others are held
    #: under which assumption alone the data determine it, "" otherwise
    conditions: Mapping[str, str] = field(default_factory=dict)
    #: the standard deviations with assumptions loosened; none where nothing is determined anyway
    loosened: tuple[Loosened, ...] = ()
    #: by how much an error of the model lets each parameter vary beside the posterior: SD, as `sds`
    model_error: Mapping[str, float] = field(default_factory=dict)


def identify(
    problem: Problem, fit: Fit, draws: Floats | None = None, further: Floats | None = None
) -> Identifiability:
    """Return what the data determine at the best point of a fit, given `draws` (B, P) of its posterior.

    Where several specimens were fitted these are of their mean, and `further` (B, P) are in another specimen.
    Of parameters that are held nothing is returned.
    """
    restrict = problem.parameters.restrict
    ends = [s.theta for s in fit.starts if within_tolerance(s, fit)] or [fit.theta]
    equal = restrict(np.array(ends, dtype=np.float64).reshape(len(ends), len(problem.names)))
    theta, problem = restrict(np.array(fit.theta)), problem.searched
    draws, further = (None if some is None else restrict(some) for some in (draws, further))
    names = problem.names
    noisy = add_estimated_noise(problem, theta)
    linearized = linearize(noisy, theta)
    computed_sds, information = compute_sds(noisy, theta, draws, linearized)
    sds, before = dict(zip(names, computed_sds.tolist(), strict=True)), prior_information(noisy)
    added = add_model_error(noisy, theta, linearized)
    # pinv: a direction without information has no variance to add to
    wider = np.linalg.pinv(np.linalg.pinv(information, hermitian=True) + added, hermitian=True)
    directions = principal_directions(wider.astype(np.float64), names, before)
    together = find_together(names, information, before)
    bounds = dict(zip(names, find_bounds(problem, theta), strict=True))
    ranges = dict(zip(names, np.ptp(equal, axis=0).tolist(), strict=True))
    prior = problem.parameters.prior
    informed = {n: not bounds[n] and sds[n] < MAX_SD_RATIO * prior.sd(n) for n in names}
    limits = {n: MAX_LOG_SD if is_logarithmic(n) else MAX_SHAPE_SD for n in names}
    nominally = {
        n: informed[n] and sds[n] < limits[n] and ranges[n] < MAX_RANGE_SD * limits[n] for n in names
    }
    loosened = loosen(noisy, theta, sds, linearized) if any(nominally.values()) else ()
    if loosened and further is not None:
        apart = dict(zip(names, np.std(further, axis=0).tolist(), strict=True))
        apart |= {name: apart.get(source, 0.0) for name, (_, source) in problem.parameters.ties.items()}
        loosened = (Loosened(MEAN_OF_SPECIMENS, apart), *loosened)
    conditions = {n: find_condition(n, prior.sd(n), loosened) if nominally[n] else "" for n in names}
    determined = {n: nominally[n] and not conditions[n] for n in names}
    conditions |= find_tie_conditions(problem.parameters, determined, conditions, loosened)
    low, high = (problem.values(end(equal, axis=0)) for end in (np.min, np.max))
    notes = {}
    for k, n in enumerate(names):
        if bounds[n]:
            note = f"not determined: it lies at its {bounds[n]} bound"
        elif determined[n]:
            note = f"determined, also with {LOOSENED}"
        elif conditions[n]:
            note = conditions[n]
        else:
            # the best-known combination that the parameter is part of, if any is known
            combinations = [
                direction.words
                for direction in directions
                if abs(direction.weights[k]) >= MIN_NAMED_WEIGHT
                and direction.sd < MAX_LOG_SD
                and direction.is_informed
            ]
            note = "not determined" + (" alone" if combinations else "")
            if is_logarithmic(n):
                note += ": equally good starts disagree" if sds[n] < MAX_LOG_SD else ""
            note = "; ".join([note, *combinations[:1]])
        notes[n] = note
    return Identifiability(
        sds=sds,
        determined=determined,
        together=together,
        conditions=conditions,
        loosened=loosened,
        model_error=dict(zip(names, np.sqrt(np.diag(added)).tolist(), strict=True)),
        at_bound=bounds,
        spread_low={n: low[n] for n in names},
        spread_high={n: high[n] for n in names},
        directions=directions,
        notes=notes,
    )


def find_together(names: Sequence[str], information: Floats, prior: Floats) -> dict[str, bool]:
    """Return which parameters the data determine while all others are held, by information (P, P)."""
    # the diagonal of the information is that on each parameter given all others
    held = zip(names, *(1 / np.sqrt(np.diag(matrix)) for matrix in (information, prior)), strict=True)
    return {name: is_determined_by_data(name, sd, prior_sd) for name, sd, prior_sd in held}


def within_tolerance(start: Start, fit: Fit) -> bool:
    """Return whether the objective of a start is within tolerance of the best start's."""
    return objective_excess(start, fit) <= 1.0


def objective_excess(start: Start, fit: Fit) -> float:
    """Return the objective of a start minus the best one, in units of the tolerance."""
    tolerance = LOG_POSTERIOR_TOLERANCE
    if fit.minimized != "posterior":
        tolerance = find_search_tolerance(fit.objective)
    return (start.objective - fit.objective) / tolerance if math.isfinite(fit.objective) else math.inf


@dataclass(frozen=True)
class FitProfiles:
    """The profiles of all parameters of one fit that are not held."""

    parameters: tuple[LikelihoodProfile, ...]  #: in the order of theta
    scale: float  #: what deviances were divided by: the reduced chi-square where it is above 1
    gain: float  #: how much higher than at the fit the log posterior is at the best point met on the way
    best: tuple[float, ...]  #: Theta of that point


def profile_parameters(
    problem: Problem,
    fit: Fit,
    jobs: int = 1,
    stop: Stop = never_stop,
    step: Step = no_step,
) -> FitProfiles:
    """Compute the profiles about a fit; the result does not depend on the number of threads.

    Where the dataset states no noise, the fit's residuals stand for it. `stop` leaves out what has not begun.
    `step` is as of `trace_profiles`.
    """
    parameters, theta = problem.parameters, np.array(fit.theta)
    noisy, theta = add_estimated_noise(problem, theta).searched, parameters.restrict(theta)
    optimum = minimize_squares(noisy, theta)
    scale = max(1.0, linearize(noisy, optimum.theta)[2])
    paths = trace_profiles(noisy, range(len(noisy.names)), optimum, jobs, stop, scale, step=step)
    profiles = tuple(summarize_profile(noisy, k, path, scale) for k, path in sorted(paths.items()))
    at_fit = noisy.jacobian(theta)[0]
    # residuals are those of the posterior: of a metric fit their gain means nothing
    gain = 0.5 * (float(at_fit @ at_fit) - optimum.value) if fit.minimized == "posterior" else 0.0
    return FitProfiles(profiles, scale, gain, tuple(parameters.extend(optimum.theta).tolist()))


def is_determined_by_profile(profile: LikelihoodProfile, prior_sd: float) -> bool:
    """Return whether its 95 % interval ends on both sides and is that of a determined parameter.

    `prior_sd` is the standard deviation of the prior of its coordinate of theta.
    """
    sd = (profile.high - profile.low) / (2 * NORMAL_95_HALF_WIDTH_SD)  # of a Gaussian of this interval
    return profile.closed and is_determined_by_data(profile.name, sd, prior_sd)
