"""List what a person may take for the needle, and pick the one at a place."""

import numpy as np
from scipy.spatial import cKDTree

from needlefit.arrays import Floats
from needlefit.errors import DataError
from needlefit.imaging.needle.segmentation import (
    Component,
    find_components,
    is_tube,
    list_thresholds,
    principal_axes,
)
from needlefit.imaging.volume import Volume, to_patient
from needlefit.schemas.reconstruction import ReconstructionRecord

MAX_CANDIDATES = 8
"""Bright components that are listed, the longest first."""

MAX_PICK_DISTANCE_MM = 3.0
"""A component is picked from at most so far away, mm."""

LINE_POINTS = 25
"""Points of the line that shows a component."""


def list_candidates(volume: Volume, recipe: ReconstructionRecord) -> list[Component]:
    """Return the bright components of a volume, tubes first, the longest first.

    Raises
    ------
    DataError
        If nothing in the volume is bright enough.
    """
    found: list[Component] = []
    for low, high in list_thresholds(volume, recipe):
        found = find_components(volume, low, high)
        if any(is_tube(part, recipe) for part in found):
            break
    found.sort(key=lambda part: (is_tube(part, recipe), part.length), reverse=True)
    return found[:MAX_CANDIDATES]


def pick_component(volume: Volume, point: Floats, recipe: ReconstructionRecord) -> Component:
    """Return the bright component at or next to a point (3,), LPS, mm.

    Raises
    ------
    DataError
        If none is near.
    """
    nearest = np.inf
    for low, high in list_thresholds(volume, recipe):
        for part in find_components(volume, low, high):
            away = float(cKDTree(to_patient(volume, part.voxels)).query(point)[0])
            if away <= MAX_PICK_DISTANCE_MM:
                return part
            nearest = min(nearest, away)
    raise DataError(
        f"nothing as bright as metal is there; the nearest such voxel lies {nearest:.1f} mm away",
        where=f"L, P, S = {', '.join(f'{x:.1f}' for x in point)} mm",
        expected=f"a bright voxel within {MAX_PICK_DISTANCE_MM:g} mm",
        fix="pick a voxel on the needle, or set lower thresholds in the recipe",
    )


def draw_line(volume: Volume, part: Component) -> Floats:
    """Return the middle line of a component (N, 3), LPS, mm, from one end to the other."""
    points = to_patient(volume, part.voxels)
    center, axes = principal_axes(points)
    along = (points - center) @ axes[0]
    edges = np.linspace(along.min(), along.max(), LINE_POINTS)
    piece = np.clip(np.digitize(along, edges) - 1, 0, LINE_POINTS - 2)
    counts = np.bincount(piece, minlength=LINE_POINTS - 1)
    sums = np.stack([np.bincount(piece, axis, LINE_POINTS - 1) for axis in points.T], axis=1)
    line: Floats = sums[counts > 0] / counts[counts > 0, None]
    return line
