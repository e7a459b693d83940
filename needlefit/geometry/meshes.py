"""The largest closed part of a mesh, and the pixels inside closed outlines."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from needlefit.arrays import Floats
from needlefit.geometry.surfaces import Surface, make_mesh


def extract_solid(name: str, vertices: ArrayLike, faces: ArrayLike, into: int) -> tuple[Surface, float]:
    """Return the largest component of a mesh as an outward-facing solid, and the volume share of the other
    components.

    `vertices`: (V, 3); mm.
    `faces`: (F, 3); triangles with consistent orientation; every component is closed, and cavities are
    oriented inward.
    """
    pieces = make_mesh(vertices, faces).split(only_watertight=False, repair=False)
    # the volume of a piece is negative if its triangles face inward
    largest, *others = sorted(pieces, key=lambda piece: -abs(float(piece.volume)))
    if largest.volume < 0:
        largest.invert()
    loose = sum(abs(float(piece.volume)) for piece in others)
    return Surface(name, largest, "solid", into), loose / float(largest.volume)


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
