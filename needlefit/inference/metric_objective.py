"""The metric objective: how far a simulated needle lies from the measured one, in the paper's own errors.

    ipe * mean_j IPE_j  +  te * TE  +  edp * TE / max(|measured deflection|, edp_floor_mm)            (mm)

with the recipe's weights; edp_floor_mm is about the noise of a tip: a deflection below it says nothing.
A distance |d| has a kink at 0, where it has no gradient; here it is sqrt(d^2 + e^2) - e with e =
`SMOOTHING_MM`, which is smooth and at most e shorter.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from needlefit.arrays import Floats
from needlefit.schemas.recipe import WeightsRecord

#: distance (mm) below which a distance counts as squared: less than any measured centreline is known to
SMOOTHING_MM = 1e-4


def metric_misfits(off: Floats, weights: Floats) -> Floats:
    """Return the metric misfits (B,) of one insertion, mm, given the stations' weights (K,).

    `off` (B, K, 2 or 3) are simulated minus measured points, which run from the entry to the tip.
    """
    distances = np.sqrt(np.sum(off**2, axis=-1) + SMOOTHING_MM**2) - SMOOTHING_MM  # (B, K)
    # a product for each row: that of a matrix rounds a row by where it stands
    return (distances[:, None] @ weights[:, None])[:, 0, 0]


@dataclass(frozen=True)
class WeightedDistances:
    """The distances whose weighted sum is the objective of some insertions, about one theta."""

    weights: Floats  #: (R,) of each compared point
    off: Floats  #: (R, 2 or 3) simulated minus measured, mm
    slopes: Floats  #: (R, 2 or 3, P) its derivatives by theta

    @cached_property
    def total(self) -> float:
        """The objective, mm."""
        return float(self.weights @ (self._lengths - SMOOTHING_MM))

    @cached_property
    def rows(self) -> Floats:
        """The derivatives as rows (2 R or 3 R, P)."""
        return self.slopes.reshape(self.off.size, -1)

    @cached_property
    def _lengths(self) -> Floats:
        # numpy's own sum over so short an axis takes three times as long
        return np.sqrt(sum((self.off * self.off).T) + SMOOTHING_MM**2)

    def move(self, step: Floats) -> "WeightedDistances":
        """Return the distances after a step of theta (P,), to first order."""
        off = self.off + (self.rows @ step).reshape(self.off.shape)
        return WeightedDistances(self.weights, off, self.slopes)

    def differentiate(self) -> Floats:
        """Return the derivatives of the objective, (P,)."""
        along = (self.weights / self._lengths)[:, None] * self.off
        return along.ravel() @ self.rows


def weigh_stations(targets: Sequence[Floats], weights: WeightsRecord) -> list[Floats]:
    """Return the weights (K,) of the distances at the stations of all that is compared of an insertion.

    IPE is of the first. TE and EDP are of the last station of the last: of a tip that was measured by itself.
    """
    last, found = targets[-1], [np.zeros(len(target)) for target in targets]
    found[0] += weights.ipe / len(targets[0])
    deflection = float(np.linalg.norm((last[-1] - last[0])[1:]))
    found[-1][-1] += weights.te + weights.edp / max(deflection, weights.edp_floor_mm)
    return found
