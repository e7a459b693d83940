"""What speaks against the layers that a needle was found to meet."""

from collections.abc import Iterator

import numpy as np

from needlefit.errors import DataError
from needlefit.geometry.crossings import crossings, surface_hits
from needlefit.geometry.frames import Floats, Frame
from needlefit.geometry.patient import SIGNS
from needlefit.geometry.surfaces import Surface, moved, nearest
from needlefit.imaging.reconstruction import Layers
from needlefit.imaging.scan import Scan

TUNNEL = 2.0
"""A surface that stays nearer than this, mm, along half of a needle was drawn around it."""


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
        if np.median(away) < TUNNEL:
            yield "the surfaces go along the needle: label its voxels as the tissue around them"


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
