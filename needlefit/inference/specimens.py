"""Estimate how much the parameters differ between specimens, and predict a new specimen.

    theta_i ~ N( m, T ),      T = cov( ln mu_1 ... ln mu_G, ln b )

for the specimens i of one population; T and its prior are those of docs/inference.md, "Specimens that
differ". Of moduli that are tied with a spread the source counts; the others deviate from it as the tie
states, in every specimen anew.

Two stages estimate it (D. Lunn, J. Barrett, M. Sweeting, S. Thompson, J. R. Stat. Soc. C 62 (2013) 551).
Stage one draws from the posterior of every specimen by itself. Stage two has the population,

    L(m, T) = prod_i sum_k N( c_ik; m, H_i + T ),

in which each draw stands for a Gaussian, shrunk toward the specimen's mean so that mean and covariance of
all stay what they are (J. Liu, M. West, in: Sequential Monte Carlo Methods in Practice, Springer 2001, 197):
draws alone fail where T is narrower than the distance between them. What the medium states of a parameter is
a prior of m: draws are chosen by its inverse, so that it counts once.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

from needlefit.arrays import Floats, log_sum_exp
from needlefit.inference.draws import Source
from needlefit.inference.forward_model import PreparedModel
from needlefit.inference.parameter_names import BEVEL_PARAMETERS, dimension
from needlefit.inference.parameters import Parameters
from needlefit.inference.prior import Prior
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.importance import (
    Effort,
    LogDensityFunction,
    WeightedDraws,
    approximate_by_information,
    difference_information,
    resample,
    sample_by_importance,
)
from needlefit.inference.sampling.posterior import Posterior, thin_chains
from needlefit.schemas.recipe import BetweenSpecimensRecord

#: smallest and largest tau, in standard deviations of its half-normal prior
TAU_RANGE = (1e-3, 5.0)
MAX_ATANH_CORRELATION = 6.0  #: bound of atanh rho
MAX_LOGIT_SHARE = 8.0  #: bound of logit w
#: smallest number of draws of the other priors, of which as many are kept as the tip's prior allows
PRIOR_DRAWS_AT_ONCE = 20_000
#: largest number of redraws of a specimen outside the bounds; after them it is put on the bounds
MAX_REDRAWS = 100


@dataclass(frozen=True)
class SpreadModel:
    """Which parameters differ between specimens, and the prior of their covariance T.

    T has hyperparameters (S,): ln tau of the moduli and of the bevel parameter, then atanh rho and logit w
    where there are any.
    """

    names: tuple[str, ...]  #: Q parameters, in the order of T: moduli, the bevel parameter
    moduli: int  #: how many of them are moduli
    correlated: bool  #: whether there are moduli and a bevel parameter
    sds: Floats  #: standard deviations of the half-normal priors of the taus
    #: (Q,) derivatives of ln(tip deflection), times the root of what is stated of it beside `sds`
    tip_slopes: Floats

    @classmethod
    def of(
        cls,
        parameters: Parameters,
        modulus_sd: float,
        bevel_sd: float,
        tip_slopes: Mapping[str, float] | None = None,
    ) -> Self:
        """Return the model of the moduli and the bevel parameter; an SD of 0: they do not vary.

        `tip_slopes`, by parameter, are of ln(tip deflection) in its standard deviations between specimens.
        Without, nothing is stated of tips.
        """
        # what is tied to a fixed parameter varies as the others do
        tied = {tie.name for tie in parameters.prior.ties if tie.source in parameters.free}
        moduli = [name for name in parameters.free if dimension(name) == "modulus" and name not in tied]
        bevels = [name for name in parameters.free if name in BEVEL_PARAMETERS]
        moduli, bevels = moduli if modulus_sd else [], bevels if bevel_sd else []
        sds = [*[modulus_sd] * bool(moduli), *[bevel_sd] * len(bevels)]
        names, stated = (*moduli, *bevels), tip_slopes or {}
        slopes = np.array([stated.get(name, 0.0) for name in names])
        of_moduli, of_bevel = slopes[: len(moduli)], slopes[len(moduli) :]
        # g' T g as the mean over the other priors has it: w is 1/2 in the mean, rho 0
        common = 0.5 if len(moduli) > 1 else 1.0
        shared, apart = np.sum(of_moduli) ** 2, np.sum(of_moduli**2)
        implied = modulus_sd**2 * (common * shared + (1 - common) * apart) + bevel_sd**2 * np.sum(of_bevel**2)
        slopes = slopes * math.sqrt(max(0.0, 1 - 1 / implied)) if implied else slopes
        return cls(names, len(moduli), bool(moduli and bevels), np.array(sds), slopes)

    def list_quantities(self) -> tuple[str, ...]:
        """Return the names of m (Q,), then of the hyperparameters of T (S,)."""
        taus = [
            *["spread of the moduli"] * bool(self.moduli),
            *["spread of b"] * (len(self.names) > self.moduli),
        ]
        rest = ["correlation"] * self.correlated + ["common part of the moduli"] * (self.moduli > 1)
        return (*self.names, *taus, *rest)

    @property
    def upper(self) -> Floats:
        """Upper bounds of the hyperparameters: (S,)."""
        ends = [MAX_ATANH_CORRELATION] * self.correlated + [MAX_LOGIT_SHARE] * (self.moduli > 1)
        return np.concatenate([np.log(TAU_RANGE[1] * self.sds), ends])

    @property
    def lower(self) -> Floats:
        """Lower bounds of the hyperparameters: (S,)."""
        return np.concatenate([np.log(TAU_RANGE[0] * self.sds), -self.upper[len(self.sds) :]])

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """Return hyperparameters (B, S) drawn from their prior."""
        drawn = np.empty((0, len(self.lower)))
        while len(drawn) < count:
            some = self._draw_without_tips(max(count, PRIOR_DRAWS_AT_ONCE), rng)
            kept = np.log(rng.uniform(size=len(some))) < self._log_tip_prior(some)
            drawn = np.concatenate([drawn, some[kept]])
        return drawn[:count]

    def _draw_without_tips(self, count: int, rng: np.random.Generator) -> Floats:
        taus = self.sds * np.abs(rng.standard_normal((count, len(self.sds))))
        rho = np.arctanh(rng.uniform(-1, 1, size=(count, int(self.correlated))))
        share = rng.logistic(size=(count, int(self.moduli > 1)))  # the logit of a uniform number
        drawn = np.hstack([np.log(np.maximum(taus, TAU_RANGE[0] * self.sds)), rho, share])
        return np.clip(drawn, self.lower, self.upper)

    def log_prior(self, points: Floats) -> Floats:
        """Return the log prior density (W,) of hyperparameters (W, S), but for a constant."""
        logs, rest = np.split(points, [len(self.sds)], axis=1)
        logs_of_prior = np.sum(logs - 0.5 * (np.exp(logs) / self.sds) ** 2, axis=1)
        if self.correlated:  # the derivative of tanh
            logs_of_prior = logs_of_prior - 2 * np.log(np.cosh(rest[:, 0]))
        if self.moduli > 1:  # the derivative of expit
            logs_of_prior = logs_of_prior + np.log(expit(rest[:, -1])) + np.log(expit(-rest[:, -1]))
        return logs_of_prior + self._log_tip_prior(points)

    def _log_tip_prior(self, points: Floats) -> Floats:
        return -0.5 * np.einsum("p,wpq,q->w", self.tip_slopes, self.covariances(points), self.tip_slopes)

    def covariances(self, points: Floats) -> Floats:
        """Return T (W, Q, Q) of hyperparameters (W, S)."""
        taus, rest = np.exp(points[:, : len(self.sds)]), points[:, len(self.sds) :]
        rho = np.tanh(rest[:, 0]) if self.correlated else np.zeros(len(points))
        share = expit(rest[:, -1]) if self.moduli > 1 else np.ones(len(points))
        modulus = np.arange(len(self.names)) < self.moduli
        both, mixed = np.outer(modulus, modulus), np.not_equal.outer(modulus, modulus)
        correlations = both * share[:, None, None] + mixed * (rho * np.sqrt(share))[:, None, None]
        correlations[:, np.eye(len(self.names), dtype=bool)] = 1.0
        # a row of `each` for each parameter: the tau of the moduli is that of all of them
        scales = taus[:, [0] * self.moduli + list(range(bool(self.moduli), taus.shape[1]))]
        return correlations * scales[:, :, None] * scales[:, None, :]


def make_spread_model(problem: Problem, stated: BetweenSpecimensRecord, theta: Floats) -> SpreadModel:
    """Return the model of the specimens of a problem's insertions, tips differentiated at `theta` (P,)."""
    sds = math.log(stated.modulus_factor), math.log(stated.bevel_factor)
    slopes = differentiate_log_tip(problem, theta) / math.log(stated.tip_factor)
    return SpreadModel.of(problem.parameters, *sds, dict(zip(problem.names, slopes.tolist(), strict=True)))


