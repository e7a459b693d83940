"""Compare the stated diameter of the marker balls with that of the scan's image of them.

A few balls are fitted with other diameters. One that explains the image much better is the measured one.
"""

from collections.abc import Sequence

import numpy as np

from needlefit.imaging.marker_blobs import Blob
from needlefit.imaging.sphere_fit import MAX_BLUR_MM, SphereFit, fit_sphere
from needlefit.imaging.volume import Volume

FIRST_FACTORS, DIAMETER_FACTORS = (0.85, 1.18), (0.8, 0.9, 1.12, 1.25, 1.4)
"""Diameters that are tried, in those stated: the others if one of the first explains the balls better."""

MAX_FITTED_BALLS = 2
"""Balls that are fitted with other diameters: those that the stated one explains best."""

MIN_MISFIT = 0.02
"""Balls whose misfit is smaller, in parts of their brightness, leave nothing to explain."""

MAX_MISFIT_RATIO = 0.6
"""Another diameter must leave less than this part of the misfit: less is won by chance on clean scans."""


def check_diameter(
    volume: Volume, balls: Sequence[tuple[Blob, SphereFit]], diameter: float
) -> tuple[str, ...]:
    """Return a warning if the balls found are of another diameter than stated, mm."""
    factor = _measure_factor(volume, balls, diameter)
    if factor is None:
        return ()
    return (
        f"the balls in the scan are about {factor * diameter:.1f} mm wide, but {diameter:g} mm are stated: "
        "check markers.diameter_mm",
    )


def _measure_factor(volume: Volume, balls: Sequence[tuple[Blob, SphereFit]], diameter: float) -> float | None:
    """Return the diameter of the balls over the one stated; None if that one explains them."""
    used = sorted(balls, key=lambda one: one[1].misfit)[:MAX_FITTED_BALLS]
    own = np.array([ball.misfit for _, ball in used])
    if not len(own) or np.median(own) < MIN_MISFIT:
        return None

    def remain(factor: float) -> float:
        """Return the misfit that is left, the median part of the balls' own."""
        fits = [fit_sphere(volume, blob, factor * diameter / 2) for blob, _ in used]
        # a blur at its bound explains anything
        left = [one.misfit if one.spread.blur < 0.99 * MAX_BLUR_MM else np.inf for one in fits]
        return float(np.median(left / own))

    if min(remain(factor) for factor in FIRST_FACTORS) >= 1:
        return None
    tried = {1.0: 1.0} | {factor: remain(factor) for factor in DIAMETER_FACTORS}
    best = min(tried, key=lambda factor: tried[factor])
    return best if tried[best] < MAX_MISFIT_RATIO else None
