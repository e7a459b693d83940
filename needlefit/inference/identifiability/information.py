"""The Fisher information at one theta, and the standard deviations of theta that follow from it."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.select import MIN_GROUPS, group_insertions
from needlefit.inference.identifiability.directions import BOUND_FRACTION, CUT_OFF_FRACTION
from needlefit.inference.parameter_names import HYPERPARAMETERS, NOISE_SCALE
from needlefit.inference.posterior_density import NodePoints
from needlefit.inference.problem import Problem


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
