"""The largest closed part of a mesh."""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from needlefit.geometry.surfaces import Surface


def extract_solid(name: str, vertices: ArrayLike, faces: ArrayLike, into: int) -> tuple[Surface, float]:
    """Return the largest component of a mesh as an outward-facing solid, and the volume share of the other
    components.

    `vertices`: (V, 3); mm.
    `faces`: (F, 3); triangles with consistent orientation; every component is closed, and cavities are
    oriented inward.
    """
    whole = Surface(name, np.asarray(vertices, np.float64), np.asarray(faces, np.int64), "solid", into)
    pieces = [
        Surface(name, np.array(piece.vertices, np.float64), np.array(piece.faces, np.int64), "solid", into)
        for piece in whole.to_trimesh().split(only_watertight=False, repair=False)
    ]
    # the volume of a piece is negative if its triangles face inward
    largest, *others = sorted(pieces, key=lambda piece: -abs(piece.volume))
    if largest.volume < 0:
        largest = replace(largest, faces=largest.faces[:, ::-1])
    return largest, sum(abs(piece.volume) for piece in others) / largest.volume