def differentiate_log_tip(problem: Problem, theta: Floats) -> Floats:
    """Return the derivatives (P,) of the logarithm of the rms tip deflection of a problem's insertions.

    Of a parameter to which others are tied they are of all together; 0 where no insertion has a solution.
    """
    model = PreparedModel(problem.medium, problem.insertions)
    tips = [np.array([insertion.depth]) for insertion in problem.insertions]
    pairs = model.differentiate([problem.values(theta)], problem.parameters, tips)
    points, moves = zip(*pairs, strict=True)
    # along y, in space along z too: (I,), (I, P), or twice as many rows
    tip = np.concatenate([point[0, 0, 1:] for point in points])
    by_theta = np.concatenate([move[0, 0, 1:] for move in moves])
    solved = np.isfinite(tip) & np.isfinite(by_theta).all(axis=1)
    tip, by_theta = tip[solved], by_theta[solved]
    slopes = tip @ by_theta / max(float(tip @ tip), np.finfo(float).tiny)
    for _, column, source in reversed(problem.parameters.free_ties):
        slopes[source] += slopes[column]
    return slopes


#: number of means whose densities of all kernels are held at once
MEANS_AT_ONCE = 100


@dataclass(frozen=True)
class Specimen:
    """The posterior of one specimen as a mixture of equally weighted Gaussian kernels."""

    centres: Floats  #: (K, Q)
    kernel: Floats  #: (Q, Q) their covariance

    @cached_property
    def mean(self) -> Floats:
        """Mean of the posterior: (Q,)."""
        return self.centres.mean(axis=0)

    @property
    def covariance(self) -> Floats:
        """Covariance of the posterior: (Q, Q)."""
        return np.atleast_2d(np.cov(self.centres.T, bias=True)) + self.kernel

    @cached_property
    def _about_mean(self) -> tuple[Floats, Floats]:
        """The centres (K, Q) about their mean, and the products (K, Q^2) of their coordinates."""
        away = self.centres - self.mean
        return away, (away[:, :, None] * away[:, None, :]).reshape(len(away), -1)

    def log_densities(self, means: Floats, covariances: Floats) -> Floats:
        """Return ln N( c_k; m, H + T ) (W, K) of means (W, Q) and covariances T (W, Q, Q).

        The squared distances are products of matrices: residuals (W, Q, K) would take ten times as long.
        """
        centres, products = self._about_mean
        whole = self.kernel + covariances
        precisions = np.linalg.inv(whole)
        away = means - self.mean
        pulls = (precisions @ away[:, :, None])[..., 0]
        logs = pulls @ centres.T - 0.5 * precisions.reshape(len(means), -1) @ products.T
        constants = np.sum(pulls * away, axis=1) + np.linalg.slogdet(whole)[1]
        logs -= 0.5 * constants[:, None]
        return logs


