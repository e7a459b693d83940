"""What speaks against the layers that a needle was found to meet."""

from collections.abc import Iterator, Sequence

import numpy as np

from needlefit.errors import DataError
from needlefit.geometry.crossings import crossings, surface_hits
from needlefit.geometry.enclosure import enclosed_length
from needlefit.geometry.frames import Floats, Frame
from needlefit.geometry.patient import SIGNS
from needlefit.geometry.surfaces import Surface, moved, nearest
from needlefit.imaging.reconstruction import Layers
from needlefit.imaging.scan import Scan

TUNNEL = 2.0
"""Nearer than this, mm, nothing in the tissue runs around a needle but what was drawn around it."""

LONG = 2 * TUNNEL
"""A surface runs along a needle from this length on, mm: no ball of that radius is passed through so long."""


def refuse_tunnels(scan: Scan, surfaces: Sequence[Surface], needle: Floats) -> None:
    """Refuse layers drawn around a needle (N, 3), world, from base to tip.

    Where metal was left out of a segmentation, the needle lies in a tunnel of each layer, and crosses their
    surfaces where the tunnels end: anywhere.

    Raises
    ------
    DataError
        If a surface, the tissue's own or another, runs around the needle.
    """
    lengths = [(surface.name, enclosed_length(needle, surface, TUNNEL)) for surface in surfaces]
    around = [f"{name} (along {length:.0f} mm)" for name, length in lengths if length >= LONG]
    if around:
        raise DataError(
            f"the layers run around the needle, so that it does not cross them: {', '.join(around)}",
            where=str(scan.volume),
            expected="surfaces that the needle passes through",
            mend="label the needle's voxels as the tissue around them, e.g. in 3D Slicer's Segment "
            "Editor by Smoothing, Closing (fill holes), with a kernel wider than the needle, for each layer",
        )


def doubts(scan: Scan, layers: Layers, points: Floats, patient: Frame) -> tuple[str, ...]:
    """Return what a person should know of the layers met by a needle (N, 3), world.

    Nothing, where there are as many as somebody counted.

    Parameters
    ----------
    patient : Frame
        The scan's LPS axes and origin in the world.

    Raises
    ------
    DataError
        If somebody counted the layers and these are not as many.
    """
    counted = {number for number in (scan.layers, scan.layers_alternative) if number is not None}
    if len(layers.sequence) in counted:
        return ()
    said = tuple(_doubts(layers, points, patient))
    if not counted:
        return said
    depths = ", ".join(f"{depth:.2f}" for depth in layers.boundaries) or "none"
    order = " > ".join(map(str, layers.sequence))
    expected = " or ".join(map(str, sorted(counted)))
    raise DataError(
        f"{scan.id} meets {len(layers.sequence)} layers ({order}; interfaces at {depths} mm), "
        f"but {expected} were counted" + "".join(f"; {one}" for one in said),
        where=str(scan.volume),
        expected=f"{expected} layers",
        mend="correct the count or the surfaces; look at both together in 3D Slicer",
    )


def _doubts(layers: Layers, points: Floats, patient: Frame) -> Iterator[str]:
    for surface in layers.surfaces:
        if surface.kind == "sheet" and not len(surface_hits(points, surface)):
            beside = _beside(points, surface)
            if beside is not None:
                yield f"the needle passes {beside:.1f} mm beside the sheet {surface.name}: it is too small"
    beyond = [surface for surface in layers.surfaces if surface.into > 1]
    if beyond and not len(layers.boundaries):
        away = nearest(points, beyond).distances
        yield f"the needle crosses no layer; the nearest surface stays {away.min():.1f} mm away"
        if _crossed_in_ras(layers, points, patient):
            yield "the needle would cross layers if their files were in RAS: save them in LPS"


def _beside(points: Floats, surface: Surface) -> float | None:
    """Return how far from a sheet a needle goes through its mean plane, mm; None if it does not."""
    vertices = np.asarray(surface.mesh.vertices, dtype=np.float64)
    centre = vertices.mean(axis=0)
    normal = np.linalg.svd(vertices - centre, full_matrices=False)[2][2]
    heights = (points - centre) @ normal
    passes = np.flatnonzero(np.signbit(heights[1:]) != np.signbit(heights[:-1]))
    if len(passes) == 0:
        return None
    n = int(passes[0])
    part = heights[n] / (heights[n] - heights[n + 1])
    place = points[n] + part * (points[n + 1] - points[n])
    return float(nearest(place, [surface]).distances[0])


def _crossed_in_ras(layers: Layers, points: Floats, patient: Frame) -> bool:
    """Say whether surfaces whose x and y have the other sign in the patient would be crossed."""
    turn = patient.rotation @ np.diag(SIGNS["RAS"]) @ patient.rotation.T
    turned = Frame(patient.origin - turn @ patient.origin, turn)
    flipped = [moved(surface, turned) for surface in layers.surfaces]
    return len(crossings(points, flipped).sequence) > 1
