"""From how many insertions on a curve is good enough, and how much of that is luck.

A curve is a mean over held-out needles and over orders, one value for every count of insertions learned from.
What it would have been with other needles and other orders is asked by drawing both again, with replacement
and independently of each other; all curves, and what they are held against, are drawn again together, so that
their differences are paired. Other specimens of the medium are not in it: there is one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

AGAIN = 2000
"""Times that orders and needles are drawn again."""

ENDS = (2.5, 97.5)
"""Percentiles of an interval."""


@dataclass(frozen=True)
class Estimate:
    """A value and its 95 % interval over orders and needles; infinite where a count is not reached."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Again:
    """Weights of orders (R, O) and of needles (R, H) in every repetition; in the first all weigh the same."""

    orders: Floats
    needles: Floats

    def means(self, values: Floats) -> Floats:
        """Return the means (R, N) of `values` (O, N, H) in every repetition."""
        averaged: Floats = np.einsum("ro,onh,rh->rn", self.orders, values, self.needles, optimize=True)
        return averaged


def drawn_again(orders: int, needles: int, rng: np.random.Generator) -> Again:
    """Return the weights of what there is, and of what is drawn again from it."""
    return Again(_weights(orders, rng), _weights(needles, rng))


def reached(means: Floats, counts: Sequence[int], limits: Floats) -> Estimate:
    """Return the smallest count from which on `means` (R, N) stay at or below their limit (R,)."""
    good = means <= limits[:, None]
    from_end = np.cumprod(good[:, ::-1], axis=1).sum(axis=1)  # how many counts stay good
    return estimate(np.array([*counts, np.inf])[len(counts) - from_end])


def estimate(values: Floats) -> Estimate:
    """Return the first of `values` (R,) with the interval of the others."""
    low, high = np.percentile(values[1:], ENDS, method="inverted_cdf")
    return Estimate(float(values[0]), float(low), float(high))


def _weights(count: int, rng: np.random.Generator) -> Floats:
    drawn = rng.multinomial(count, np.full(count, 1 / count), size=AGAIN)
    return np.vstack([np.ones(count), drawn]) / count
