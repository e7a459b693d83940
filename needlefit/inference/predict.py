"""Draw parameters from a posterior or a prior, and the predictive distribution of a held-out needle.

Each draw gives one curve, and the Gaussian about it has the errors of pose and measurement. Quantities of
this mixture have closed forms: with weights 1 / B, means m_b and one deviation s,

    F(y) = mean_b Phi((y - m_b) / s),
    CRPS(y) = mean_b A(y - m_b, s) - mean_bc A(m_b - m_c, sqrt(2) s) / 2,
    A(m, s) = 2 s phi(m / s) + m (2 Phi(m / s) - 1)

(E. P. Grimit, T. Gneiting, V. J. Berrocal, N. A. Johnson, Q. J. R. Meteorol. Soc. 132 (2006) 2925, eq. 5).

Proportions have Wilson's interval of as many trials as there are groups of repeats.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import scipy
from numpy.typing import ArrayLike
from scipy.special import ndtr

from needlefit.arrays import Floats
from needlefit.grouping import group_values
from needlefit.inference.forward_model import PreparedModel
from needlefit.inference.identifiability.directions import NORMAL_95_HALF_WIDTH_SD
from needlefit.inference.identifiability.information import find_bounds
from needlefit.inference.likelihood.observations import OBSERVATIONS, make_observation
from needlefit.inference.parameter_names import HYPERPARAMETERS, NOISE_SCALE, to_coordinate
from needlefit.inference.parameters import Parameters, Values
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.posterior import Posterior, thin_chains

INTERVAL_PROBABILITIES = (0.50, 0.95)  #: probabilities of the central intervals that are reported
#: draws, at most, whose pairs show how much the Gaussians add to the distances between draws
PAIR_DRAWS = 125
BRACKET_SD = 9.0  #: deviations beyond which a Gaussian has next to nothing: 1e-19 on each side
TINY_MM = 1e-9  #: the bracket of a quantile has at least this width where draws leave nothing open
#: of the search for a quantile, whose error after a step is about the square of that step
MAX_STEPS, LAST_STEP_SD = 100, 1e-5


@dataclass(frozen=True)
class PredictiveMixture:
    """A mixture of equally weighted Gaussians with one standard deviation, for K quantities at once."""

    means: Floats  #: (B, K) one row a draw
    sd: Floats  #: (K,) 0 where a draw leaves nothing open


def cdf(mixture: PredictiveMixture, places: ArrayLike) -> Floats:
    """Return the probability (K,) of values up to `at` (K,)."""
    values = np.asarray(places, dtype=np.float64)
    away = values - mixture.means  # (B, K)
    with np.errstate(divide="ignore", invalid="ignore"):
        scaled = away / mixture.sd
    if not mixture.sd.all():
        # with a deviation of 0 the CDF is a step, and 0 / 0 at the step itself counts as the middle
        scaled = np.where(away == 0, 0.0, scaled)
    return scipy.special.ndtr(scaled, out=scaled).mean(axis=0)


def quantile(mixture: PredictiveMixture, p: ArrayLike) -> Floats:
    """Return the quantiles (..., K) of probabilities `p` (...), to 1e-9 of a deviation.

    By Newton's steps of all at once, and halves of the bracket where a step would leave it.
    """
    sd, count, beyond = mixture.sd, len(mixture.means), BRACKET_SD * mixture.sd + TINY_MM
    wanted, ranked = np.asarray(p, dtype=np.float64)[..., None], np.sort(mixture.means, axis=0)
    # the quantile lies between two draws of the ranks about p B, within the width of their Gaussians
    first, last = np.floor(wanted[..., 0] * count) - 1, np.ceil(wanted[..., 0] * count)
    low, high = (ranked[np.clip(rank, 0, count - 1).astype(np.int64)] for rank in (first, last))
    middle, low, high = (low + high) / 2, low - beyond, high + beyond
    means = mixture.means.reshape(count, *(1,) * (wanted.ndim - 1), -1)
    for _ in range(MAX_STEPS):
        excess = cdf(PredictiveMixture(means, sd), middle) - wanted
        low, high = np.where(excess < 0, middle, low), np.where(excess < 0, high, middle)
        with np.errstate(all="ignore"):  # no density where a draw leaves nothing open, or far from all draws
            density = np.exp(-(((middle - means) / sd) ** 2) / 2).mean(axis=0) / (math.sqrt(2 * math.pi) * sd)
            before, middle = middle, middle - excess / density
        middle = np.where((low <= middle) & (middle <= high), middle, (low + high) / 2)
        if (np.abs(middle - before) <= LAST_STEP_SD * sd + TINY_MM**2).all():
            break
    return middle


def interval(mixture: PredictiveMixture, level: float) -> tuple[Floats, Floats]:
    """Return the ends (K,), (K,) of the central interval of probability `level`."""
    low, high = quantile(mixture, [(1 - level) / 2, (1 + level) / 2])
    return low, high


def estimate_end_errors(draws: Floats, level: float, independent: float | None = None) -> Floats:
    """Return the Monte Carlo standard errors (2, K) of the ends of the central interval of draws (B, K).

    An end is the quantile of a probability p that draws give with a standard error e: it errs by half the
    distance between the quantiles of p - e and p + e. `independent`: number of independent draws, of chains.
    """
    p = np.array([(1 - level) / 2, (1 + level) / 2])
    e = np.sqrt(p * (1 - p) / (independent or len(draws)))
    low, high = (np.quantile(draws, np.clip(probability, 0.0, 1.0), axis=0) for probability in (p - e, p + e))
    errors: Floats = (high - low) / 2
    return errors


def crps(mixture: PredictiveMixture, measured: ArrayLike) -> Floats:
    """Return the continuous ranked probability score (K,) of the values `measured` (K,), in their unit.

    For a point prediction it is the absolute error; smaller is better.
    """
    values = np.asarray(measured, dtype=np.float64)
    off = _mean_absolute(values - mixture.means, mixture.sd).mean(axis=0)
    ranked, count = np.sort(mixture.means, axis=0), len(mixture.means)
    # the mean distance of all pairs of draws: the draw of rank b is above b others and below the rest
    between = 2 * (2 * np.arange(count) - count + 1) @ ranked / count**2
    # what the Gaussians add to it is at most their own width, so some of the draws show it
    step, sd = -(-count // PAIR_DRAWS), np.sqrt(2) * mixture.sd
    some = ranked[step // 2 :: step]
    first, second = np.triu_indices(len(some), 1)
    apart = [m[second] - m[first] for m in some.T]
    near = [m[m < BRACKET_SD * s] / s for m, s in zip(apart, sd, strict=True)]  # farther ones add nothing
    # of a Gaussian x about z deviations: the mean of |x|, less z
    added = 2 * sd * [_density(z).sum() - z @ scipy.special.ndtr(-z) for z in near]
    # each pair of different draws counts twice, and each draw beside itself
    between = between + (2 * added / len(some) + _mean_absolute(np.zeros(len(sd)), sd)) / len(some)
    return off - between / 2


MEDIAN_STEPS = 60  #: of the search for a geometric median; each leaves about half of what is missing


def find_geometric_median(points: Floats) -> Floats:
    """Return the points (K, d) whose mean distance from `points` (B, K, d) is least (E. Weiszfeld, 1937)."""
    geometric_median: Floats = np.median(points, axis=0)
    for _ in range(MEDIAN_STEPS if points.shape[-1] > 1 else 0):  # of numbers that is their median
        weights = 1 / np.maximum(np.linalg.norm(points - geometric_median, axis=-1, keepdims=True), TINY_MM)
        geometric_median = (weights * points).sum(axis=0) / weights.sum(axis=0)
    return geometric_median


def _mean_absolute(mean: Floats, sd: Floats) -> Floats:
    """Return the mean of |x| for Gaussians x of these means and deviations."""
    with np.errstate(divide="ignore", invalid="ignore"):
        # a deviation of 0 is a point mass: its mean absolute value is |mean|
        z = np.where(sd > 0, mean / sd, 0.0)
    return np.where(sd > 0, 2 * sd * _density(z) + mean * (2 * scipy.special.ndtr(z) - 1), np.abs(mean))


def _density(z: Floats) -> Floats:
    """Return the density of the standard normal distribution."""
    return np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi)


Source = Literal["posterior", "importance"]


@dataclass(frozen=True)
class Draws:
    """Draws of theta (B, P) from a posterior, by MCMC or by importance sampling.

    `faults` says why it has not converged, or is not certified; it is empty if it is. `pareto_k` is that of
    importance sampling, also where MCMC followed, NaN without it;
    `effective_sample_size` is of the weights, or the smallest of the parameters and the log posterior of all
    chains, of which these draws are a part.
    """

    thetas: Floats
    source: Source
    faults: tuple[str, ...] = ()
    pareto_k: float = math.nan
    effective_sample_size: float = math.nan
    #: theta (P,) of the posterior mode, by which a needle is predicted; draws are of what it may be besides
    mode: Floats | None = None

    @property
    def certified(self) -> Floats | None:
        """The draws of theta (B, P) if they represent the posterior, else None."""
        return None if self.faults or not self.thetas.size else self.thetas

    def describe(self) -> dict[str, str | float | bool]:
        """Return by column how the draws were made, and whether they represent the posterior."""
        return {
            "draw_source": self.source,
            "pareto_k": self.pareto_k,
            "ess": self.effective_sample_size,
            "certified": not self.faults,
        }


def thin_posterior(
    posterior: Posterior, parameters: Parameters, count: int, pareto_k: float = math.nan
) -> Draws:
    """Return `count` draws of a sampled posterior, evenly spread over all chains and steps.

    `pareto_k` is that of the importance sampling before.

    Raises KeyError if the posterior is of other parameters.
    """
    sets = (
        dict(zip(posterior.names, values, strict=True)) for values in thin_chains(posterior, count).tolist()
    )
    thetas = np.array([parameters.theta(values) for values in sets])
    return Draws(thetas, "posterior", posterior.faults, pareto_k, float(posterior.ess.min()))


def rms_noise_scale(draws: Draws, parameters: Parameters, stated: float | str) -> float:
    """Return the factor on the deviations of the points' noise: the stated one, or the draws' rms."""
    if NOISE_SCALE not in parameters.free:
        return 1.0 if isinstance(stated, str) else stated
    scales = [parameters.values(theta)[NOISE_SCALE] for theta in draws.thetas]
    return float(np.sqrt(np.mean(np.square(scales))))


def draw_from_prior(parameters: Parameters, count: int, rng: np.random.Generator) -> Floats:
    """Return `count` draws (B, P) of the prior: flat within the bounds, times what is stated."""
    lower, upper, names = parameters.lower, parameters.upper, parameters.free
    gamma = {names.index(row.name): row for row in parameters.prior.gamma if row.name in names}
    slopes = parameters.prior.linear_slopes(names)  # (R, P)
    rows = np.flatnonzero(slopes.any(axis=1))  # without ties of what is fixed
    off = parameters.prior.residuals([parameters.values(0.5 * (lower + upper))])[0, rows]
    slopes = slopes[rows]
    # the linear residuals are off + slopes @ (theta - middle): each is solved for one coordinate, while the
    # others are drawn flat, or from their gamma prior
    linear = np.array([k for k in range(len(names)) if k not in gamma], dtype=int)
    solved = linear[scipy.linalg.qr(slopes[:, linear], mode="r", pivoting=True)[-1][: len(rows)]]
    others = np.setdiff1d(np.arange(len(names)), solved)
    inverse = np.linalg.inv(slopes[:, solved])
    drawn = np.empty((0, len(lower)))
    while len(drawn) < count:
        away = rng.uniform(-0.5, 0.5, size=(count, len(lower))) * (upper - lower)
        normal = rng.standard_normal((count, len(rows)))
        for column, row in gamma.items():
            away[:, column] = row.draw(count, rng) - 0.5 * (lower + upper)[column]
        away[:, solved] = (normal - off - away[:, others] @ slopes[:, others].T) @ inverse.T
        thetas = 0.5 * (lower + upper) + away
        # rejection keeps the Gaussian's shape; clipping would pile draws up at the bounds
        inside = np.all((thetas >= lower) & (thetas <= upper), axis=1)
        drawn = np.concatenate([drawn, thetas[inside]])
    return drawn[:count]


@dataclass(frozen=True)
class Proportion:
    """A proportion: `hits` of `trials`, in `groups` groups of repeats, with its 95 % interval."""

    hits: int
    trials: int
    groups: int
    rate: float  #: mean over groups of the share in each
    low: float
    high: float


def estimate_proportion(hits: Sequence[bool], groups: Sequence[str]) -> Proportion:
    """Estimate a proportion from trials; in the interval every group of repeats has the same weight."""
    by_group = group_values(zip(groups, map(bool, hits), strict=True))
    rate = float(np.mean([np.mean(members) for members in by_group.values()]))
    # as many trials as groups: repeats in one specimen are not independent
    low, high = wilson_interval(rate, len(by_group))
    return Proportion(sum(map(bool, hits)), len(hits), len(by_group), rate, low, high)


def wilson_interval(rate: float, trials: float) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a probability, observed `rate` in `trials` (E. B. Wilson, 1927)."""
    z2 = float(scipy.special.ndtri(0.975)) ** 2
    centre = (rate + z2 / (2 * trials)) / (1 + z2 / trials)
    half = math.sqrt(z2 * (rate * (1 - rate) / trials + z2 / (4 * trials**2))) / (1 + z2 / trials)
    return max(0.0, centre - half), min(1.0, centre + half)


