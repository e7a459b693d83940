"""Estimate proportions with Wilson intervals that respect groups of repeats.

Needles of one specimen (one hole at several depths) are no independent trials. What is counted is every
needle; the interval is Wilson's of as many trials as there are groups of repeats, as if the repeats of a
group always agreed: rather too wide where they do not.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri


@dataclass(frozen=True)
class Proportion:
    """A proportion: `hits` of `trials`, in `groups` groups of repeats, with its 95 % interval."""

    hits: int
    trials: int
    groups: int
    low: float
    high: float


def estimate_proportion(hits: Sequence[bool], groups: Sequence[str]) -> Proportion:
    """Estimate a proportion from trials; in the interval every group of repeats has the same weight."""
    by_group: dict[str, list[bool]] = {}
    for one, group in zip(hits, groups, strict=True):
        by_group.setdefault(group, []).append(bool(one))
    rate = float(np.mean([np.mean(members) for members in by_group.values()]))
    # as many trials as groups: repeats in one specimen are not independent
    low, high = wilson_interval(rate, len(by_group))
    return Proportion(sum(map(bool, hits)), len(hits), len(by_group), low, high)


def wilson_interval(rate: float, trials: int, level: float = 0.95) -> tuple[float, float]:
    """Return Wilson's interval of a probability with observed `rate` in `trials` (E. B. Wilson, 1927)."""
    z2 = float(ndtri(0.5 + level / 2)) ** 2
    centre = (rate + z2 / (2 * trials)) / (1 + z2 / trials)
    half = math.sqrt(z2 * (rate * (1 - rate) / trials + z2 / (4 * trials**2))) / (1 + z2 / trials)
    return max(0.0, centre - half), min(1.0, centre + half)