def make_specimen(draws: Floats) -> Specimen:
    """Return the kernels of posterior draws (K, Q); their width follows Silverman's rule."""
    count, p = draws.shape
    width = (4 / (p + 2)) ** (1 / (p + 4)) * count ** (-1 / (p + 4))
    part = width**2 / (1 + width**2)  # of the covariance, that the kernels have
    mean = draws.mean(axis=0)
    covariance = np.atleast_2d(np.cov(draws.T, bias=True))
    return Specimen(mean + np.sqrt(1 - part) * (draws - mean), part * covariance)


#: number of draws that stand for the posterior of a specimen. With 100, the SD of the mean of ln mu1 was 0.24
#: to 0.26 for the example of docs/start.md, with one insertion in each specimen; with 400 and more, 0.29 to
#: 0.33.
KERNELS_PER_SPECIMEN = 1000

#: efforts of importance sampling of a population, tried in turn
SPREAD_EFFORTS = (Effort(draws=1000, min_ess=2000.0), Effort(draws=3000, min_ess=1000.0))


@dataclass(frozen=True)
class Population:
    """The posterior of mean m and covariance T over specimens, given some of them."""

    specimens: tuple[Specimen, ...]
    bounds: tuple[Floats, Floats]  #: (Q,), (Q,) of m
    model: SpreadModel
    prior: Prior  #: what is stated of m

    @property
    def lower(self) -> Floats:
        """Lower bounds of m and the hyperparameters of T: (Q + S,)."""
        return np.concatenate([self.bounds[0], self.model.lower])

    @property
    def upper(self) -> Floats:
        """Upper bounds of m and the hyperparameters of T: (Q + S,)."""
        return np.concatenate([self.bounds[1], self.model.upper])

    def split(self, points: Floats) -> tuple[Floats, Floats]:
        """Return m (W, Q) and T (W, Q, Q) of points (W, Q + S)."""
        means, spread = np.split(points, [len(self.bounds[0])], axis=1)
        return means, self.model.covariances(spread)

    def log_density(self, points: Floats) -> Floats:
        """Return the log posterior densities (W,) of points (W, Q + S), not normalised; -inf outside."""
        density = np.full(len(points), -np.inf)
        inside = np.flatnonzero(np.all((points >= self.lower) & (points <= self.upper), axis=1))
        for start in range(0, len(inside), MEANS_AT_ONCE):
            some = inside[start : start + MEANS_AT_ONCE]
            means, covariances = self.split(points[some])
            logs = self.model.log_prior(points[some, means.shape[1] :]) + self.log_stated(means)
            for specimen in self.specimens:
                kernels = specimen.log_densities(means, covariances)
                logs = logs + log_sum_exp(kernels, axis=1) - np.log(kernels.shape[1])
            density[some] = logs
        return density

    def log_stated(self, points: Floats) -> Floats:
        """Return the log density (W,) of what is stated of m, at (W, Q), but for a constant."""
        return self.prior.log_marginals(self.model.names, points)

    def posterior(self, rng: np.random.Generator) -> WeightedDraws:
        """Return weighted draws of m and the hyperparameters of T: (N, Q + S)."""

        def height(points: Floats) -> float:
            return -float(self.log_density(points[None])[0])

        bounds = list(zip(self.lower.tolist(), self.upper.tolist(), strict=True))
        optimum = minimize(height, self._guess(), method="Nelder-Mead", bounds=bounds)
        information = difference_information(self.log_density, optimum.x)
        about = approximate_by_information(information, optimum.x, self.lower, self.upper)
        return sample_by_importance(self.log_density, [about], (self.lower, self.upper), rng, SPREAD_EFFORTS)

    def _guess(self) -> Floats:
        """Return where the search begins, (Q + S,), by the method of moments."""
        model, means = self.model, np.array([specimen.mean for specimen in self.specimens])
        within = np.mean([np.diag(specimen.covariance) for specimen in self.specimens], axis=0)
        variances = means.var(axis=0) - within
        first = [0] * bool(model.moduli) + list(range(model.moduli, len(model.names)))
        moments = np.array([variances[k] for k in first])
        if model.moduli:
            moments[0] = np.mean(variances[: model.moduli])
        taus = np.sqrt(np.maximum(moments, 0.01 * model.sds**2))  # not exactly 0, a bound
        rest = np.zeros(len(model.lower) - len(taus))
        if model.correlated and len(means) > 2:
            common = means[:, : model.moduli].mean(axis=1)
            with np.errstate(invalid="ignore"):  # equal means have no correlation
                rest[0] = np.arctanh(0.9 * np.corrcoef(common, means[:, model.moduli])[0, 1])
        start = np.concatenate([means.mean(axis=0), np.log(taus), np.nan_to_num(rest)])
        return np.clip(start, self.lower, self.upper)


