"""Estimate the spread of the parameters between specimens, and what it adds to predictions in a new specimen.

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
posterior depends strongly on its prior.

`Population` estimates mean and spread of one medium's specimens, theta_i ~ N( m, diag(tau^2) ), from many, in
two stages. Stage one has the posterior of every specimen by itself, with a prior flat in theta. Stage two
weighs its draws anew by the population (D. Lunn, J. Barrett, M. Sweeting, S. Thompson, J. R. Stat. Soc. C 62
(2013) 551):

    L(m, tau) = prod_i sum_k w_ik N( theta_ik; m, diag(tau^2) ).

Draws alone fail where tau is smaller than the distance between them, at tau = 0 altogether. So each draw
stands for a Gaussian, shrunk toward the specimen's mean so that mean and covariance of all stay what they are
(J. Liu, M. West, in: Sequential Monte Carlo Methods in Practice, Springer 2001, 197), and the sum is over
N( c_ik; m, H_i + diag(tau^2) ), closed for every tau. tau has a half-normal prior, m a flat one within the
bounds. A few specimens cannot determine a correlation, so parameters vary independently; what they determine
best is a combination, so the spread along it is reported too.

`TransferredPrior` makes the prior of a new medium: the posterior of an old one, widened by the spread between
media. Both media are taken for draws of one population of which only the spread s is known (a standard
deviation of each coordinate of theta). Then the new medium lies about the old one with variance 2 s^2, and
with draws theta_i of the old posterior the prior is the mixture

    theta_new ~ 1/B sum_i N( theta_i,  diag(2 s^2) )

by which draws are made and weighted. Searches need a sum of squares. They use a Gaussian in its place

    theta_new ~ N( theta_fit,  E[ (theta - theta_fit) (theta - theta_fit)^T ]  +  diag(2 s^2) )

with E the mean over the old posterior. It peaks at the old fit, not at the posterior's mean, so that without
new data the optimum is what it was. Where draws lie on a plateau beside the peak it is too wide. Layers that
the old medium ties together may differ in the new.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np
from scipy.optimize import minimize
from scipy.special import logsumexp

from needlefit.arrays import Floats
from needlefit.errors import ConfigError
from needlefit.inference.identifiability.profile import minimize_squares
from needlefit.inference.parameters import (
    BEVEL_PARAMETERS,
    Parameters,
    Prior,
    dimension,
    make_gaussian_prior,
    to_coordinate,
)
from needlefit.inference.predict import draw_from_prior
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.importance import Effort, WeightedDraws, sample_by_importance
from needlefit.inference.sampling.log_density import approximate_by_laplace

#: values of each spread, evenly spaced up to this many deviations of its prior
GRID_POINTS, LARGEST_SPREAD = 48, 8.0
MAX_REDRAWS = 100  #: times that a specimen outside the bounds is drawn again; then it is put on them


@dataclass(frozen=True)
class SpecimenEstimate:
    """The posterior of one specimen's theta, as a Gaussian: mean (P,) and covariance (P, P)."""

    mean: Floats
    covariance: Floats


@dataclass(frozen=True)
class SpecimenSpread:
    """The posterior of the standard deviations between specimens, of ln mu and of ln b."""

    taus: Floats  #: (G, 2) of moduli and of the bevel offset
    weights: Floats  #: (G,) they sum to 1
    specimens: int  #: how many it was learned from; the prior alone is left from fewer than two

    @property
    def rms(self) -> Floats:
        """Root mean squares (2,) of both spreads."""
        return np.sqrt(self.weights @ self.taus**2)

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
    groups = list_groups(parameters)
    marks = np.array([[float(name in names) for name in parameters.free] for _, names in groups])
    squares = np.array([taus[:, which] ** 2 for which, _ in groups]).T  # (G, groups)
    between = np.einsum("gk,kp,kq->gpq", squares, marks, marks)[:, untied][:, :, untied]  # (G, Q, Q)
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
        drawn, spreads = thetas[left].copy(), taus[left]
        for which, names in list_groups(parameters):
            shift = spreads[:, which] * rng.standard_normal(len(drawn))
            for name in names:
                drawn[:, parameters.free.index(name)] += shift
        for tie in parameters.prior.ties:  # a source comes before what is tied to it
            if tie.name in parameters.free and tie.source in parameters.free:
                own, source = (parameters.free.index(name) for name in (tie.name, tie.source))
                ratio = math.log(tie.factor) + math.log(tie.spread) * rng.standard_normal(len(drawn))
                drawn[:, own] = drawn[:, source] + ratio
        moved[left] = drawn
        outside = (moved[left] < parameters.lower) | (moved[left] > parameters.upper)
        left = left[np.any(outside, axis=1)]
        if not len(left):
            break
    return np.clip(moved, parameters.lower, parameters.upper)


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
    covariance = np.linalg.inv(found.information + np.diag(12 / width**2))
    return SpecimenEstimate(found.theta, np.asarray(covariance, dtype=np.float64))