# ---- the point of a predictive distribution that is reported: the posterior mode's, or the median
#
# The needle of the mode is closer on average (`studies/point_predictions.py`). It is no point of the
# distribution where the posterior rises up to a bound, whose value someone stated, or where next to no draw
# predicts it: then the median of the draws is reported.

#: mm: half of the last digit that is printed of a needle. What moves it by less does not move it, and outside
#: an interval by less it is inside
PRINTED_MM = 0.005


@dataclass(frozen=True)
class PointPrediction:
    """Which point is reported, and why it is not the mode's."""

    mode_fault: Literal["none", "at_bound", "outside"] = "none"
    #: by parameter of the mode that lies at a bound and moves the needle: "lower" or "upper"
    at_bound: Mapping[str, str] = field(default_factory=dict)

    @property
    def is_median(self) -> bool:
        """Whether the median of the draws is reported."""
        return self.mode_fault != "none"

    def take(self, mode: Floats, draws: Floats) -> Floats:
        """Return the point (...), of what the mode predicts (...) and the draws (B, ...)."""
        median: Floats = np.median(draws, axis=0)
        return median if self.is_median else mode


def choose_point(
    problem: Problem, mode: Floats, draws: Floats, predict: Callable[[Floats], Floats]
) -> PointPrediction:
    """Choose the point by the mode, theta (P,), and what draws predict (B, ...), mm.

    `predict` returns what a theta predicts (...), mm, NaN where it has no solution.
    """
    predicted, parameters = predict(mode), problem.parameters
    at_bound = dict[str, str]()
    for k, (name, end) in enumerate(zip(parameters.free, find_bounds(problem, mode), strict=True)):
        if not end or name in (*HYPERPARAMETERS, *parameters.held):
            continue
        inside = mode.copy()
        inside[k] = (problem.lower[k] + problem.upper[k]) / 2
        if not np.abs(predict(inside) - predicted).max() < PRINTED_MM:  # NaN: it is not known to move nothing
            at_bound[name] = end
    if at_bound:
        return PointPrediction("at_bound", at_bound)
    level = max(INTERVAL_PROBABILITIES)
    low, high = np.quantile(draws, [(1 - level) / 2, (1 + level) / 2], axis=0)
    within = (low - PRINTED_MM <= predicted) & (predicted <= high + PRINTED_MM)
    return PointPrediction("none" if within.all() else "outside")