#: goes on from weighted draws of a density whose quantities have names: by an ensemble of walkers
PopulationSampler = Callable[[LogDensityFunction, tuple[str, ...], WeightedDraws], Posterior | None]


@dataclass(frozen=True)
class PopulationDraws:
    """Joint draws of the parameters (B, P) in each specimen, in their mean and in a new one."""

    tuned: Mapping[str, Floats]  #: in each specimen that was fitted, by its name
    mean: Floats  #: the mean of the population; of a single specimen, those in it
    new: Floats  #: in a further specimen
    covariances: Floats  #: T (B, Q, Q)
    faults: tuple[str, ...] = ()  #: why the draws do not represent the posterior; empty if they do
    #: of the weights of several specimens' population, or of the ensemble of walkers that followed
    pareto_k: float = math.nan
    effective_sample_size: float = math.nan
    source: Source = "importance"

    @property
    def rms(self) -> Floats:
        """Root mean square (Q,) of the standard deviations between specimens."""
        return np.sqrt(np.mean(np.diagonal(self.covariances, axis1=1, axis2=2), axis=0))

    @property
    def correlation(self) -> float:
        """Median correlation of the first parameter (ln mu) with the last (ln b) between specimens."""
        variances = np.diagonal(self.covariances, axis1=1, axis2=2)
        with np.errstate(invalid="ignore"):
            correlations = self.covariances[:, 0, -1] / np.sqrt(variances[:, 0] * variances[:, -1])
        return float(np.median(correlations))


