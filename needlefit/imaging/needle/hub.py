"""Find the metal hub that holds a needle: a rod around its axis, before its first cross-section."""

from dataclasses import dataclass

import numpy as np

from needlefit.arrays import Floats
from needlefit.geometry.curves import make_normal
from needlefit.imaging.needle.axis_spline import AxisFrames, disc_points, sample_planes
from needlefit.imaging.volume import Volume

METAL_HU = 1500.0  # what is brighter belongs to the hub, HU
# Distance out to which a hub is looked for before the needle and beside it, and between its sections, mm.
REACH_MM = 60.0  # mm, before the needle
SIDE_MM = 7.0  # mm, beside it
STEP_MM = 0.5  # mm, between sections
# Distance from a hub to the place on the needle that shows the hub's direction, mm; rounds to find it.
LEVER_MM = 25.0  # mm
ROUNDS = 3  # rounds
MIN_RADIUS = 1.8  # of a hub, least, over the needle's diameter
MAX_RADIUS_MM = 5.0  # mm, largest radius of a hub
END_MM = 3.0  # mm, length of a hub that shows its axis
MIN_LENGTH_MM = 4.0  # mm, least length of a hub
HIDDEN_MM = 20.0  # length of a hub that leaves the volume beyond its face, mm


@dataclass(frozen=True)
class Hub:
    """A metal rod around the needle's axis."""

    ends: Floats  # (2, 3); ends of its axis, the one toward the needle's tip last, LPS, mm
    radius: float  # mm


def find_hub(volume: Volume, points: Floats, diameter: float) -> Hub | None:
    """Return the hub before the first of some points (N, 3) on a needle, LPS, mm; None if there is none."""
    middle = points[0]
    plane, s = disc_points(SIDE_MM), np.arange(0.0, REACH_MM, STEP_MM)
    for _ in range(ROUNDS):
        lever = points[np.argmin(np.abs(np.linalg.norm(points - middle, axis=1) - LEVER_MM))]
        way = (middle - lever) / np.linalg.norm(middle - lever)
        start = middle + way * ((points[0] - middle) @ way)
        u = make_normal(way)
        v = np.cross(way, u)
        tiled = (np.tile(one, (len(s), 1)) for one in (way, u, v))
        values = sample_planes(volume, AxisFrames(start + s[:, None] * way, *tiled), plane)
        bright = np.nan_to_num(values, nan=-np.inf) > METAL_HU
        radius = SIDE_MM * np.sqrt(bright.mean(axis=1))
        wide = np.append(radius > MIN_RADIUS * diameter, False)
        first = int(np.argmax(wide))
        last = first + int(np.argmin(wide[first:]))
        length = (last - first) * STEP_MM
        if length < MIN_LENGTH_MM:
            return None
        part = slice(first, first + int(END_MM / STEP_MM))
        aside = np.mean([plane[one].mean(axis=0) for one in bright[part]], axis=0)
        middle = start + np.mean(s[part]) * way + aside[0] * u + aside[1] * v
    size = float(np.median(radius[first : first + 3]))
    cut = last < len(s) and bool(np.isnan(values[last]).any())
    if np.hypot(*aside) > size or size > MAX_RADIUS_MM or not (cut or length > 2 * size):
        return None
    behind = length - END_MM / 2 + (HIDDEN_MM if cut else 0.0)
    return Hub(np.stack([middle + behind * way, middle - END_MM / 2 * way]), size)
