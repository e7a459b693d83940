"""Covariance of the noise of a centreline's points across the needle."""

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.insertion import Noise

Floats = NDArray[np.float64]


def points_covariance(s: Floats, noise: Noise, sd: Floats | None = None) -> Floats:
    """Return the covariance (K, K) of points at arc lengths `s` (K,), mm^2.

    Parameters
    ----------
    noise : Noise
        Its independent part, and how far along the needle the other part is shared.
    sd : (K,) array, optional
        Deviation of each point's shared part, mm; by default the same for all, as `noise` states.
    """
    deviation = np.full(len(s), noise.correlated_sd) if sd is None else sd
    apart = np.abs(s[:, None] - s)  # (K, K)
    shared = np.outer(deviation, deviation) * np.exp(-apart / noise.correlation_length)
    total: Floats = noise.point_sd**2 * np.eye(len(s)) + shared
    return total
