"""Between which counts ranks stay if they are uniform: of an ECDF as a whole, and of central intervals.

N ranks, each one of K equally likely places. How many lie below each place is a sum of N independent Poisson
numbers, given their total; so the probability that all sums keep within limits is exact, by one convolution a
place, and the limits of equal pointwise probability that keep it at what is wanted are found by bisection
(T. Saeilynoja, P.-C. Buerkner, A. Vehtari, Stat. Comput. 32 (2022) 32, whose recursion sums binomials).
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom, poisson

Floats = NDArray[np.float64]
Counts = NDArray[np.int64]

HALVINGS = 40
"""Of the bracket of the pointwise probability, in its logarithm."""


def limits(replicates: int, probability: float | Floats, error: float) -> tuple[Counts, Counts]:
    """Return least and most of `replicates` that fall where `probability` says, but for `error` at both ends.

    Each end is passed with half the error at most: exact, of the binomial distribution.
    """
    low = np.asarray(binom.ppf(error / 2, replicates, probability), dtype=np.int64)
    high = np.asarray(binom.ppf(1 - error / 2, replicates, probability), dtype=np.int64)
    return low, high


def band(replicates: int, places: int, error: float) -> tuple[Counts, Counts]:
    """Return least and most ranks (K - 1,) below places 1 ... K - 1: all hold together, but for `error`."""
    levels = np.arange(1, places) / places
    narrow, wide = math.log(error), math.log(error / places)  # by Bonferroni the second is wide enough
    for _ in range(HALVINGS):
        middle = 0.5 * (narrow + wide)
        if inside(replicates, *limits(replicates, levels, math.exp(middle))) >= 1 - error:
            wide = middle
        else:
            narrow = middle
    return limits(replicates, levels, math.exp(wide))


def inside(replicates: int, low: Counts, high: Counts) -> float:
    """Return the probability that uniform ranks below every place stay within limits (K - 1,)."""
    step = poisson.pmf(np.arange(replicates + 1), replicates / (len(low) + 1))
    alive, first = np.ones(1), 0  # probabilities of sums first, first + 1, ...
    for least, most in zip(low.tolist(), high.tolist(), strict=True):
        summed = np.convolve(alive, step)
        start = max(least, first)
        alive, first = summed[start - first : most - first + 1], start
    last = step[replicates - first - np.arange(len(alive))]
    return float(alive @ last / poisson.pmf(replicates, replicates))
