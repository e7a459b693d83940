"""Compare one value with those of others: how far it is from what they lead to expect."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from needlefit.arrays import Floats

OUTLIER_SD = 5.0  # standard deviations beyond which a point or needle is named
MAX_CHANCE = 1e-4  # of a deviation of a sound one, by Student's t
# Values are known to differ by nature: this is as sure as from so many of them.
NATURAL_COUNT = 8
MIN_OTHERS = 4  # with which another one is compared
SAME_LENGTH_PART = 0.1  # by which lengths differ where a dependence on them is sought


@dataclass(frozen=True)
class Deviation:
    """By how much one differs from the others, in one respect."""

    value: float  # what is left of its value
    sds: float  # the same in standard deviations
    chance: float  # probability of a greater one, if it is sound

    @property
    def is_beyond(self) -> bool:
        return self.sds > OUTLIER_SD and self.chance < MAX_CHANCE


NOT_COMPARED = Deviation(0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Expectation:
    """What the others lead to expect of one value, without its own error."""

    value: float
    variance: float  # of its nature, and of the expectation
    natural_variance: float  # the part that is estimated
    sure: float  # degrees of freedom of that

    def judge(self, left: float, sds: float, own_variance: float) -> Deviation:
        """Return the deviation of a value that is so many standard deviations away."""
        # stated errors are known
        degrees = self.sure * ((self.variance + own_variance) / self.natural_variance) ** 2
        return Deviation(left, sds, 2 * float(scipy.special.stdtr(degrees, -sds)))


def expect(own: int, design: Floats, values: Floats, stated: Floats, natural: float) -> Expectation | None:
    """Return what a fit of `design` (n, p) to all others of `values` (n,) leads to expect of one.

    None where that is no answer: the one lies beyond the others by more than their own range, as one deep
    needle beside others of one depth.

    `stated` (n,): variances of their errors. The scatter of the others beyond these counts beside the
    `natural` standard deviation.
    """
    others = np.arange(len(values)) != own
    low, high = design[others].min(axis=0), design[others].max(axis=0)
    if np.any((design[own] < 2 * low - high) | (design[own] > 2 * high - low)):
        return None
    fit = np.linalg.pinv(design[others])
    found = fit @ values[others]
    free = len(values) - 1 - len(found)
    scatter = float(np.sum((values[others] - design[others] @ found) ** 2)) / free
    errors, sure = float(np.mean(stated[others])), NATURAL_COUNT + free
    spread = (NATURAL_COUNT * natural**2 + free * max(scatter - errors, 0.0)) / sure
    lever = float(np.sum((design[own] @ fit) ** 2))
    variance = spread + lever * (errors + spread)
    return Expectation(float(design[own] @ found), variance, (1.0 + lever) * spread, sure)


def compare(design: Floats, values: Floats, stated: Floats, natural: float) -> list[Deviation]:
    """Compare each of `values` (n,) with what the others lead to `expect` of it."""
    found = []
    for own, value in enumerate(values.tolist()):
        expected = expect(own, design, values, stated, natural)
        if expected is None:
            found.append(NOT_COMPARED)
            continue
        left = value - expected.value
        sds = abs(left) / math.sqrt(expected.variance + stated[own])
        found.append(expected.judge(left, sds, float(stated[own])))
    return found


def design_lengths(lengths: Sequence[float]) -> Floats:
    """Return a design (n, 1 or 2): a constant, and the logarithm of lengths where these differ."""
    logs = np.log(lengths)
    design = np.column_stack([np.ones(len(logs)), logs - logs.mean()])
    return design if np.ptp(logs) >= SAME_LENGTH_PART else design[:, :1]
