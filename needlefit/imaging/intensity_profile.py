"""Sample the brightness along the needle, and find where its surroundings change from air to tissue."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares
from scipy.special import ndtr

from needlefit.arrays import Floats
from needlefit.geometry.curves import make_normal
from needlefit.imaging.needle.axis_spline import AxisFrames, correlation_factor, disc_points, sample_planes
from needlefit.imaging.needle.segmentation import MAX_AIR_HU
from needlefit.imaging.reconstruction import IntensityProfile
from needlefit.imaging.volume import Volume

RING_RADII_MM = (3.5, 6.0)
"""Radii between which the surroundings are read, mm: beyond bloom, within the nearest marker as a rule."""

MIN_METAL_HU = 1000.0
"""Brighter points of a ring are a marker's, HU."""

CORE_RADIUS_MM = 0.45
"""Radius within which the needle itself is read, mm."""

MIN_RING_FRACTION = 0.3
"""Part of a ring that must lie in the volume, with the points opposite."""

MIN_SIDE_LENGTH_MM = 2.0
"""Air and tissue must each last so long along the needle to make an edge, mm."""

EDGE_REACH_MM = 8.0
"""Distance to either side of the edge over which the model is fitted, mm."""

MIN_EDGE_STEP_HU = 300.0
"""An edge from air to tissue rises by more than this, HU."""

SOFT_LOSS_SD = 2.0
"""Stations that stray by more than so many deviations of the noise count less."""

SYSTEMATIC_SD_MM = 0.03
"""Deviation of an edge that no scatter along the needle shows, mm."""


def sample_profile(volume: Volume, points: ArrayLike, s: ArrayLike) -> IntensityProfile:
    """Return the brightness of the needle and of its surroundings at each station.

    The surroundings are the median of a ring: rays, which fill a part of it, do not count. Points outside the
    volume and on markers are left out, with those opposite; so a slanting face, which some points meet early
    and others late, turns the median where the needle itself passes through.

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
    ring = np.where(ring < MIN_METAL_HU, ring, np.nan)
    ring = np.where(np.isfinite(ring[:, ::-1]), ring, np.nan)  # the same disc, turned round
    core = sample_planes(volume, where, plane[radius <= CORE_RADIUS_MM])
    return IntensityProfile(
        np.asarray(s, dtype=np.float64), _row_medians(core, 1.0), _row_medians(ring, MIN_RING_FRACTION)
    )


def find_tissue_edge(profile: IntensityProfile) -> tuple[float, float] | None:
    """Return where along the needle air changes to tissue, mm, and its deviation; None if there is no edge.

    The edge is an error function whose place, height and width are fitted, with a slope behind it for what a
    hardened beam and further layers do. Sampled stations beyond air pockets or in another layer stray and
    count less.
    """
    known = np.isfinite(profile.around)
    s, values = profile.s[known], profile.around[known]
    guess = _guess_edge(s, values)
    if guess is None:
        return None
    near = np.abs(s - guess) <= EDGE_REACH_MM
    s, values = s[near], values[near]
    before, after = values[s < guess], values[s > guess]
    low, high = float(np.median(before)), float(np.median(after))
    if high - low < MIN_EDGE_STEP_HU:
        return None
    # median of |difference of neighbours|: 1.05 = 1 / (0.6745 sqrt 2), so a slope hardly counts as noise
    noise = max(2.0, *(1.05 * float(np.median(np.abs(np.diff(side)))) for side in (before, after)))

    def residuals(theta: Floats) -> Floats:
        at, width, bottom, top, slope = theta
        tissue = top + slope * np.clip(s - at, 0, None)
        shown = bottom + (tissue - bottom) * ndtr((s - at) / np.exp(width))
        return np.asarray((shown - values) / noise, dtype=np.float64)

    start = np.array([guess, np.log(0.5), low, high, 0.0])
    best = least_squares(
        residuals, start, loss="soft_l1", f_scale=SOFT_LOSS_SD, x_scale=[0.2, 0.3, 50, 50, 10]
    )
    jacobian, left = np.asarray(best.jac, dtype=np.float64), residuals(best.x)
    # misfit per degree of freedom, five parameters; neighbouring stations are correlated, which widens it
    # again
    spread = max(1.0, 2 * best.cost / max(1, len(s) - 5)) * correlation_factor(left[:, None], 5)
    variance = float(np.linalg.pinv(jacobian.T @ jacobian)[0, 0]) * spread
    return float(best.x[0]), float(np.hypot(np.sqrt(variance), SYSTEMATIC_SD_MM))


def _guess_edge(s: Floats, values: Floats) -> float | None:
    """Return the place that parts air from tissue best: most stations before it are air, most behind tissue.

    None if either lasts less than `MIN_SIDE_LENGTH_MM`.
    """
    if len(s) < 8:
        return None
    tissue = np.where(values > MAX_AIR_HU, 1.0, -1.0)
    # how many stations before each gap are air, less those that are not, and the same behind it
    parted = -np.cumsum(tissue)[:-1] + (np.sum(tissue) - np.cumsum(tissue)[:-1])
    at = int(np.argmax(parted))
    before, after = tissue[: at + 1], tissue[at + 1 :]
    enough = MIN_SIDE_LENGTH_MM / float(np.median(np.diff(s)))
    if -before.sum() < enough or after.sum() < enough:
        return None
    return float(s[at] + s[at + 1]) / 2


def _row_medians(values: Floats, least: float) -> Floats:
    """Return the median (N,) of each row's known values; nan where fewer than the part `least` is known."""
    enough = np.isfinite(values).mean(axis=1) >= least
    middle = np.full(len(values), np.nan)
    if enough.any():
        middle[enough] = np.nanmedian(values[enough], axis=1)
    return middle
