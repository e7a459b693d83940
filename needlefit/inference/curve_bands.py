"""Simultaneous bands of curves: with the stated probability no point of a curve lies outside.

About the pointwise median, the ends of the pointwise 95 % interval are moved by one factor at all points,
until the wanted share of the curves lies wholly inside. Pointwise intervals hold each point with that
probability, and whole curves less often.
"""

from dataclasses import dataclass

import numpy as np

from needlefit.arrays import Floats

#: probabilities of the pointwise quantiles of curves, whose distances from the median are the scale
QUANTILES = (0.025, 0.5, 0.975)
DRAWN_CURVES = 2000  #: smallest number of curves that are drawn, where errors stand about each draw
TINY_MM = 1e-9  #: spread (mm) of curves that counts as none


@dataclass(frozen=True)
class CurveBands:
    """The nested bands of some curves (B, K)."""

    median: Floats  #: (K,)
    below: Floats  #: (K,) from the median to the ends of the pointwise 95 % interval
    above: Floats  #: (K,)
    sizes: Floats  #: (B,) sorted: by which factor the band of that interval must grow to hold each curve

    def measure(self, curves: Floats) -> Floats:
        """Return the factor by which the pointwise interval must grow to hold each curve (..., K)."""
        away = curves - self.median
        scale = np.where(away < 0, self.below, self.above)
        return np.max(np.divide(np.abs(away), scale, np.zeros_like(away), where=scale > TINY_MM), axis=-1)

    def pit(self, curve: Floats) -> float:
        """Return the probability of the smallest band that holds a curve (K,)."""
        return float(np.mean(self.sizes < self.measure(curve)))

    def ends(self, level: float) -> tuple[Floats, Floats]:
        """Return the ends (K,), (K,) of the band that holds curves with probability `level`."""
        size = self.sizes[min(int(level * len(self.sizes)), len(self.sizes) - 1)]
        return self.median - size * self.below, self.median + size * self.above


def find_bands(curves: Floats) -> CurveBands:
    """Return the bands of curves (B, K), mm."""
    low, median, high = np.quantile(curves, QUANTILES, axis=0)
    bands = CurveBands(median, median - low, high - median, np.empty(0))
    return CurveBands(median, bands.below, bands.above, np.sort(bands.measure(curves)))


def predict_bands(means: Floats, covariance: Floats, rng: np.random.Generator) -> CurveBands:
    """Return the bands of measured curves: draws (B, K) with errors of one covariance (K, K)."""
    sizes, directions = np.linalg.eigh(covariance)
    root = directions * np.sqrt(np.maximum(sizes, 0.0))  # a motion laid off leaves it singular
    times = -(-DRAWN_CURVES // len(means))
    curves = means + rng.normal(size=(times, *means.shape)) @ root.T
    return find_bands(curves.reshape(-1, means.shape[1]))
