"""Where the needle's axis pierces planes across it, from the brightness in those planes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import map_coordinates

from needlefit.imaging.needle.spine import Frames
from needlefit.imaging.volume import Volume, to_index

Floats = NDArray[np.float64]

GRID = 0.3
"""Spacing of the points in a plane, mm."""

RING = 0.15
"""Width of the rings over which the common profile is averaged, mm."""

HUBER = 2.0
"""Points of a plane that stray by more than so many deviations count less."""

STRETCH = 15.0
"""Length over which what the cross-sections have in common is looked for, mm."""

BENT = 5.0
"""Shift of a section for a background that slopes by the needle's brightness in 1 mm, mm: a ray that tilts
what lies around the needle also bends it, and a bend is taken for a shift. Set on the scans of
`benchmarks/reconstruction.py --seed 100000`, others than its own."""

SEEN = 0.7
"""Part of a plane's points that must lie in the volume."""


@dataclass(frozen=True)
class Sections:
    """The needle in planes across it.

    Attributes
    ----------
    shifts : (S, 2) array
        Where its axis pierces them, along the frames' u and v, mm.
    amplitude : (S,) array
        Brightness over the background, HU.
    noise : (S,) array
        Deviation of a plane's points from the fit, HU.
    tilt : (S, 2) array
        Slope of the background along u and v, HU/mm.
    """

    shifts: Floats
    amplitude: Floats
    noise: Floats
    tilt: Floats


def disc(radius: float) -> Floats:
    """Return the points (P, 2) of a grid in a disc, mm."""
    steps = np.arange(-np.floor(radius / GRID), np.floor(radius / GRID) + 1) * GRID
    grid = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    points: Floats = grid[np.hypot(*grid.T) <= radius]
    return points


def sample(volume: Volume, where: Frames, plane: Floats) -> Floats:
    """Return the brightness (S, P), HU, at `plane` (P, 2) in every frame; nan outside the volume.

    Trilinear: it keeps centroids; cubic interpolation of a saturated needle, with its ringing, need not.
    """
    points = (
        where.origins[:, None] + plane[None, :, :1] * where.u[:, None] + plane[None, :, 1:] * where.v[:, None]
    )
    index = to_index(volume, points.reshape(-1, 3))[:, ::-1].T
    values = map_coordinates(volume.values, index, order=1, cval=np.nan, output=np.float64)
    sampled: Floats = values.reshape(points.shape[:2])
    return sampled


def in_volume(values: Floats) -> NDArray[np.bool_]:
    """Whether each plane (S, P) lies in the volume, as good as all of it."""
    enough: NDArray[np.bool_] = np.isfinite(values).mean(axis=1) >= SEEN
    return enough


def centroids(values: Floats, plane: Floats, reach: float) -> Sections:
    """Return, as a first look, the centroids of what outshines the rims, within `reach` of the middle."""
    radius = np.hypot(*plane.T)
    rim = np.nanmedian(values[:, radius > 0.8 * radius.max()], axis=1)
    over = np.where((radius <= reach) & np.isfinite(values), values - rim[:, None], 0.0)
    over = np.clip(over - 0.3 * over.max(axis=1, keepdims=True), 0, None)
    mass = np.maximum(over.sum(axis=1), 1e-9)
    return Sections(
        over @ plane / mass[:, None], over.max(axis=1), np.ones(len(values)), np.zeros((len(values), 2))
    )


