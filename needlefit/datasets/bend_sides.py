"""To which side of its bevel a needle bends: by its pose, of free shapes by the direction that fits all."""

import math
from collections.abc import Sequence
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.compared import (
    MIN_BEND_SLOPE,
    SIGNIFICANT_SD,
    compute_deflection_sd,
    compute_plane_sd,
)
from needlefit.datasets.insertion import Insertion, Noise
from needlefit.geometry.common_direction import fit_direction


class BendSide(StrEnum):
    """To which side of its bevel a needle bends, in the words of tables."""

    TOWARD = "toward"
    AWAY = "AWAY"
    ACROSS = "ACROSS"
    UNCLEAR = "not clear"
    TURNED = "(turned)"
    FREE = "(free shape)"


class Bend(NamedTuple):
    """How far a needle bends toward the side of its bevel; NaN where that is not known."""

    toward_mm: float = math.nan
    limit_mm: float = math.nan  #: beyond which it is no error, either way
    is_from_fitted: bool = False  #: from the direction that fits all needles, not from its line of insertion
    special: BendSide | None = None  #: across, turned or free, whatever its distance

    @property
    def side(self) -> BendSide:
        """To which side it bends."""
        clear = BendSide.TOWARD if self.is_toward else BendSide.AWAY if self.is_away else BendSide.UNCLEAR
        return self.special or clear

    @property
    def is_toward(self) -> bool:
        """Whether it bends toward its bevel clearly."""
        return self.toward_mm > self.limit_mm

    @property
    def is_away(self) -> bool:
        """Whether it bends away from its bevel clearly."""
        return -self.toward_mm > self.limit_mm


def measure_bends(insertions: Sequence[Insertion], noise: Noise) -> list[Bend]:
    """Return how far each insertion bends toward the side of its bevel.

    Of free shapes the deflection from the direction that fits all of them shows it.
    """
    bends = [
        _measure_bend(insertion, noise)._replace(special=_find_special(insertion, noise))
        for insertion in insertions
    ]
    facing = {n: bevel for n, one in enumerate(insertions) if (bevel := _find_facing(one)) is not None}
    fitted = fit_direction([insertions[n].centerline for n in facing])
    if fitted is None:
        return bends
    for n, bevel in facing.items():
        one = insertions[n]
        chord = one.centerline[-1] - one.centerline[0]
        length = float(chord @ fitted.vector)
        deflection = float(bevel @ (chord - length * fitted.vector))
        turn = math.radians(math.hypot(fitted.sd_deg, fitted.scatter_deg))
        point_sd = math.sqrt(2) * math.hypot(noise.of(one).point_sd, noise.correlated_sd)
        limit = max(MIN_BEND_SLOPE * length, SIGNIFICANT_SD * math.hypot(point_sd, length * turn))
        bends[n] = Bend(deflection, limit, is_from_fitted=True)
    return bends


def _find_special(insertion: Insertion, noise: Noise) -> BendSide | None:
    """Return that a needle was turned, has no frame, or bends across the plane of its bevel; None if not.

    Across, its tip is further out of the plane than in it, and than errors explain.
    """
    if insertion.turns:
        return BendSide.TURNED
    if insertion.in_tracker_frame:
        return None
    if not insertion.is_posed:
        return BendSide.FREE if insertion.bevel is None else None
    beside, out = np.abs(insertion.points[-1, 1:])
    is_across = out > max(beside, SIGNIFICANT_SD * compute_plane_sd(insertion, noise))
    return BendSide.ACROSS if is_across else None


def _find_facing(insertion: Insertion) -> Floats | None:
    """Return the direction (3,) in the world that the bevel of a free shape faces, if it alone bent it."""
    if insertion.is_posed or insertion.turns or insertion.base_moved or insertion.guided:
        return None
    return None if insertion.bevel is None or insertion.in_tracker_frame else insertion.side * insertion.bevel


def _measure_bend(insertion: Insertion, noise: Noise) -> Bend:
    """Return how far an insertion or a run of a tip track bends toward the side of its bevel.

    Both the tip's deflection from the entry line and the curve's own bend, which no error of the entry pose
    changes, must show it. Of a run the bend alone counts: its readings are known up to a shift and a slope. A
    free shape lies by its bend, and a base or guide that moved, or a bevel that was turned, bends the needle
    too: they show nothing.
    """
    guide = insertion.guide
    if guide.moved if guide else not insertion.is_posed or insertion.base_moved:
        return Bend()
    if insertion.turns:
        return Bend()
    x, y = insertion.points[:, 0], insertion.side * insertion.points[:, 1]
    least, measures = MIN_BEND_SLOPE * insertion.depth, list[Bend]()
    if len(x) > 2:  # more than a tip
        parabola = np.polyfit(x - x[0], y, 2)
        bend = float(parabola[0] * (x[-1] - x[0]) ** 2)  # the deflection from its first tangent
        scatter = float(np.sqrt(np.mean((y - np.polyval(parabola, x - x[0])) ** 2)))
        noise_sd = SIGNIFICANT_SD * float(
            np.hypot(scatter, np.hypot(noise.of(insertion).point_sd, noise.correlated_sd))
        )
        measures.append(Bend(bend, max(least if guide else 0.5 * least, noise_sd)))
    if guide is None:
        limit = max(least, SIGNIFICANT_SD * compute_deflection_sd(insertion, noise))
        measures.append(Bend(insertion.deflection, limit))
    least_clear = min(measures, key=lambda one: abs(one.toward_mm) / one.limit_mm)
    contradict = {one.is_toward for one in measures} == {one.is_away for one in measures} == {True, False}
    return Bend() if contradict else least_clear
