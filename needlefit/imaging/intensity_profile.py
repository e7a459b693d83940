"""Sample the brightness of the needle and of its surroundings along it."""

import numpy as np
from numpy.typing import ArrayLike

from needlefit.arrays import Floats
from needlefit.geometry.curves import make_normal
from needlefit.imaging.needle.axis_spline import AxisFrames, disc_points, sample_planes
from needlefit.imaging.reconstruction import IntensityProfile
from needlefit.imaging.volume import Volume

RING_RADII_MM = (3.5, 6.0)
"""Radii between which the surroundings are read, mm: beyond bloom, within the nearest marker as a rule."""

MIN_METAL_HU = 1000.0
"""Brighter points of a ring are a marker's, HU; where most of a ring is as bright, a hub's or a holder's."""

CORE_RADIUS_MM = 0.45
"""Radius within which the needle itself is read, mm."""

MIN_RING_FRACTION = 0.3
"""Part of a ring that must lie in the volume, with the points opposite."""


def sample_profile(volume: Volume, points: ArrayLike, s: ArrayLike) -> IntensityProfile:
    """Return the brightness of the needle and of its surroundings at each station.

    The surroundings are the median of a ring: rays, which fill a part of it, do not count. Points outside the
    volume and on markers are left out, with those opposite; so a slanting face, which some points meet early
    and others late, turns the median where the needle itself passes through. Where most of the ring is metal,
    it is a hub or a holder, and its brightness is returned.

    Parameters
    ----------
    points : (N, 3) array
        Along the needle, LPS, mm; what lies beyond its tip is welcome.
    s : (N,) array
        Where along the needle they are, mm.
    """
    axis = np.asarray(points, dtype=np.float64)
    tangents = np.gradient(axis, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    u = np.cross(tangents, make_normal(tangents[len(axis) // 2]))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    where = AxisFrames(axis, tangents, u, np.cross(tangents, u))
    plane = disc_points(RING_RADII_MM[1])
    radius = np.hypot(*plane.T)
    ring = sample_planes(volume, where, plane[radius >= RING_RADII_MM[0]])
    metal = _row_medians(ring, MIN_RING_FRACTION)
    ring = np.where(ring < MIN_METAL_HU, ring, np.nan)
    ring = np.where(np.isfinite(ring[:, ::-1]), ring, np.nan)  # the same disc, turned round
    core = sample_planes(volume, where, plane[radius <= CORE_RADIUS_MM])
    around = np.where(metal > MIN_METAL_HU, metal, _row_medians(ring, MIN_RING_FRACTION))
    return IntensityProfile(np.asarray(s, dtype=np.float64), _row_medians(core, 1.0), around)


def _row_medians(values: Floats, least: float) -> Floats:
    """Return the median (N,) of each row's known values; nan where fewer than the part `least` is known."""
    enough = np.isfinite(values).mean(axis=1) >= least
    middle = np.full(len(values), np.nan)
    if enough.any():
        middle[enough] = np.nanmedian(values[enough], axis=1)
    return middle