def fit(values: Floats, plane: Floats, rough: Sections) -> Sections:
    """Return the sections by least squares, from `values` (S, P), HU, at `plane` (P, 2) and `rough` ones.

    Every plane shows amplitude f(|x - shift|) + background + slope . x, where f is the profile that all
    planes of this needle have in common: saturation and bloom are in it, whatever they are. Linear in
    the shift about `rough`; points that do not fit (a ray, a marker) count less.
    """
    f, slope = _profile(values, plane, rough)
    offset = plane[None] - rough.shifts[:, None]  # (S, P, 2)
    r = np.maximum(np.linalg.norm(offset, axis=2), 1e-6)
    pull = -slope(r)[..., None] * offset / r[..., None]
    ones = np.ones_like(r)
    flat = np.broadcast_to(plane, offset.shape)
    design = np.concatenate([f(r)[..., None], ones[..., None], flat, pull], axis=2)  # (S, P, 6)
    seen = np.isfinite(values)
    known = np.where(seen, values, 0.0)
    weights = seen.astype(np.float64)
    for _ in range(3):
        weighted = design * weights[..., None]
        normal = np.einsum("spa,spb->sab", weighted, design) + 1e-9 * np.eye(6)
        solved = np.linalg.solve(normal, np.einsum("spa,sp->sa", weighted, known)[..., None])[..., 0]
        residual = np.where(seen, known - np.einsum("spa,sa->sp", design, solved), 0.0)
        noise = np.maximum(1.48 * np.median(np.abs(residual), axis=1), 1e-6)
        weights = seen * np.minimum(1.0, HUBER * noise[:, None] / np.maximum(np.abs(residual), 1e-9))
    moved = solved[:, 4:] / np.where(np.abs(solved[:, :1]) > 1e-6, solved[:, :1], 1.0)
    return Sections(rough.shifts + np.clip(moved, -0.5, 0.5), solved[:, 0], noise, solved[:, 2:4])


def taken(sections: Sections, which: NDArray[np.bool_]) -> Sections:
    """Return some of the sections."""
    return Sections(
        sections.shifts[which], sections.amplitude[which], sections.noise[which], sections.tilt[which]
    )


def unseen(rough: Sections, found: Sections, station: float) -> float:
    """Return the deviation (mm) that the sections of a stretch share, so that their scatter hides it.

    It shows in how two ways to place them differ, centroids and fits, and in how far the background slopes:
    rays that run along a needle pull at many sections alike, and both stay when they are averaged over
    `STRETCH`.
    """
    window = np.ones(max(1, min(len(found.shifts), round(STRETCH / station))))
    count = np.convolve(np.ones(len(found.shifts)), window, "same")
    bent = BENT * found.tilt / np.median(found.amplitude)
    both = np.hstack([rough.shifts - found.shifts, bent])  # (S, 4)
    shared = np.stack([np.convolve(side, window, "same") / count for side in both.T])
    return float(np.sqrt(np.sum(np.mean(shared**2, axis=1)) / 2))  # in one direction of two


def _profile(values: Floats, plane: Floats, rough: Sections) -> tuple[PchipInterpolator, PchipInterpolator]:
    """Return the planes' common profile, 1 in the middle and 0 far out, and its slope (1/mm), over radius."""
    r = np.linalg.norm(plane[None] - rough.shifts[:, None], axis=2)
    rim = np.nanmedian(np.where(r > 0.8 * r.max(axis=1, keepdims=True), values, np.nan), axis=1)
    inner = np.nanmean(np.where(r < 2 * GRID, values, np.nan), axis=1)
    over = inner - rim
    good = over > 0.3 * np.median(over)
    scaled = (values[good] - rim[good, None]) / over[good, None]
    ring = np.rint(r[good] / RING).astype(int)
    last = int(ring.max())
    level = np.array([_middle(scaled[ring == n]) for n in range(last + 1)])
    radii = np.arange(last + 1) * RING
    known = np.isfinite(level)
    level = np.minimum.accumulate(level[known])  # brightest in the middle
    level = np.clip(level - level[-1], 0, None)
    radii = radii[known]
    mirrored = np.concatenate([-radii[:0:-1], radii]), np.concatenate([level[:0:-1], level])
    profile = PchipInterpolator(*mirrored)
    return profile, profile.derivative()


def _middle(values: Floats) -> float:
    values = values[np.isfinite(values)]
    return float(np.median(values)) if values.size else np.nan
