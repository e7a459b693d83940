"""From how many insertions on a curve is good enough, and how much of that is the luck of their order.

A curve is a mean over held-out needles, one value for every count of insertions learned from; there is one
for every order. The count is read off the mean over orders. What it would have been with other orders is
asked by drawing the orders again, with replacement; all curves are drawn again together, so that their
differences are paired. Held-out needles are the same throughout: intervals say nothing of other ones.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

AGAIN = 2000
"""Times that orders are drawn again."""

ENDS = (2.5, 97.5)
"""Percentiles of an interval."""


@dataclass(frozen=True)
class Estimate:
    """A value and its 95 % interval over orders; infinite where a count is not reached."""

    value: float
    low: float
    high: float


def drawn_again(orders: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return which orders (`AGAIN`, O) make each of the repetitions."""
    return rng.integers(0, orders, size=(AGAIN, orders))


def reached(curves: Floats, counts: Sequence[int], limit: float, again: NDArray[np.int64]) -> Estimate:
    """Return the smallest count from which on the mean of `curves` (O, N) stays at or below `limit`."""
    means = np.vstack([curves.mean(axis=0)[None], curves[again].mean(axis=1)])  # (1 + AGAIN, N)
    from_end = np.cumprod((means <= limit)[:, ::-1], axis=1).sum(axis=1)  # how many counts stay good
    found = np.array([*counts, np.inf])[len(counts) - from_end]
    return _estimate(found[0], found[1:])


def gained(curves: Floats, rivals: Floats, again: NDArray[np.int64]) -> Estimate:
    """Return by how much the mean of `curves` (O,) lies below that of `rivals` (O,), order by order."""
    gain = rivals - curves
    return _estimate(gain.mean(), gain[again].mean(axis=1))


def _estimate(value: float, again: Floats) -> Estimate:
    low, high = np.percentile(again, ENDS, method="inverted_cdf")
    return Estimate(float(value), float(low), float(high))
