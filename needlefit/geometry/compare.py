"""Compare a simulated curve with a measured one, station by station; `metrics` makes errors of it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from needlefit.arrays import Floats

COMPARISON_POINTS = 101
"""Points at which two curves are compared, from entry (j = 1) to tip (j = K)."""


@dataclass(frozen=True)
class ComparedCurves:
    """Two curves of one insertion at the same stations, from the entry to the tip."""

    # `simulated`, `measured`: (K, 2); points in C, mm
    simulated: Floats
    measured: Floats

    @cached_property
    def distances(self) -> Floats:
        """In-plane error (K,) at each station, |r_sim - r_measured|, mm."""
        distances: Floats = np.linalg.norm(self.simulated - self.measured, axis=1)
        return distances

    @property
    def tip_error(self) -> float:
        """The distance at the last station, mm."""
        return float(self.distances[-1])

    @property
    def deflection(self) -> float:
        """Measured y_K - y_1, mm, signed as y is."""
        return float(self.measured[-1, 1] - self.measured[0, 1])


def compare_curves(simulated: ArrayLike, measured: ArrayLike) -> ComparedCurves:
    """Return two curves (K, 2), both in C, as compared station by station.

    ValueError if their shapes differ.
    """
    sim, meas = np.asarray(simulated, dtype=np.float64), np.asarray(measured, dtype=np.float64)
    if sim.shape != meas.shape or sim.ndim != 2 or sim.shape[1] != 2:
        raise ValueError(
            f"curves of shape {sim.shape} and {meas.shape} cannot be compared; need (K, 2) twice"
        )
    return ComparedCurves(sim, meas)
