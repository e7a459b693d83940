"""The spread of the parameters between specimens, and what it adds to predictions in a new specimen.

    theta_i ~ N( m, T ),      T = sum_g tau_g^2 z_g z_g^T

for the specimens i of one population. z_g marks the parameters that move together: the moduli of one
material, or the bevel offset, all in logarithms. There is one tau of all materials and one of the bevel;
both have a half-normal prior, m a flat one. The posterior of a specimen by itself is taken as Gaussian, so
that m is integrated out in closed form and (tau_mu, tau_b) stand on a grid. Ties with a spread are left out
of it: they are known of the specimens that are fitted, and a wrong tie moves all parameters. Of each material
the source of the ties counts.

Draws theta of a posterior learned from n specimens become draws of a further one by adding
N( 0, (1 + 1 / n) T ): both it and the mean of the n vary about m. Between layers of nominally one material,
tied with a spread, the ratios are drawn anew. Few specimens tell little of a spread: with two or three its
posterior depends strongly on its prior. (`specimen_spread` estimates a population's own mean and spread from
many.)
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from needlefit.arrays import Floats
from needlefit.inference.identifiability.gauss_newton import minimize_squares
from needlefit.inference.parameters import Parameters
from needlefit.inference.problem import Problem
from needlefit.inference.ties import BEVEL_PARAMETERS, dimension

GRID_POINTS, LARGEST_SPREAD = 48, 8.0
"""Values of each spread, evenly spaced up to this many deviations of its prior."""

MAX_REDRAWS = 100
"""Times that a specimen outside the bounds is drawn again; then it is put on them."""


@dataclass(frozen=True)
class SpecimenEstimate:
    """The posterior of one specimen's theta, as a Gaussian: mean (P,) and covariance (P, P)."""

    mean: Floats
    covariance: Floats


@dataclass(frozen=True)
class SpecimenSpread:
    """The posterior of the standard deviations between specimens, of ln mu and of ln b.

    Attributes
    ----------
    taus : (G, 2) array
        Of moduli and of the bevel offset.
    weights : (G,) array
        They sum to 1.
    specimens : int
        How many it was learned from; the prior alone is left from fewer than two.
    """

    taus: Floats
    weights: Floats
    specimens: int

    @property
    def rms(self) -> Floats:
        """Root mean squares (2,) of both spreads."""
        found: Floats = np.sqrt(self.weights @ self.taus**2)
        return found

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """Return draws (B, 2)."""
        return self.taus[rng.choice(len(self.taus), size=count, p=self.weights)]


def learn_spread(
    estimates: Sequence[SpecimenEstimate], parameters: Parameters, prior: tuple[float, float]
) -> SpecimenSpread:
    """Return what some specimens say of the spread; `prior` are the deviations of its half-normal priors."""
    unit = (np.arange(GRID_POINTS) + 0.5) * LARGEST_SPREAD / GRID_POINTS
    units = np.stack(np.meshgrid(unit, unit, indexing="ij"), axis=-1).reshape(-1, 2)
    taus, logs = units * prior, -0.5 * np.sum(units**2, axis=1)
    if len(estimates) < 2:
        return SpecimenSpread(taus, np.exp(logs - logsumexp(logs)), len(estimates))
    tied = {tie.name for tie in parameters.prior.ties}
    untied = [k for k, name in enumerate(parameters.free) if name not in tied]
    square = np.ix_(untied, untied)
    between = make_covariances(parameters, taus)[:, untied][:, :, untied]  # (G, Q, Q)
    information, pull = np.zeros_like(between), np.zeros(between.shape[:2])
    for one in estimates:
        whole, mean = one.covariance[square] + between, one.mean[untied]
        inverse = np.linalg.inv(whole)
        pulled = inverse @ mean
        logs -= 0.5 * (np.linalg.slogdet(whole)[1] + pulled @ mean)
        information, pull = information + inverse, pull + pulled
    # the mean of the population, flat, is integrated out
    best = np.linalg.solve(information, pull[..., None])[..., 0]
    logs += 0.5 * (np.sum(pull * best, axis=1) - np.linalg.slogdet(information)[1])
    return SpecimenSpread(taus, np.exp(logs - logsumexp(logs)), len(estimates))


