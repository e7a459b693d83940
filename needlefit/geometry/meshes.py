"""The largest closed part of a mesh."""

from numpy.typing import ArrayLike

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
