"""Build meshes, and mark the voxels inside closed outlines and closed surfaces."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from needlefit.arrays import Floats, are_bounded
from needlefit.errors import refusal
from needlefit.geometry.frames import PARALLEL_SINE, normalize
from needlefit.geometry.surfaces import Surface, make_mesh

TUBE_FACETS = 12  # number of corners of a tube's cross-section


def make_tube(
    points: ArrayLike, half_widths: ArrayLike, toward: ArrayLike
) -> tuple[Floats, NDArray[np.int64]]:
    """Return vertices (V, 3) and triangles (F, 3), which face outward, of a tube of elliptic cross-sections.

    `points`: (N, 3); its axis, mm; neighbours differ.
    `half_widths`: (N, 2) or what broadcasts to it; semi-axes of each cross-section, mm: along `toward`, and
    across it.
    `toward`: (3,); the first semi-axis, as far as it is normal to the curve.

    DataError if there are fewer than two points, two neighbours coincide, or the curve runs along `toward`.
    """
    axis = np.asarray(points, dtype=np.float64)
    count = len(axis)
    if count < 2 or not are_bounded(axis):
        raise refusal(f"""a tube along {count} points
            expected: two finite points or more""")
    first, second = _find_cross_sections(axis, toward)
    widths = np.broadcast_to(np.asarray(half_widths, dtype=np.float64), (count, 2))
    angle = 2 * np.pi * np.arange(TUBE_FACETS) / TUBE_FACETS
    rim = np.stack([np.cos(angle), np.sin(angle)], axis=1)  # (TUBE_FACETS, 2)
    arms = np.stack([first, second], axis=1) * widths[:, :, None]  # (N, 2, 3)
    vertices = axis[:, None, :] + np.einsum("fk,nkd->nfd", rim, arms)  # (N, TUBE_FACETS, 3)
    ends = np.stack([axis[0], axis[-1]])
    i = np.arange(TUBE_FACETS)
    j = (i + 1) % TUBE_FACETS
    side = np.vstack(
        [np.column_stack([i, j, j + TUBE_FACETS]), np.column_stack([i, j + TUBE_FACETS, i + TUBE_FACETS])]
    )
    wall = (side[None] + TUBE_FACETS * np.arange(count - 1)[:, None, None]).reshape(-1, 3)
    last, centre = TUBE_FACETS * (count - 1), TUBE_FACETS * count
    bottom = np.column_stack([j, i, np.full(TUBE_FACETS, centre)])
    top = np.column_stack([i + last, j + last, np.full(TUBE_FACETS, centre + 1)])
    return np.vstack([vertices.reshape(-1, 3), ends]), np.vstack([wall, bottom, top])


def write_ply(vertices: ArrayLike, faces: ArrayLike, path: Path, comments: Sequence[str] = ()) -> None:
    """Write vertices (V, 3), in LPS, and triangles (F, 3) as binary PLY, float32.

    The header states `SPACE=LPS`, which 3D Slicer reads; `comments` stand beside it.
    """
    places, corners = np.asarray(vertices, dtype="<f4"), np.asarray(faces)
    rows = np.zeros(len(corners), dtype=[("count", "u1"), ("index", "<i4", 3)])
    rows["count"], rows["index"] = 3, corners
    lines = [
        *("ply", "format binary_little_endian 1.0", "comment SPACE=LPS"),
        *(f"comment {line}" for line in comments),
        *(f"element vertex {len(places)}", *(f"property float {axis}" for axis in "xyz")),
        *(f"element face {len(rows)}", "property list uchar int vertex_indices", "end_header\n"),
    ]
    path.write_bytes("\n".join(lines).encode("ascii", "replace") + places.tobytes() + rows.tobytes())


def _find_cross_sections(axis: Floats, toward: ArrayLike) -> tuple[Floats, Floats]:
    """Return the two unit normals (N, 3) of each cross-section; with the tangent they are right-handed."""
    steps = np.diff(axis, axis=0)
    lengths = np.linalg.norm(steps, axis=1, keepdims=True)
    if not (lengths > 0).all():
        raise refusal("""two neighbouring points of a curve coincide
            expected: points that differ
            fix: remove the repeated points""")
    steps = steps / lengths
    # Neighbouring cross-sections share the bisecting plane, so that the tube does not fold at bends.
    tangents = np.vstack([steps[:1], steps[1:] + steps[:-1], steps[-1:]])
    first = normalize(toward) - tangents * (
        (tangents @ normalize(toward)) / np.maximum(np.sum(tangents**2, axis=1), PARALLEL_SINE)
    ).reshape(-1, 1)
    size = np.linalg.norm(first, axis=1, keepdims=True)
    if not (size > PARALLEL_SINE).all():
        raise refusal("""the curve runs along the direction that its cross-sections are to have
            expected: a direction across the needle""")
    first = first / size
    second = np.cross(tangents, first)
    return first, second / np.linalg.norm(second, axis=1, keepdims=True)


def extract_solid(name: str, vertices: ArrayLike, faces: ArrayLike, into: int) -> tuple[Surface, float]:
    """Return the largest component of a mesh as an outward-facing solid, and the volume share of the other
    components.

    `vertices`: (V, 3); mm.
    `faces`: (F, 3); triangles with consistent orientation; every component is closed, and cavities are
    oriented inward.
    """
    points, corners = np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int64)
    i, j = np.hstack([corners[:, :2].T, corners[:, 1:].T])
    links = scipy.sparse.coo_array((np.ones(len(i)), (i, j)), shape=(len(points), len(points)))
    pieces = scipy.sparse.csgraph.connected_components(links, directed=False)[1][corners[:, 0]]  # (F,)
    a, b, c = (points[corners[:, k]] for k in range(3))
    # Volume of the tetrahedra from the origin to each triangle: for a closed component their sum is its
    # volume, negative if its triangles face inward.
    volumes = np.bincount(pieces, np.einsum("fk,fk->f", a, np.cross(b, c)) / 6)
    largest = int(np.argmax(np.abs(volumes)))
    largest_faces = corners[pieces == largest]
    used, largest_faces = np.unique(largest_faces, return_inverse=True)
    largest_faces = largest_faces.reshape(-1, 3)
    if volumes[largest] < 0:
        largest_faces = largest_faces[:, ::-1]
    others = float(np.abs(volumes).sum() / abs(volumes[largest])) - 1.0
    return Surface(name, make_mesh(points[used], largest_faces), "solid", into), others


def fill_outline(lines: Floats, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return the pixels (J, I) whose centres lie inside an odd number of closed outlines.

    `lines`: (L, 2, 2); ends of the pieces of the outlines: column and row, whole at the centres of pixels.
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
    return np.cumsum(turns, axis=1)[:, :columns] % 2 == 1
