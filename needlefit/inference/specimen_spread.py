"""Estimate mean and spread of the parameters between specimens of one medium, in two stages.

    theta_i ~ N( m, diag(tau^2) ),      needles of specimen i ~ their likelihood at theta_i

Stage one has the posterior of every specimen by itself, with a prior flat in theta. Stage two weighs its
draws anew by the population (D. Lunn, J. Barrett, M. Sweeting, S. Thompson, J. R. Stat. Soc. C 62 (2013)
551):

    L(m, tau) = prod_i sum_k w_ik N( theta_ik; m, diag(tau^2) ).

Draws alone fail where tau is smaller than the distance between them, at tau = 0 altogether. So each draw
stands for a Gaussian, shrunk toward the specimen's mean so that mean and covariance of all stay what they are
(J. Liu, M. West, in: Sequential Monte Carlo Methods in Practice, Springer 2001, 197), and the sum is over
N( c_ik; m, H_i + diag(tau^2) ), closed for every tau. Ridges stay: the kernels H_i have the shape of their
posterior. tau has a half-normal prior, m a flat one within the bounds.

Parameters vary independently between specimens, in theta: **decided here**, for a few specimens cannot
determine a correlation. What they determine best is a combination, so the spread along it is reported too.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.special import logsumexp

from needlefit.arrays import Floats
from needlefit.inference.importance.sampler import Effort, WeightedDraws, sample_by_importance
from needlefit.inference.sampling.log_density import approximate_by_laplace

KERNELS_PER_SPECIMEN = 100
"""Draws that stand for the posterior of a specimen."""

SPREAD_EFFORT = Effort(draws=400, min_ess=400.0)

MAX_TAU_SD = 5.0
"""Bound of tau, in standard deviations of its prior."""

DENSITY_POINTS = 400
"""Places at which a marginal density is looked at."""


@dataclass(frozen=True)
class Specimen:
    """The posterior of one specimen as a mixture of equally weighted Gaussian kernels.

    Attributes
    ----------
    centres : (K, P) array
    kernel : (P, P) array
        Their covariance.
    """

    centres: Floats
    kernel: Floats

    @property
    def mean(self) -> Floats:
        """Mean of the posterior: (P,)."""
        found: Floats = self.centres.mean(axis=0)
        return found

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
    """The posterior of mean m and spread tau over specimens, given some of them.

    Attributes
    ----------
    bounds : (P,), (P,) arrays
        Of m.
    spread_sd : float
        Of the half-normal prior of every tau.
    """

    specimens: tuple[Specimen, ...]
    bounds: tuple[Floats, Floats]
    spread_sd: float

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
            found += _likelihoods(one, means, taus)
        density[inside] = found
        return density

    def posterior(self, rng: np.random.Generator) -> WeightedDraws:
        """Return weighted draws of (m, tau): (N, 2 P)."""

        def height(at: Floats) -> float:
            return -float(self.log_density(at[None])[0])

        within = list(zip(self.lower.tolist(), self.upper.tolist(), strict=True))
        found = minimize(height, self._choose_start(), method="Nelder-Mead", bounds=within)
        about = approximate_by_laplace(self.log_density, found.x, self.lower, self.upper)
        return sample_by_importance(self.log_density, [about], (self.lower, self.upper), rng, SPREAD_EFFORT)

    def _choose_start(self) -> Floats:
        means = np.array([one.mean for one in self.specimens])
        within = np.mean([np.diag(one.covariance) for one in self.specimens], axis=0)
        # method of moments: variance of the means, less that within specimens; not exactly 0, which is a
        # bound
        spread = np.sqrt(np.maximum(means.var(axis=0) - within, 0.01 * self.spread_sd**2))
        low, high = self.lower, self.upper
        begin: Floats = np.clip(np.concatenate([means.mean(axis=0), spread]), low, high)
        return begin


def _likelihoods(one: Specimen, means: Floats, taus: Floats) -> Floats:
    """Return the logarithm of the mean of N( c_k; m, H + diag(tau^2) ) for W pairs (W, P) of m and tau."""
    whole = one.kernel + taus[:, :, None] ** 2 * np.eye(taus.shape[1])  # (W, P, P)
    factor = np.linalg.cholesky(whole)
    away = one.centres[None] - means[:, None]  # (W, K, P)
    white = np.linalg.solve(factor, away.transpose(0, 2, 1))  # (W, P, K)
    logs = -0.5 * np.sum(white**2, axis=1)
    volume = np.sum(np.log(np.diagonal(factor, axis1=1, axis2=2)), axis=1)
    found: Floats = logsumexp(logs, axis=1) - np.log(logs.shape[1]) - volume
    return found


def best_determined(specimens: Sequence[Specimen]) -> Floats:
    """Return the combination (P,), of length 1, that the specimens determine best on average."""
    information = np.mean([np.linalg.inv(one.covariance) for one in specimens], axis=0)
    vector: Floats = np.linalg.eigh(information)[1][:, -1]
    upright: Floats = vector * np.sign(vector[np.argmax(np.abs(vector))])
    return upright


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