def make_population(parameters: Parameters, model: SpreadModel, posteriors: Sequence[Floats]) -> Population:
    """Return the population of specimens whose own posteriors are known by draws (K, P) each.

    What is stated of a parameter counts once, of m.
    """
    columns = [parameters.free.index(name) for name in model.names]
    bounds = parameters.lower[columns], parameters.upper[columns]
    population = Population((), bounds, model, parameters.prior)
    specimens = []
    for thetas in posteriors:
        counted = population.log_stated(thetas[:, columns])
        weights = np.exp(counted.min() - counted)
        # systematic, so that without a stated prior the draws are taken evenly
        places = (np.arange(KERNELS_PER_SPECIMEN) + 0.5) / KERNELS_PER_SPECIMEN * weights.sum()
        specimens.append(make_specimen(thetas[np.searchsorted(np.cumsum(weights), places)][:, columns]))
    return replace(population, specimens=tuple(specimens))


def draw_population(
    parameters: Parameters,
    model: SpreadModel,
    posteriors: Mapping[str, Floats],
    count: int,
    rng: np.random.Generator,
    sampler: PopulationSampler | None = None,
) -> PopulationDraws:
    """Draw from the population of specimens whose own posteriors are known by draws (K, P) each.

    A single specimen has `count` draws, and T is drawn from its prior. Of several, m and T are weighted draws
    by importance, and those of the `sampler` that goes on from there, unless these alone are certified.
    """
    columns = [parameters.free.index(name) for name in model.names]
    if len(posteriors) == 1:
        (mean,) = posteriors.values()
        covariances = model.covariances(model.draw(len(mean), rng))
        new = draw_specimens(parameters, model, mean, 2 * covariances, rng)
        return PopulationDraws(posteriors, mean, new, covariances)
    population = make_population(parameters, model, list(posteriors.values()))
    draws = population.posterior(rng)
    points, ess = draws.thetas[resample(draws, count, rng)], draws.effective_sample_size
    source: Source = "importance"
    of = f"the population of {len(posteriors)} specimens"
    weak = f"{of} is not certified (Pareto k {draws.k:.2f}, effective sample size {ess:.0f})"
    faults: tuple[str, ...] = () if draws.certified else (weak,)
    chains = None if sampler is None else sampler(population.log_density, model.list_quantities(), draws)
    if chains is not None and not (chains.faults and draws.certified):
        points, ess, source = thin_chains(chains, count), float(chains.ess.min()), "posterior"
        points = np.resize(
            points, (count, points.shape[1])
        )  # repeated where a chain that has not converged has fewer
        faults = tuple(f"{of}: {fault}" for fault in chains.faults)
    means, covariances = population.split(points)
    tuned = {}
    for (name, thetas), specimen in zip(posteriors.items(), population.specimens, strict=True):
        some = thetas[:, columns]
        logs = replace(specimen, centres=some).log_densities(means, covariances)
        # the largest of these: drawn by weight
        keys = logs - population.log_stated(some) + rng.gumbel(size=logs.shape)
        tuned[name] = thetas[np.argmax(keys, axis=1)]
    # What does not vary is as in one of them, another for each draw: a mean over specimens would be narrower
    # also where nothing is known.
    chosen = np.array(list(tuned.values()))[rng.integers(len(tuned), size=count), np.arange(count)]
    mean = chosen.copy()
    mean[:, columns] = means
    for _, column, source_column in parameters.free_ties:
        mean[:, column] = mean[:, source_column] + chosen[:, column] - chosen[:, source_column]
    new = draw_specimens(parameters, model, mean, covariances, rng)
    return PopulationDraws(tuned, mean, new, covariances, faults, draws.k, ess, source)


def draw_specimens(
    parameters: Parameters,
    model: SpreadModel,
    thetas: Floats,
    covariances: Floats,
    rng: np.random.Generator,
) -> Floats:
    """Return specimens (B, P) that lie about `thetas` (B, P) with covariances (B, Q, Q).

    A specimen outside the medium's bounds is drawn again.
    """
    columns = [parameters.free.index(name) for name in model.names]
    sizes, axes = np.linalg.eigh(covariances)  # some may be singular
    roots = axes * np.sqrt(np.maximum(sizes, 0.0))[:, None, :]
    drawn, left = thetas.copy(), np.arange(len(thetas))
    for _ in range(MAX_REDRAWS):
        some = thetas[left].copy()
        some[:, columns] += np.einsum(
            "bpq,bq->bp", roots[left], rng.standard_normal((len(left), len(columns)))
        )
        for tie, column, source in parameters.free_ties:
            ratio = math.log(tie.factor) + math.log(tie.spread) * rng.standard_normal(len(some))
            some[:, column] = some[:, source] + ratio
        drawn[left] = some
        outside = (some < parameters.lower) | (some > parameters.upper)
        left = left[np.any(outside, axis=1)]
        if not len(left):
            break
    return np.clip(drawn, parameters.lower, parameters.upper)