KERNELS_PER_SPECIMEN = 100  #: draws that stand for the posterior of a specimen

SPREAD_EFFORT = Effort(draws=400, min_ess=400.0)

MAX_TAU_SD = 5.0  #: bound of tau, in standard deviations of its prior
DENSITY_POINTS = 400  #: places at which a marginal density is looked at


@dataclass(frozen=True)
class Specimen:
    """The posterior of one specimen as a mixture of equally weighted Gaussian kernels."""

    centres: Floats  #: (K, P)
    kernel: Floats  #: (P, P) their covariance

    @property
    def mean(self) -> Floats:
        """Mean of the posterior: (P,)."""
        return self.centres.mean(axis=0)

    @property
    def covariance(self) -> Floats:
        """Covariance of the posterior: (P, P)."""
        return np.atleast_2d(np.cov(self.centres.T, bias=True)) + self.kernel


def make_specimen(draws: Floats) -> Specimen:
    """Return the kernels of posterior draws (K, P); their width follows Silverman's rule."""
    count, p = draws.shape
    width = (4 / (p + 2)) ** (1 / (p + 4)) * count ** (-1 / (p + 4))
    part = width**2 / (1 + width**2)  # of the covariance, that the kernels have
    mean = draws.mean(axis=0)
    covariance = np.atleast_2d(np.cov(draws.T, bias=True))
    return Specimen(mean + np.sqrt(1 - part) * (draws - mean), part * covariance)


@dataclass(frozen=True)
class Population:
    """The posterior of mean m and spread tau over specimens, given some of them."""

    specimens: tuple[Specimen, ...]
    bounds: tuple[Floats, Floats]  #: (P,), (P,) of m
    spread_sd: float  #: of the half-normal prior of every tau

    @property
    def lower(self) -> Floats:
        """Lower bounds of (m, tau): (2 P,)."""
        return np.concatenate([self.bounds[0], np.zeros(len(self.bounds[0]))])

    @property
    def upper(self) -> Floats:
        """Upper bounds of (m, tau): (2 P,)."""
        return np.concatenate([self.bounds[1], np.full(len(self.bounds[1]), MAX_TAU_SD * self.spread_sd)])

    def log_density(self, at: Floats) -> Floats:
        """Return the log posterior densities (W,) of (m, tau) (W, 2 P), not normalised; -inf outside."""
        inside = np.all((at >= self.lower) & (at <= self.upper), axis=1)
        density = np.full(len(at), -np.inf)
        means, taus = np.split(at[inside], 2, axis=1)
        found = -0.5 * np.sum((taus / self.spread_sd) ** 2, axis=1)
        for one in self.specimens:
            # the logarithm of the mean of N( c_k; m, H + diag(tau^2) )
            whole = one.kernel + taus[:, :, None] ** 2 * np.eye(taus.shape[1])  # (W, P, P)
            factor = np.linalg.cholesky(whole)
            away = one.centres[None] - means[:, None]  # (W, K, P)
            white = np.linalg.solve(factor, away.transpose(0, 2, 1))  # (W, P, K)
            logs = -0.5 * np.sum(white**2, axis=1)
            volume = np.sum(np.log(np.diagonal(factor, axis1=1, axis2=2)), axis=1)
            found += logsumexp(logs, axis=1) - np.log(logs.shape[1]) - volume
        density[inside] = found
        return density

    def posterior(self, rng: np.random.Generator) -> WeightedDraws:
        """Return weighted draws of (m, tau): (N, 2 P)."""

        def height(at: Floats) -> float:
            return -float(self.log_density(at[None])[0])

        bounds = list(zip(self.lower.tolist(), self.upper.tolist(), strict=True))
        means = np.array([one.mean for one in self.specimens])
        within = np.mean([np.diag(one.covariance) for one in self.specimens], axis=0)
        # method of moments: variance of the means, less that within specimens; not exactly 0, a bound
        spread = np.sqrt(np.maximum(means.var(axis=0) - within, 0.01 * self.spread_sd**2))
        start = np.clip(np.concatenate([means.mean(axis=0), spread]), self.lower, self.upper)
        found = minimize(height, start, method="Nelder-Mead", bounds=bounds)
        about = approximate_by_laplace(self.log_density, found.x, self.lower, self.upper)
        return sample_by_importance(self.log_density, [about], (self.lower, self.upper), rng, SPREAD_EFFORT)


