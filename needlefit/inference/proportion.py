"""Estimate a proportion, with Wilson's interval of as many trials as there are groups of repeats."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from needlefit.grouping import group_values


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
