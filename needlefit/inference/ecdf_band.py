"""The band that the ECDF of equally likely ranks leaves by chance.

N ranks, each one of K equally likely places. How many lie below each place is a sum of N independent Poisson
numbers, given their total; so the probability that all sums keep within limits is exact, by one convolution a
place, and the limits of equal pointwise probability that keep it at what is wanted are found by bisection
(T. Saeilynoja, P.-C. Buerkner, A. Vehtari, Stat. Comput. 32 (2022) 32, whose recursion sums binomials).
"""

import math

import numpy as np
import scipy
from numpy.typing import NDArray

from needlefit.arrays import Floats

Counts = NDArray[np.int64]

BISECTIONS = 40  #: number of bisections of the bracket of the pointwise probability, in its logarithm


def _tabulate_cdf(trials: int, probability: Floats) -> Floats:
    """Return the probability (..., N + 1) of at most 0, 1, ..., N events of this probability (...)."""
    counts = np.arange(trials + 1)
    return np.asarray(scipy.special.bdtr(counts, trials, probability[..., None]), dtype=np.float64)


def _cut_tails(cdf: Floats, error: float) -> tuple[Counts, Counts]:
    """Return the quantiles (...) at half the error from both ends, of `_tabulate_cdf`."""
    low, high = (np.sum(cdf < level, axis=-1) for level in (error / 2, 1 - error / 2))
    return low, high


def ecdf_band(trials: int, places: int, error: float) -> tuple[Counts, Counts]:
    """Return the band of ranks (K - 1,) that holds at all places together, up to the probability `error`."""
    cdf = _tabulate_cdf(trials, np.arange(1, places) / places)
    narrow, wide = math.log(error), math.log(error / places)  # by Bonferroni the second is wide enough
    for _ in range(BISECTIONS):
        middle = 0.5 * (narrow + wide)
        if probability_inside(trials, *_cut_tails(cdf, math.exp(middle))) >= 1 - error:
            wide = middle
        else:
            narrow = middle
    return _cut_tails(cdf, math.exp(wide))


def probability_inside(trials: int, low: Counts, high: Counts) -> float:
    """Return the probability that uniform ranks stay within limits (K - 1,) at every place."""
    # counts between neighbouring places are independent Poisson numbers, given that they add up to all
    step = _poisson(np.arange(trials + 1), trials / (len(low) + 1))
    alive, first = np.ones(1), 0  # probabilities of sums first, first + 1, ...
    for least, most in zip(low.tolist(), high.tolist(), strict=True):
        # convolve, then cut to the limits: probability outside them is lost and never returns
        summed = np.convolve(alive, step)
        start = max(least, first)
        alive, first = summed[start - first : most - first + 1], start
    last = step[trials - first - np.arange(len(alive))]
    return float(alive @ last / _poisson(np.array(trials), trials))


def _poisson(counts: Counts, mean: float) -> Floats:
    return np.asarray(np.exp(scipy.special.xlogy(counts, mean) - scipy.special.gammaln(counts + 1) - mean))
