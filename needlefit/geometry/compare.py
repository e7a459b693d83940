"""Compare a simulated curve with a measured one: in-plane error (IPE), tip error (TE), error-to-deflection
percentage (EDP).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

COMPARISON_POINTS = 101
"""Points at which two curves are compared, from entry (j = 1) to tip (j = K)."""


@dataclass(frozen=True)
class CurveErrors:
    """The errors of one insertion, as defined in section IV of the paper; mm unless stated.

    Attributes
    ----------
    ipe : (K,) array
        In-plane error at each station, |r_sim - r_measured|.
    te : float
        Tip error, `ipe[-1]`.
    edp : float
        100 TE / |y_K - y_1|, percent; infinite where the measured needle stayed straight.
    median, mean, std, maximum : float
        Of `ipe`; `std` over all K stations (no correction for their number).
    deflection : float
        Measured y_K - y_1, signed as y is.
    """

    ipe: Floats
    te: float
    edp: float
    median: float
    mean: float
    std: float
    maximum: float
    deflection: float


def compare_curves(simulated: ArrayLike, measured: ArrayLike) -> CurveErrors:
    """Compare two curves (K, 2), both in C, station by station; the result is described in `CurveErrors`."""
    sim, meas = np.asarray(simulated, dtype=np.float64), np.asarray(measured, dtype=np.float64)
    if sim.shape != meas.shape or sim.ndim != 2 or sim.shape[1] != 2:
        raise ValueError(
            f"curves of shape {sim.shape} and {meas.shape} cannot be compared; need (K, 2) twice"
        )
    ipe: Floats = np.linalg.norm(sim - meas, axis=1)
    te, deflection = float(ipe[-1]), float(meas[-1, 1] - meas[0, 1])
    return CurveErrors(
        ipe=ipe,
        te=te,
        edp=100 * te / abs(deflection) if deflection else (np.inf if te else 0.0),
        median=float(np.median(ipe)),
        mean=float(np.mean(ipe)),
        std=float(np.std(ipe)),
        maximum=float(np.max(ipe)),
        deflection=deflection,
    )
