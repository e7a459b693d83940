"""Mark the voxels inside closed outlines and closed surfaces."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats

if TYPE_CHECKING:
    import trimesh

_SHIFT = np.array([1.3e-5, 1.7e-5, 2.3e-5])
"""Voxels by which a surface is moved before it is cut: no vertex shall lie exactly in a plane of centres."""


def fill_outline(lines: Floats, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return the pixels (J, I) whose centres lie inside an odd number of closed outlines.

    Parameters
    ----------
    lines : (L, 2, 2) array
        Ends of the pieces of the outlines: column and row, whole at the centres of pixels.
    """
    rows, columns = shape
    low, high = np.sort(lines[:, :, 1], axis=1).T
    first = np.clip(np.ceil(low), 0, rows).astype(np.int64)
    counts = np.clip(np.ceil(high), 0, rows).astype(np.int64) - first
    piece = np.repeat(np.arange(len(lines)), counts)
    row = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts) + first[piece]
    (x0, y0), (x1, y1) = lines[piece, 0].T, lines[piece, 1].T
    crossing = x0 + (row - y0) / (y1 - y0) * (x1 - x0)  # a piece along a row has no rows: counts is 0
    column = np.clip(np.ceil(crossing), 0, columns).astype(np.int64)
    turns = np.zeros((rows, columns + 1), dtype=np.int32)
    np.add.at(turns, (row, column), 1)
    inside: NDArray[np.bool_] = np.cumsum(turns, axis=1)[:, :columns] % 2 == 1
    return inside


def fill_mesh(mesh: "trimesh.Trimesh", size: tuple[int, int, int]) -> NDArray[np.bool_]:
    """Return the voxels (K, J, I) whose centres lie inside a closed surface.

    Parameters
    ----------
    mesh : Trimesh
        Its vertices are voxel indices i, j, k.
    size : tuple of int
        Voxels along i, j, k.
    """
    import trimesh  # takes its time to load, and outlines need none

    columns, rows, slices = size
    inside = np.zeros((slices, rows, columns), dtype=np.bool_)
    moved = trimesh.Trimesh(mesh.vertices + _SHIFT, mesh.faces, process=False)
    low, high = moved.bounds[:, 2]
    for k in range(max(0, int(np.ceil(low))), min(slices, int(np.floor(high)) + 1)):
        lines = trimesh.intersections.mesh_plane(moved, (0.0, 0.0, 1.0), (0.0, 0.0, float(k)))
        inside[k] = fill_outline(lines[:, :, :2], (rows, columns))
    return inside