def best_determined(specimens: Sequence[Specimen]) -> Floats:
    """Return the combination (P,), of length 1, that the specimens determine best on average."""
    information = np.mean([np.linalg.inv(one.covariance) for one in specimens], axis=0)
    vector: Floats = np.linalg.eigh(information)[1][:, -1]
    return vector * np.sign(vector[np.argmax(np.abs(vector))])


def marginal_density(values: Floats, weights: Floats, lowest: float) -> tuple[Floats, Floats]:
    """Return points (DENSITY_POINTS,) and the density there of weighted draws (N,) that end at `lowest`.

    Smoothed by kernels, mirrored where the values end.
    """
    from scipy.stats import gaussian_kde  # late: it takes 0.2 s to load

    kernel = gaussian_kde(values, weights=weights)
    wide = 3 * float(np.sqrt(kernel.covariance[0, 0]))
    grid = np.linspace(lowest, float(values.max()) + wide, DENSITY_POINTS)
    # reflection at `lowest`: a kernel estimate would lose the mass beyond the end
    density: Floats = kernel(grid) + kernel(2 * lowest - grid)
    return grid, density


def highest_density_interval(
    values: Floats, weights: Floats, level: float, lowest: float
) -> tuple[float, float]:
    """Return the interval of highest density of weighted draws (N,); it may begin at `lowest` exactly."""
    grid, density = marginal_density(values, weights, lowest)
    order = np.argsort(-density, kind="stable")
    filled = np.cumsum(density[order]) / density.sum()
    kept = grid[order[: int(np.searchsorted(filled, level)) + 1]]
    return float(kept.min()), float(kept.max())


#: spread that is always added, so that what the old medium fixes or ties keeps a density in the new one
MIN_SPREAD = 1e-3

BOUND_TOLERANCE = 1e-9  #: part of a bound by which a fit at it may miss it


def widen_posterior(
    old: Parameters, fit: Mapping[str, float], thetas: Floats, new: Parameters, spread: Mapping[str, float]
) -> Prior:
    """Return the prior of the free parameters of `new` that the old medium also has; the others stay flat.

    `fit` has every parameter of the old medium at its best fit (Pa, mm), `thetas` (B, P) are draws of its
    posterior, `spread` is the standard deviation between media of each parameter's coordinate, by name.

    Raises ConfigError if no parameter is common to both, or the old fit lies outside the new bounds.
    """
    names = tuple(name for name in new.free if name in old.names)
    if not names:
        raise ConfigError("old and new medium have no parameter in common", fix="name media that resemble")
    for name in names:
        low, high = new.bounds[name]
        if not low - BOUND_TOLERANCE * abs(low) <= fit[name] <= high + BOUND_TOLERANCE * abs(high):
            raise ConfigError(
                f"{name} of the old medium is {fit[name]:.3g}, outside the new medium's bounds",
                expected=f"{low:g} to {high:g}",
                fix="widen the bounds of the new medium",
            )
    centre = np.array([to_coordinate(name, fit[name]) for name in names])
    off = _find_coordinates(old, thetas, names) - centre
    between = np.array([spread.get(name, 0.0) for name in names])
    covariance = off.T @ off / len(off) + np.diag(2 * between**2 + MIN_SPREAD**2)
    return make_gaussian_prior(names, centre, covariance)


