"""Compute how much of each voxel is metal: supersampled where a surface passes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.spatial import cKDTree

from needlefit.arrays import Floats
from needlefit.geometry.curves import arc_length
from needlefit.geometry.frames import normalize
from needlefit.imaging.volume import VoxelGrid
from needlefit.synthetic.ct_scene import Needle3D, SceneMarkers

SUBVOXELS_PER_EDGE = 5
"""Points per voxel edge."""

AXIS_SPACING_MM = 0.05
"""Spacing of the axis' points among which the nearest is searched, mm."""


@dataclass(frozen=True)
class MetalVoxels:
    """Voxels (N, 3) (i, j, k) with metal, the metal fraction `part` (N,) of each, and its `hu`."""

    voxels: NDArray[np.int64]
    part: Floats
    hu: float


def voxelize_needle(needle: Needle3D, grid: VoxelGrid) -> MetalVoxels:
    """Return the metal voxels of a bevelled needle.

    Within half a voxel of the axis' nearest point the needle is straight: over 0.5 mm an axis of radius
    200 mm strays by less than a micrometre.
    """
    axis = densify(needle.points)
    reach = needle.diameter / 2 + float(np.linalg.norm(grid.spacing)) / 2
    voxels = _voxels_near(axis, reach, grid)
    centers = (voxels * grid.spacing) @ grid.direction.T + grid.origin
    _, nearest = cKDTree(axis).query(centers)
    tangents = np.gradient(axis, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    along, side = arc_length(axis), bevel_side(needle)
    part = np.zeros(len(voxels))
    for offset in _subvoxel_offsets(grid):
        d = centers + offset - axis[nearest]  # (N, 3)
        a = np.einsum("ni,ni->n", d, tangents[nearest])
        across = d - a[:, None] * tangents[nearest]
        # how far the bevel's plane lies behind the point, at this position across the axis
        cut = (needle.diameter / 2 - across @ side) / np.tan(np.deg2rad(needle.bevel_deg))
        s = along[nearest] + a
        inside = _inside_fraction(needle.diameter / 2 - np.sqrt(np.einsum("ni,ni->n", across, across)), grid)
        part += inside * _inside_fraction(s, grid) * _inside_fraction(along[-1] - cut - s, grid)
    return _nonzero_voxels(voxels, part, needle.hu)


def voxelize_balls(markers: SceneMarkers, grid: VoxelGrid) -> MetalVoxels:
    """Return the metal voxels of the marker balls."""
    reach = markers.radius + float(np.linalg.norm(grid.spacing)) / 2
    voxels = _voxels_near(markers.centers, reach, grid)
    centers = (voxels * grid.spacing) @ grid.direction.T + grid.origin
    tree = cKDTree(markers.centers)
    part = np.zeros(len(voxels))
    for offset in _subvoxel_offsets(grid):
        part += _inside_fraction(np.asarray(markers.radius - tree.query(centers + offset)[0]), grid)
    return _nonzero_voxels(voxels, part, markers.hu)


def densify(points: Floats) -> Floats:
    """Return the cubic spline through `points` (N, 3), sampled every `AXIS_SPACING_MM` mm: (M, 3)."""
    s = arc_length(points)
    spline = make_interp_spline(s, points, k=min(3, len(points) - 1))
    fine: Floats = spline(np.linspace(0, s[-1], int(np.ceil(s[-1] / AXIS_SPACING_MM)) + 1))
    return fine


def bevel_side(needle: Needle3D) -> Floats:
    """Return the unit vector (3,) across the axis at the tip, toward the point of the bevel."""
    end = densify(needle.points)[-3:]
    tangent = normalize(end[-1] - end[0])
    return normalize(needle.bevel_toward - (needle.bevel_toward @ tangent) * tangent, "the bevel's side")


def _nonzero_voxels(voxels: NDArray[np.int64], part: Floats, hu: float) -> MetalVoxels:
    """Return the voxels whose sub-points sum up to a `part` that is not nothing."""
    return MetalVoxels(voxels[part > 0], part[part > 0] / SUBVOXELS_PER_EDGE**3, hu)


def _inside_fraction(depth: Floats, grid: VoxelGrid) -> Floats:
    """Return the part of a sub-voxel whose centre lies `depth` (mm) inside: no face snaps to the lattice."""
    part: Floats = np.clip(depth / (np.mean(grid.spacing) / SUBVOXELS_PER_EDGE) + 0.5, 0, 1)
    return part


def _subvoxel_offsets(grid: VoxelGrid) -> Floats:
    """Return the places of a voxel's sub-points relative to its centre (n, 3), mm, patient."""
    steps = (np.arange(SUBVOXELS_PER_EDGE) + 0.5) / SUBVOXELS_PER_EDGE - 0.5
    mesh = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    offsets: Floats = (mesh * grid.spacing) @ grid.direction.T
    return offsets


def _voxels_near(points: Floats, reach: float, grid: VoxelGrid) -> NDArray[np.int64]:
    """Return the voxels (N, 3) inside the grid whose centres may lie within `reach` of `points` (M, 3)."""
    seeds = np.unique(
        np.rint((points - grid.origin) @ grid.direction / grid.spacing).astype(np.int64), axis=0
    )
    margin = np.ceil(reach / grid.spacing).astype(int) + 1
    block = np.stack(np.meshgrid(*[np.arange(-m, m + 1) for m in margin], indexing="ij"), axis=-1)
    ball = np.linalg.norm(block * grid.spacing, axis=-1) <= reach + np.linalg.norm(grid.spacing) / 2
    voxels = (seeds[:, None] + block[ball]).reshape(-1, 3)
    inside = voxels[np.all((voxels >= 0) & (voxels < grid.size), axis=1)]
    flat = np.unique(np.ravel_multi_index(tuple(inside.T), grid.size))
    near: NDArray[np.int64] = np.column_stack(np.unravel_index(flat, grid.size))
    return near