# ---- parameters whose posterior may be their prior, such as alpha: held in searches, drawn from the prior
#
# A search holds each at the centre of its prior. While the central 95 % of the prior move no measured point
# by a tenth of the standard deviation of its error, the posterior of the parameter is its prior. Else it is
# searched and sampled as all others are.

MAX_HIDDEN_SHIFT = 0.1  #: standard deviations of its error by which a held parameter may move a point
#: of a likelihood: points are compared as they are stored, of needles as deep and bevels as large as stated
MEASURED_POINTS = {"depths": "fixed", "bevel_spread": 0.0, "measurement": "points"}


@dataclass(frozen=True)
class PriorShift:
    """How far the central 95 % of the prior of a parameter move the needles that are fitted to, at most."""

    tip_mm: float  #: any tip
    in_noise: float  #: any point, in standard deviations of its error; infinite where a solve fails

    @property
    def is_hidden(self) -> bool:
        """Whether the posterior of the parameter is its prior."""
        return self.in_noise < MAX_HIDDEN_SHIFT


def central_range(parameters: Parameters, name: str) -> tuple[float, float]:
    """Return the ends of the central 95 % of the prior of a held parameter, within its bounds."""
    (mean, sd), (low, high) = parameters.prior.marginals[name], parameters.bounds[name]
    reach = NORMAL_95_HALF_WIDTH_SD * sd
    return max(low, mean - reach), min(high, mean + reach)


