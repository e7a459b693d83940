"""Whether several independent chains tell the same: rank-normalised split R-hat."""

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, rankdata

Floats = NDArray[np.float64]


def r_hat(chains: Floats) -> float:
    """Return R-hat of one quantity over chains (E, N); NaN with fewer than two chains or four draws.

    Every chain is cut in halves, all draws are replaced by normal scores of their ranks (so heavy tails
    and the scale do not matter), and with B the variance between and W the mean variance within halves
    of length n

        R-hat = sqrt( ((n - 1) W / n + B) / W ),    B = var(means of the halves).

    The larger of two values counts: of the draws, and of their distances from the median (which sees
    chains that differ in width alone). Vehtari et al., Bayesian Analysis 16 (2021) 667.
    """
    if chains.ndim != 2 or chains.shape[0] < 2 or chains.shape[1] < 4:
        return float("nan")
    half = chains.shape[1] // 2
    halves = np.concatenate([chains[:, :half], chains[:, -half:]])  # (2 E, n)
    folded = np.abs(halves - np.median(halves))
    return max(_split(_scores(halves)), _split(_scores(folded)))


def _scores(draws: Floats) -> Floats:
    ranks = rankdata(draws, axis=None).reshape(draws.shape)
    scores: Floats = norm.ppf((ranks - 0.375) / (draws.size + 0.25))
    return scores


def _split(halves: Floats) -> float:
    n = halves.shape[1]
    within = float(np.mean(np.var(halves, axis=1, ddof=1)))
    between = float(np.var(np.mean(halves, axis=1), ddof=1))
    if within == 0.0:
        return 1.0 if between == 0.0 else float("inf")
    return float(np.sqrt(((n - 1) / n * within + between) / within))
