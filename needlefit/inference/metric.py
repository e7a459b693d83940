"""The metric objective: how far one simulated needle lies from the measured one, in the paper's own errors.

    ipe * mean_j IPE_j  +  te * TE  +  edp * TE / max(|measured deflection|, edp_floor_mm)            (mm)

with the recipe's weights; edp_floor_mm is about the noise of a tip: a deflection below it says nothing.
A distance |d| has a kink at 0, where it has no gradient; here it is sqrt(d^2 + e^2) - e with e = `KINK`,
which is smooth and at most e shorter.
"""

import numpy as np
from numpy.typing import NDArray

from needlefit.schemas.recipe import WeightsRecord

Floats = NDArray[np.float64]

KINK = 1e-4
"""Distance below which a distance counts as squared, mm: less than any measured centreline is known to."""


def misfit(simulated: Floats, measured: Floats, weights: WeightsRecord) -> float:
    """Return what one insertion contributes, mm: points (K, 2) from the entry to the tip."""
    off = simulated - measured  # (K, 2)
    distances = np.sqrt(np.sum(off**2, axis=1) + KINK**2) - KINK  # (K,)
    return float(_shares(measured, weights) @ distances)


def misfit_slopes(simulated: Floats, measured: Floats, weights: WeightsRecord, slopes: Floats) -> Floats:
    """Return the derivatives (P,) of `misfit`, given those of the simulated points, (K, 2, P)."""
    off = simulated - measured
    along = off / np.sqrt(np.sum(off**2, axis=1) + KINK**2)[:, None]  # (K, 2)
    moved: Floats = np.einsum("k,ki,kip->p", _shares(measured, weights), along, slopes)
    return moved


def _shares(measured: Floats, weights: WeightsRecord) -> Floats:
    """Return the weight (K,) of the distance at each station."""
    deflection = abs(float(measured[-1, 1] - measured[0, 1]))
    shares = np.full(len(measured), weights.ipe / len(measured))
    shares[-1] += weights.te + weights.edp / max(deflection, weights.edp_floor_mm)
    return shares