def make_covariances(parameters: Parameters, taus: Floats) -> Floats:
    """Return the covariances (G, P, P) of theta between specimens with spreads (G, 2)."""
    groups = list_groups(parameters)
    marks = np.array([[float(name in names) for name in parameters.free] for _, names in groups])
    squares = np.array([taus[:, which] ** 2 for which, _ in groups]).T  # (G, groups)
    found: Floats = np.einsum("gk,kp,kq->gpq", squares, marks, marks)
    return found


def list_groups(parameters: Parameters) -> list[tuple[int, tuple[str, ...]]]:
    """Return the free parameters that move together, each group with the number of its spread."""
    source = {tie.name: tie.source for tie in parameters.prior.ties}
    groups: dict[str, list[str]] = {}
    for name in parameters.free:
        if dimension(name) == "modulus" or name in BEVEL_PARAMETERS:
            root = name
            while root in source:
                root = source[root]
            groups.setdefault(root, []).append(name)
    return [(int(names[0] in BEVEL_PARAMETERS), tuple(names)) for names in groups.values()]


def move_to_new_specimen(
    parameters: Parameters, thetas: Floats, spread: SpecimenSpread, fitted: int, rng: np.random.Generator
) -> Floats:
    """Return draws (B, P) of the parameters in a new specimen, from those of a posterior of `fitted` ones.

    A specimen outside the medium's bounds is drawn again.
    """
    taus = np.sqrt(1 + 1 / fitted) * spread.draw(len(thetas), rng)
    moved, left = thetas.copy(), np.arange(len(thetas))
    for _ in range(MAX_REDRAWS):
        moved[left] = _draw_specimens(parameters, thetas[left], taus[left], rng)
        outside = (moved[left] < parameters.lower) | (moved[left] > parameters.upper)
        left = left[np.any(outside, axis=1)]
        if not len(left):
            break
    return np.clip(moved, parameters.lower, parameters.upper)


def _draw_specimens(parameters: Parameters, thetas: Floats, taus: Floats, rng: np.random.Generator) -> Floats:
    """Return draws (B, P) of specimens that differ from thetas (B, P) by spreads (B, 2)."""
    moved = thetas.copy()
    for which, names in list_groups(parameters):
        shift = taus[:, which] * rng.standard_normal(len(thetas))
        for name in names:
            moved[:, parameters.free.index(name)] += shift
    for tie in parameters.prior.ties:  # a source comes before what is tied to it
        if tie.name in parameters.free and tie.source in parameters.free:
            own, source = (parameters.free.index(name) for name in (tie.name, tie.source))
            ratio = math.log(tie.factor) + math.log(tie.spread) * rng.standard_normal(len(thetas))
            moved[:, own] = moved[:, source] + ratio
    return moved


def estimate_specimen(problem: Problem, begin: Floats) -> SpecimenEstimate | None:
    """Return the posterior of one specimen, without ties, about its peak, searched from `begin` (P,).

    None where its needles cannot be solved.
    """
    prior = problem.parameters.prior.without_ties()
    problem = problem.with_parameters(replace(problem.parameters, prior=prior))
    easier = problem.approach("posterior")
    near = begin if easier is None else minimize_squares(easier, begin).theta
    found = minimize_squares(problem, near)
    if not math.isfinite(found.value):
        return None
    # no wider than the bounds: along a ridge there is no curvature
    width = problem.upper - problem.lower
    covariance: Floats = np.asarray(
        np.linalg.inv(found.information + np.diag(12 / width**2)), dtype=np.float64
    )
    return SpecimenEstimate(found.theta, covariance)