def measure_shifts(problem: Problem, thetas: Floats) -> dict[str, PriorShift]:
    """Return by how much each held parameter moves the needles, at most over `thetas` (N, P).

    From the centre of its prior to either end, all other parameters as they are. A theta without a solution
    at the centre is left out.
    """
    parameters, sets = problem.parameters, list[Values]()
    for theta in parameters.extend(parameters.restrict(thetas)):
        centre = problem.values(theta)
        sets.append(centre)
        for name in parameters.held:
            for end in central_range(parameters, name):
                moved = theta.copy()
                moved[parameters.free.index(name)] = to_coordinate(name, end)
                sets.append(problem.values(moved))
    tips, by_noise = _compare_ends(problem, sets, 1 + 2 * len(parameters.held))  # (N, H, 2) each
    solved = np.isfinite(by_noise).any(axis=(1, 2))
    shifts = {}
    for number, name in enumerate(parameters.held):
        moved_tips, moved = (part[solved, number].ravel() for part in (tips, by_noise))
        in_noise = float(np.max(moved, initial=0.0))  # NaN where a solve fails
        tip_mm = float(np.nanmax(moved_tips, initial=0.0))
        shifts[name] = PriorShift(tip_mm, math.inf if math.isnan(in_noise) else in_noise)
    return shifts


