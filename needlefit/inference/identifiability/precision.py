"""Compute standard deviations of theta at a point: by the information, or the scatter between needles."""

import math
from dataclasses import replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.select import MIN_GROUPS, group_independent
from needlefit.inference.identifiability.information import cramer_rao
from needlefit.inference.parameters import HYPERPARAMETERS, is_logarithmic
from needlefit.inference.problem import Problem
from needlefit.inference.ties import NOISE_SCALE

MAX_LOG_SD, MAX_SHAPE_SD = 0.3, 0.5
"""Largest standard deviations, of a logarithm and of a shape parameter, of one called determined."""

MAX_SD_RATIO = 0.5
"""Largest part of its prior's standard deviation of a parameter that the shapes, not the prior, determine."""

BOUND_FRACTION = 1e-3
"""A parameter closer to a bound than this part of its range lies at it."""

CUT_OFF_FRACTION = 0.01
"""A 95 % interval that ends closer to a bound than this part of the bounds is cut off there."""


def is_determined_by_data(name: str, sd: float, prior_sd: float) -> bool:
    """Return whether a posterior standard deviation is small enough by the data, not only by the prior."""
    return sd < (MAX_LOG_SD if is_logarithmic(name) else MAX_SHAPE_SD) and sd < MAX_SD_RATIO * prior_sd


def posterior_sds(problem: Problem, theta: Floats) -> dict[str, float]:
    """Return the standard deviations of theta by the information, or the scatter between needles, by name."""
    return dict(zip(problem.names, compute_sds(problem, theta)[0].tolist(), strict=True))


def compute_sds(problem: Problem, theta: Floats, draws: Floats | None = None) -> tuple[Floats, Floats, float]:
    """Return the standard deviations (P,), the information (P, P) and the reduced chi-square.

    With `draws` (B, P) of the posterior, deviations and information are theirs: where the posterior is not
    Gaussian, the information at one point is smaller or larger. Where bounds cut the draws off, deviations
    are not smaller than by the information, which the bounds hardly limit.
    """
    residuals, slope, chi_square = linearize(problem, theta)
    prior_part = prior_and_noise_information(problem)
    # a chi-square above 1 means that the noise is understated; one below 1 is not taken as extra precision
    information = slope.T @ slope / max(1.0, chi_square) + prior_part
    between = between_needle_sds(problem, slope, residuals, slope.T @ slope + prior_part)
    least = between
    if draws is not None and is_cut_off(problem, theta, draws):
        least = np.maximum(between, np.std(draws, axis=0))
    elif draws is not None:
        # pinv: draws that do not differ along a direction are no reason for an error
        information = np.linalg.pinv(np.atleast_2d(np.cov(draws, rowvar=False)), hermitian=True)
    return np.maximum(cramer_rao(information), least), information, chi_square


def is_cut_off(problem: Problem, theta: Floats, draws: Floats) -> bool:
    """Return whether a bound limits the posterior: it holds `theta` (P,), or an end of a 95 % interval."""
    ends = np.percentile(draws, (2.5, 97.5), axis=0)
    near = CUT_OFF_FRACTION * (problem.upper - problem.lower)
    at_bound = any(find_bounds(problem, theta))
    return bool(at_bound or np.any(ends[0] < problem.lower + near) or np.any(ends[1] > problem.upper - near))


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
    ids, specimens = zip(*((i.id, i.specimen) for i in problem.insertions), strict=True)
    scores: dict[str, Floats] = {}
    for group, (j, r) in zip(group_independent(ids, specimens), parts, strict=True):
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
    sd: Floats = np.sqrt(np.diag(covariance))
    return sd


def add_estimated_noise(problem: Problem, theta: Floats) -> Problem:
    """Return the problem with a noise model: the stated one, or else the rms residual at `theta`."""
    stated = problem.dataset.noise if problem.noise is None else problem.noise
    if stated.stated:
        return problem
    squares = [np.mean((sim - measured)[:, 1] ** 2) for sim, measured in problem.points(theta)]
    # 1e-6 mm: a fit without residuals must not give a noise of 0
    rms = max(math.sqrt(float(np.mean(squares))), 1e-6)
    return replace(problem, noise=replace(stated, point_sd=rms))


def linearize(problem: Problem, theta: Floats) -> tuple[Floats, Floats, float]:
    """Return the linearised observations: residuals (R,), derivatives (R, P), reduced chi-square."""
    # residuals of the observations come first; the normalising one and the prior's follow, and the prior is
    # added by `prior_information`
    count = sum(problem.density.residual_counts)
    residuals, slope = (np.nan_to_num(part[:count]) for part in problem.jacobian(theta))
    # what a scale of the noise does to residuals is no information on the other parameters, on average
    slope = slope * [float(name not in HYPERPARAMETERS) for name in problem.names]
    rows = sum(known.rows for known in problem.density.observations)
    return residuals, slope, float(residuals @ residuals) / max(1, rows - len(problem.names))


def prior_information(problem: Problem) -> Floats:
    """Return the information (P, P) of the stated prior; parameters without one get that of their bounds."""
    stated, half_normal = problem.parameters.prior, problem.parameters.half_normal
    known = {*stated.marginals, *half_normal, *(tie.name for tie in stated.ties)}
    flat = np.array([name not in known for name in problem.names])
    # 12 / width^2 is the precision of a uniform distribution of this width
    bounds: Floats = np.diag(np.where(flat, 12.0 / (problem.upper - problem.lower) ** 2, 0.0))
    # of a half-normal prior: 2 at its deviation, which is the peak of the logarithm's density
    spreads: Floats = np.diag([2.0 * (name in half_normal) for name in problem.names])
    return bounds + spreads + stated.information(problem.names)


def prior_and_noise_information(problem: Problem) -> Floats:
    """Return `prior_information` plus the information that the residuals hold on the noise scale."""
    rows = sum(known.rows for known in problem.density.observations)  # Fisher: 2 of each, of the logarithm
    known: Floats = prior_information(problem)
    return known + np.diag([2.0 * rows * (name == NOISE_SCALE) for name in problem.names])
