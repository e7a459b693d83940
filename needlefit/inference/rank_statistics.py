"""Statistics of the ranks of the truth among draws: ECDF and interval coverage, with their chance limits.

N ranks, each one of K equally likely places. How many lie below each place is a sum of N independent Poisson
numbers, given their total; so the probability that all sums keep within limits is exact, by one convolution a
place, and the limits of equal pointwise probability that keep it at what is wanted are found by bisection
(T. Saeilynoja, P.-C. Buerkner, A. Vehtari, Stat. Comput. 32 (2022) 32, whose recursion sums binomials).
"""

import math
from collections.abc import Mapping

import numpy as np
import pandas as pd
import scipy
from numpy.typing import NDArray

from needlefit.arrays import Bools, Floats
from needlefit.inference.predict import wilson_interval

Counts = NDArray[np.int64]

BISECTIONS = 40  #: bisections of the bracket of the pointwise probability, in its logarithm


def _tabulate_cdf(replicates: int, probability: Floats) -> Floats:
    """Return the probability (..., N + 1) of at most 0, 1, ..., N events of this probability (...)."""
    counts = np.arange(replicates + 1)
    return np.asarray(scipy.special.bdtr(counts, replicates, probability[..., None]), dtype=np.float64)


def _cut_tails(cdf: Floats, error: float) -> tuple[Counts, Counts]:
    """Return the quantiles (...) at half the error from both ends, of `_tabulate_cdf`."""
    low, high = (np.sum(cdf < level, axis=-1) for level in (error / 2, 1 - error / 2))
    return low, high


def ecdf_band(replicates: int, places: int, error: float) -> tuple[Counts, Counts]:
    """Return the band of ranks (K - 1,) that holds at all places together, up to the probability `error`."""
    cdf = _tabulate_cdf(replicates, np.arange(1, places) / places)
    narrow, wide = math.log(error), math.log(error / places)  # by Bonferroni the second is wide enough
    for _ in range(BISECTIONS):
        middle = 0.5 * (narrow + wide)
        if probability_inside(replicates, *_cut_tails(cdf, math.exp(middle))) >= 1 - error:
            wide = middle
        else:
            narrow = middle
    return _cut_tails(cdf, math.exp(wide))


def probability_inside(replicates: int, low: Counts, high: Counts) -> float:
    """Return the probability that uniform ranks stay within limits (K - 1,) at every place."""
    # counts between neighbouring places are independent Poisson numbers, given that they add up to all
    step = _poisson(np.arange(replicates + 1), replicates / (len(low) + 1))
    alive, first = np.ones(1), 0  # probabilities of sums first, first + 1, ...
    for least, most in zip(low.tolist(), high.tolist(), strict=True):
        # convolve, then cut to the limits: probability outside them is lost and never returns
        summed = np.convolve(alive, step)
        start = max(least, first)
        alive, first = summed[start - first : most - first + 1], start
    last = step[replicates - first - np.arange(len(alive))]
    return float(alive @ last / _poisson(np.array(replicates), replicates))


def _poisson(counts: Counts, mean: float) -> Floats:
    return np.asarray(np.exp(scipy.special.xlogy(counts, mean) - scipy.special.gammaln(counts + 1) - mean))


RANK_DRAWS = 79
"""Draws of each posterior: among them the truth has 80 places, of which every level is a whole part."""

LEVELS = (0.50, 0.80, 0.90, 0.95)  #: central intervals whose coverage is counted


def rank_truth(truth: Floats, draws: Floats, rng: np.random.Generator) -> Counts:
    """Return the number of draws (L, Q) below the truth (Q,); ties are broken at random."""
    below = np.sum(draws < truth, axis=0)
    equal = np.sum(draws == truth, axis=0)
    # the truth may lie anywhere among equal draws: the upper end of rng.integers is exclusive
    return below + rng.integers(0, equal + 1)


def place_pit(pit: float) -> int:
    """Return the place, 0 to `RANK_DRAWS`, of a probability predicted of less than the truth."""
    return min(int(pit * (RANK_DRAWS + 1)), RANK_DRAWS)


def find_covered(ranks: Counts, level: float) -> Bools:
    """Return which ranks lie in the central interval of a level."""
    outside = round((RANK_DRAWS + 1) * (1 - level) / 2)  # places at each end
    inside: Bools = (ranks >= outside) & (ranks < RANK_DRAWS + 1 - outside)
    return inside


def share_by_truth(hits: Bools) -> Floats:
    """Return the share of hits of each truth (N,), from (N,) or, of several tips of a truth, (N, K).

    A truth is one trial: limits of the sum of shares for N trials are too wide rather than too narrow.
    """
    return hits.reshape(len(hits), -1).mean(axis=1)


def estimate_share(shares: Floats) -> tuple[float, float]:
    """Return the 95 % interval of the mean of shares (N,) of N truths.

    That is Wilson's interval, of as many trials as would have the variance of the mean (E. L. Korn, B. I.
    Graubard, Surv. Methodol. 24 (1998) 193).
    """
    rate, variance = float(shares.mean()), float(shares.var()) / len(shares)
    return wilson_interval(rate, rate * (1 - rate) / variance if variance > 0 else len(shares))


FAMILY_ERROR = 0.01
"""Probability that a right computation fails anywhere: shared out evenly (Bonferroni) over the ECDFs and the
coverages at every level of all quantities. As these go together, the true one is smaller."""


def single_check_error(quantities: int) -> float:
    """Return the probability with which each single check may fail by chance."""
    return FAMILY_ERROR / (quantities * (1 + len(LEVELS)))


def tabulate_covered_shares(ranks: Mapping[str, Counts]) -> pd.DataFrame:
    """Return the coverage as one row for every quantity and level."""
    error, rows = single_check_error(len(ranks)), []
    for name, placed in ranks.items():
        limits = _cut_tails(_tabulate_cdf(len(placed), np.array(LEVELS)), error)
        for level, least, most in zip(LEVELS, *limits, strict=True):
            shares = share_by_truth(find_covered(placed, level))
            covered, (low, high) = float(shares.sum()), estimate_share(shares)
            row = {"quantity": name, "level": level, "replicates": len(placed), "covered": covered}
            row |= {"expected": level * len(placed), "count_low": least, "count_high": most}
            row |= {"passes": least <= covered <= most}
            rows.append(row | {"share": covered / len(placed), "low": low, "high": high})
    return pd.DataFrame(rows)


def tabulate_ecdfs(ranks: Mapping[str, Counts]) -> pd.DataFrame:
    """Return the ECDFs as one row for every quantity and place of the truth among the draws."""
    error, parts = single_check_error(len(ranks)), []
    places = np.arange(1, RANK_DRAWS + 1)
    for name, placed in ranks.items():
        least, most = ecdf_band(len(placed), RANK_DRAWS + 1, error)
        below = np.array([share_by_truth(placed < place).sum() for place in places])
        columns = {
            "quantity": name,
            "rank": places,
            "below": below,
            "expected": len(placed) * places / (RANK_DRAWS + 1),
            "count_low": least,
            "count_high": most,
            "passes": (least <= below) & (below <= most),
        }
        parts.append(pd.DataFrame(columns))
    return pd.concat(parts, ignore_index=True)


def find_failing(coverage: pd.DataFrame, ecdfs: pd.DataFrame) -> list[str]:
    """Return the quantities for which any check fails, in their order."""
    failed = {*coverage.loc[~coverage["passes"], "quantity"], *ecdfs.loc[~ecdfs["passes"], "quantity"]}
    return [name for name in dict.fromkeys(coverage["quantity"]) if name in failed]