@dataclass(frozen=True)
class TransferredPrior:
    """The mixture of Gaussians about the draws of an old posterior: the prior of some new parameters."""

    parameters: Parameters  #: of the new medium, with the Gaussian of `widen_posterior` as their prior
    names: tuple[str, ...]  #: q of them: those of the mixture
    centres: Floats  #: (B, Q) draws of the old posterior, in theta's coordinates
    sds: Floats  #: (Q,) of each Gaussian

    @classmethod
    def from_draws(
        cls,
        old: Parameters,
        fit: Mapping[str, float],
        thetas: Floats,
        new: Parameters,
        spread: Mapping[str, float],
    ) -> Self:
        """Return the mixture about draws (B, P) of the old posterior; arguments as of `widen_posterior`."""
        prior = widen_posterior(old, fit, thetas, new, spread)
        # the old posterior contains a half-normal prior that both share: it must not count twice
        half_normal = {name: sd for name, sd in new.half_normal.items() if name not in prior.names}
        parameters = replace(new, prior=prior, half_normal=half_normal)
        sds = np.sqrt(2.0) * np.array([spread.get(name, 0.0) for name in prior.names])
        return cls(parameters, prior.names, _find_coordinates(old, thetas, prior.names), sds)

    def correct(self, thetas: Floats) -> Floats:
        """Return the log density (W,) of the mixture at thetas (W, P), less that of the Gaussian prior.

        Both but for a constant. Parameters that do not differ between media have no spread: there the
        mixture is smoothed, by the rule of Silverman.
        """
        at = thetas[:, [self.parameters.free.index(name) for name in self.names]]
        count, known = len(self.centres), int(np.sum(self.sds == 0))
        smoothing = (4 / ((known + 2) * count)) ** (1 / (known + 4))
        smoothed = np.maximum(smoothing * self.centres.std(axis=0), MIN_SPREAD)
        sds = np.where(self.sds == 0, smoothed, self.sds)
        white = (at[:, None] - self.centres) / sds  # (W, B, Q)
        mixture: Floats = logsumexp(-0.5 * np.sum(white**2, axis=2), axis=1)
        prior = self.parameters.prior
        gaussian = np.array([prior.log_density(self.parameters.values(theta)) for theta in thetas])
        return mixture - gaussian

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """Return draws (`count`, P) of the prior within the bounds; what is not in the mixture is flat."""
        thetas = draw_from_prior(self.parameters, count, rng)
        columns = [self.parameters.free.index(name) for name in self.names]
        lower, upper = self.parameters.lower[columns], self.parameters.upper[columns]
        found = np.empty((0, len(columns)))
        while len(found) < count:
            drawn = self.centres + self.sds * rng.standard_normal(self.centres.shape)
            inside = np.all((drawn >= lower - BOUND_TOLERANCE) & (drawn <= upper + BOUND_TOLERANCE), axis=1)
            found = np.concatenate([found, drawn[inside]])
        thetas[:, columns] = np.clip(found[:count], lower, upper)
        return thetas


@dataclass(frozen=True)
class TransferProblem(Problem):
    """A problem of a new medium: draws are weighted by the mixture, searches use the Gaussian."""

    transferred: TransferredPrior | None = None

    @classmethod
    def of(cls, problem: Problem, transferred: TransferredPrior) -> Self:
        """Return a problem with the mixture as its prior."""
        kept = {field.name: getattr(problem, field.name) for field in fields(problem)}
        return cls(**{**kept, "parameters": transferred.parameters}, transferred=transferred)

    def log_posteriors(self, thetas: Floats, jobs: int = 1) -> Floats:
        """Return the log of the posterior density (W,) of many thetas (W, P) at once, on `jobs` threads."""
        density = super().log_posteriors(thetas, jobs)
        return density if self.transferred is None else density + self.transferred.correct(thetas)


def _find_coordinates(old: Parameters, thetas: Floats, names: tuple[str, ...]) -> Floats:
    """Return the coordinates (B, Q) of some parameters of draws (B, P)."""
    sets = [old.values(theta) for theta in thetas]
    return np.array([[to_coordinate(name, values[name]) for name in names] for values in sets])