def _compare_ends(problem: Problem, sets: Sequence[Values], size: int) -> tuple[Floats, Floats]:
    """Return how far tips, mm, and points, in SDs of their errors, lie from those of the first set.

    The largest over all insertions, (N, H, 2): of N times `size` sets, in which the ends of H parameters
    follow the centre. NaN where a solve fails.
    """
    scales = np.array([values.get(NOISE_SCALE, problem.density.scale) for values in sets[::size]])
    likelihood = problem.likelihood.model_copy(update=MEASURED_POINTS)
    observations = []
    for insertion in problem.insertions:
        data, alone = OBSERVATIONS[insertion.observation].take_alone(problem.dataset, insertion)
        observations.append(make_observation(data, alone, problem.noise, likelihood, respond=problem.respond))
    model = PreparedModel(problem.medium, problem.insertions)
    ends = model.read_points(
        sets, [np.append(observation.nodes.s[0], observation.insertion.depth) for observation in observations]
    )
    tips, by_noise = [], []
    for observation, points in zip(observations, ends, strict=True):
        groups = points.reshape(-1, size, *points.shape[1:])  # (N, 1 + 2 H, K, 3)
        away = groups[:, 1:] - groups[:, :1]
        tips.append(np.linalg.norm(away[..., -1, :], axis=-1))
        shifts = observation.read(away[..., :-1, :])  # (N, 2 H, K), in space (N, 2 H, 2 K)
        sds = np.sqrt([np.diag(observation.covariance(scale)) for scale in scales])[:, None]
        relative = np.divide(shifts, sds, out=np.zeros_like(shifts), where=shifts != 0)
        by_noise.append(np.max(np.abs(relative), axis=-1))
    shape = (len(scales), -1, 2)
    return np.max(tips, axis=0).reshape(shape), np.max(by_noise, axis=0).reshape(shape)


def draw_held(parameters: Parameters, thetas: Floats, rng: np.random.Generator) -> Floats:
    """Return draws (N, P) of all free parameters, from draws (N, S) of those that are searched.

    Those held are independent draws of their prior.
    """
    if not parameters.held:
        return thetas
    columns = [parameters.free.index(name) for name in parameters.held]
    return parameters.extend(thetas, draw_from_prior(parameters, len(thetas), rng)[:, columns])


def log_prior_integral(parameters: Parameters) -> float:
    """Return the logarithm of the integral of the prior of all held parameters, 1 at its centre."""
    total, marginals = 0.0, parameters.prior.marginals
    for name in parameters.held:
        (mean, sd), bounds = marginals[name], parameters.bounds[name]
        low, high = ((to_coordinate(name, end) - mean) / sd for end in bounds)
        total += math.log(math.sqrt(2 * math.pi) * sd * (ndtr(high) - ndtr(low)))
    return total
