"""To which side of its bevel a needle bends: by its pose, of free shapes by the direction that fits all."""

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.compared import MIN_BEND_SLOPE, SIGNIFICANT_SD, compute_deflection_sd
from needlefit.datasets.insertion import Insertion, Noise
from needlefit.geometry.common_direction import fit_direction

BendSide = Literal["toward", "away", "unknown"]


def find_bend_sides(insertions: Sequence[Insertion], noise: Noise) -> list[BendSide]:
    """Return to which side of its bevel each insertion bends.

    Of free shapes the deflection from the direction that fits all of them shows it.
    """
    sides = [find_bend_side(insertion, noise) for insertion in insertions]
    facing = {n: bevel for n, one in enumerate(insertions) if (bevel := _find_facing(one)) is not None}
    fitted = fit_direction([insertions[n].centerline for n in facing])
    if fitted is None:
        return sides
    for n, bevel in facing.items():
        one = insertions[n]
        chord = one.centerline[-1] - one.centerline[0]
        length = float(chord @ fitted.vector)
        deflection = float(bevel @ (chord - length * fitted.vector))
        turn = math.radians(math.hypot(fitted.sd_deg, fitted.scatter_deg))
        point_sd = math.sqrt(2) * math.hypot(noise.of(one).point_sd, noise.correlated_sd)
        limit = max(MIN_BEND_SLOPE * length, SIGNIFICANT_SD * math.hypot(point_sd, length * turn))
        if abs(deflection) > limit:
            sides[n] = "toward" if deflection > 0 else "away"
    return sides


def _find_facing(insertion: Insertion) -> Floats | None:
    """Return the direction (3,) in the world that the bevel of a free shape faces, if it alone bent it."""
    if insertion.is_posed or insertion.turns or insertion.base_moved or insertion.guided:
        return None
    return None if insertion.bevel is None or insertion.in_tracker_frame else insertion.side * insertion.bevel


def find_bend_side(insertion: Insertion, noise: Noise) -> BendSide:
    """Return to which side of its bevel an insertion or a run of a tip track bends.

    Both the tip's deflection from the entry line and the curve's own bend, which no error of the entry pose
    changes, must show it. Of a run the bend alone counts: its readings are known up to a shift and a slope. A
    free shape lies by its bend, and a base or guide that moved, or a bevel that was turned, bends the needle
    too: they show nothing.
    """
    guide = insertion.guide
    if guide.moved if guide else not insertion.is_posed or insertion.base_moved:
        return "unknown"
    if insertion.turns:
        return "unknown"
    x, y = insertion.points[:, 0], insertion.side * insertion.points[:, 1]
    least, measures = MIN_BEND_SLOPE * insertion.depth, []
    if len(x) > 2:  # more than a tip
        parabola = np.polyfit(x - x[0], y, 2)
        bend = float(parabola[0] * (x[-1] - x[0]) ** 2)  # the deflection from its first tangent
        scatter = float(np.sqrt(np.mean((y - np.polyval(parabola, x - x[0])) ** 2)))
        noise_sd = SIGNIFICANT_SD * float(
            np.hypot(scatter, np.hypot(noise.of(insertion).point_sd, noise.correlated_sd))
        )
        measures.append((bend, max(least if guide else 0.5 * least, noise_sd)))
    if guide is None:
        limit = max(least, SIGNIFICANT_SD * compute_deflection_sd(insertion, noise))
        measures.append((insertion.deflection, limit))
    if all(value > limit for value, limit in measures):
        return "toward"
    return "away" if all(value < -limit for value, limit in measures) else "unknown"
