"""Find the metal hub that holds a needle: a rod around its axis, near the needle's base."""

from dataclasses import dataclass

import numpy as np

from needlefit.arrays import Floats
from needlefit.geometry.frames import to_unit
from needlefit.imaging.constants import HU, MM, PART
from needlefit.imaging.needle.axis_spline import ROUNDS, disc_points, frames_along, sample_planes
from needlefit.imaging.volume import Volume


@dataclass(frozen=True)
class Hub:
    """A metal rod around the needle's axis."""

    ends: Floats  # (2, 3); ends of its axis, the one toward the needle's tip last, LPS, mm
    radius: float  # mm


def find_hub(volume: Volume, points: Floats, diameter: float) -> Hub | None:
    """Return the hub near the first of points (N, 3) on a needle, LPS, mm; None if there is none.

    It begins at most `MM.REACH` before that point, or `MM.HIDDEN` behind it: a trace may lead into a hub.
    """
    middle, side = points[0], MM.HUB_RADIUS + MM.BLUR_REACH
    plane, s = disc_points(side), np.arange(-MM.HIDDEN, MM.REACH, MM.STATION)
    for _ in range(ROUNDS):
        lever = points[np.argmin(np.abs(np.linalg.norm(points - middle, axis=1) - MM.NEEDLE_LENGTH))]
        way = to_unit(middle - lever)
        start = middle + way * ((points[0] - middle) @ way)
        where = frames_along(start + s[:, None] * way)
        values = sample_planes(volume, where, plane)
        bright = np.nan_to_num(values, nan=-np.inf) > HU.HUB
        radius = side * np.sqrt(bright.mean(axis=1))
        wide = np.append(radius > PART.HUB_RADIUS * diameter, False)
        first = int(np.argmax(wide))
        last = first + int(np.argmin(wide[first:]))
        length = (last - first) * MM.STATION
        if length < MM.HUB_LENGTH:
            return None
        part = slice(first, first + int(MM.HUB_LENGTH / MM.STATION))
        aside = np.mean([plane[one].mean(axis=0) for one in bright[part]], axis=0)
        middle = start + np.mean(s[part]) * way + aside[0] * where.u[0] + aside[1] * where.v[0]
    size = float(np.median(radius[first : first + 3]))
    cut = last < len(s) and bool(np.isnan(values[last]).any())
    if np.hypot(*aside) > size or size > MM.HUB_RADIUS or not (cut or length > 2 * size):
        return None
    behind = length - MM.HUB_LENGTH / 2 + (MM.NEEDLE_LENGTH if cut else 0.0)
    return Hub(np.stack([middle + behind * way, middle - MM.HUB_LENGTH / 2 * way]), size)
