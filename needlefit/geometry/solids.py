"""A closed surface from raw triangles, as marching cubes leaves them."""

import numpy as np
import trimesh
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from needlefit.geometry.surfaces import Surface


def closed(name: str, vertices: ArrayLike, faces: ArrayLike, into: int) -> tuple[Surface, float]:
    """Return the largest piece of a mesh as a solid, turned outward, and what the others take up beside it.

    Parameters
    ----------
    vertices : (V, 3) array
        mm.
    faces : (F, 3) array of int
        Triangles, turned alike; every piece closed, pieces within another ones (cavities) the other way.

    Returns
    -------
    Surface
    float
        Volume of all other pieces, islands and cavities, as a part of that of the largest.
    """
    points, corners = np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int64)
    i, j = np.hstack([corners[:, :2].T, corners[:, 1:].T])
    links = coo_array((np.ones(len(i)), (i, j)), shape=(len(points), len(points)))
    pieces = connected_components(links, directed=False)[1][corners[:, 0]]  # (F,)
    a, b, c = (points[corners[:, k]] for k in range(3))
    volumes = np.bincount(pieces, np.einsum("fk,fk->f", a, np.cross(b, c)) / 6)
    largest = int(np.argmax(np.abs(volumes)))
    kept = corners[pieces == largest]
    used, kept = np.unique(kept, return_inverse=True)
    kept = kept.reshape(-1, 3)
    if volumes[largest] < 0:
        kept = kept[:, ::-1]
    others = float(np.abs(volumes).sum() / abs(volumes[largest])) - 1.0
    return Surface(name, trimesh.Trimesh(points[used], kept, process=False), "solid", into), others
