"""The predictive distribution of a held-out needle: a mixture of Gaussians, and its scores.

Each draw gives one curve, and the Gaussian about it has the errors of pose and measurement. Quantities of
this mixture have closed forms: with weights 1 / B, means m_b and one deviation s,

    F(y) = mean_b Phi((y - m_b) / s),
    CRPS(y) = mean_b A(y - m_b, s) - mean_bc A(m_b - m_c, sqrt(2) s) / 2,
    A(m, s) = 2 s phi(m / s) + m (2 Phi(m / s) - 1)

(E. P. Grimit, T. Gneiting, V. J. Berrocal, N. A. Johnson, Q. J. R. Meteorol. Soc. 132 (2006) 2925, eq. 5).
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike

from needlefit.arrays import Floats

INTERVAL_PROBABILITIES = (0.50, 0.95)  #: probabilities of the central intervals that are reported
#: largest number of draws whose pairs show how much the Gaussians add to the distances between draws
PAIR_DRAWS = 125
BRACKET_SD = 9.0  #: number of deviations beyond which a Gaussian has next to nothing: 1e-19 on each side
TINY_MM = 1e-9  #: smallest half width (mm) of the bracket of a quantile, where draws leave nothing open
#: largest number of steps of the search for a quantile, and the last step in SDs: the error after a step is
#: about its square
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


MEDIAN_STEPS = 60  #: number of steps of the search for a geometric median; each about halves the error


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
