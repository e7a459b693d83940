"""Select the needle among the tubes of a scan, and name the others."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from needlefit.arrays import Floats
from needlefit.errors import DataError
from needlefit.imaging.needle.segmentation import Component, find_tubes, principal_axes
from needlefit.imaging.volume import Volume, to_patient
from needlefit.schemas.reconstruction import ReconstructionRecord

MIN_SECOND_NEEDLE_RATIO = 0.6
"""A second tube of at least this part of the needle's length and brightness may be the needle, too."""

CLEAR_WIDTH_RATIO = 1.5
"""Of two such tubes that of the stated diameter is the needle if the other misses it by so much more."""

MAX_PICK_DISTANCE_MM = 5.0
"""A point stated on the needle lies at most so far from it, mm."""

PICK_FIX = (
    "state a point on the needle that is meant (LPS) in a table of scans: needle_x_mm, needle_y_mm, "
    "needle_z_mm; or crop the scan, or give a mask"
)


@dataclass(frozen=True)
class NeedleSelection:
    """The needle, the other tubes, and what a person should know."""

    needle: Component
    others: tuple[Component, ...] = ()
    warnings: tuple[str, ...] = ()


def segment_needle(volume: Volume, recipe: ReconstructionRecord) -> Component:
    """Return the component that is the needle; see `select_needle`."""
    return select_needle(volume, recipe).needle


def select_needle(
    volume: Volume, recipe: ReconstructionRecord, point: Floats | None = None
) -> NeedleSelection:
    """Return the needle: the tube at `point` (LPS, mm) if it is stated, else the longest.

    Raises
    ------
    DataError
        If nothing is as bright as metal, no component is a tube, another tube may be the needle, too, or
        none is at the point.
    """
    tubes = find_tubes(volume, recipe)
    if point is None:
        needle = _choose_longest(volume, tubes, recipe.needle.diameter_mm)
    else:
        needle = _choose_at(volume, tubes, point)
    others = tuple(part for part in tubes if part is not needle)
    if not others:
        return NeedleSelection(needle)
    listed = "; ".join(describe_tube(volume, part) for part in others)
    note = f"beside the needle ({describe_tube(volume, needle)}) the scan holds {listed}"
    return NeedleSelection(needle, others, (note,))


def describe_tube(volume: Volume, part: Component) -> str:
    """Return the measures of a tube in words."""
    ends = find_ends(volume, part)
    first, last = (", ".join(f"{x:.0f}" for x in end) for end in ends)
    return f"a tube of {part.length:.0f} mm, {part.width:.1f} mm wide, from L, P, S = {first} to {last} mm"


def find_ends(volume: Volume, part: Component) -> Floats:
    """Return the two ends (2, 3) of a component along its main axis, LPS, mm."""
    points = to_patient(volume, part.voxels)
    center, axes = principal_axes(points)
    along = (points - center) @ axes[0]
    return points[[int(np.argmin(along)), int(np.argmax(along))]]


def _choose_at(volume: Volume, tubes: Sequence[Component], point: Floats) -> Component:
    distances = [float(cKDTree(to_patient(volume, part.voxels)).query(point)[0]) for part in tubes]
    nearest = int(np.argmin(distances))
    if distances[nearest] > MAX_PICK_DISTANCE_MM:
        listed = "; ".join(describe_tube(volume, part) for part in tubes)
        raise DataError(
            f"no tube passes the stated point of the needle; there is {listed}",
            where="needle_x_mm, needle_y_mm, needle_z_mm",
            expected=f"a tube within {MAX_PICK_DISTANCE_MM:g} mm of it",
            fix="correct the point (LPS of the scan, mm), or leave the three cells empty",
        )
    return tubes[nearest]


def _choose_longest(volume: Volume, tubes: Sequence[Component], diameter: float) -> Component:
    """Return the longest tube, unless another one of nearly its length is nearer to the diameter."""
    first = tubes[0]
    level = MIN_SECOND_NEEDLE_RATIO * _mean_hu(volume, first)
    alternatives = [
        part
        for part in tubes
        if part.length >= MIN_SECOND_NEEDLE_RATIO * first.length and _mean_hu(volume, part) >= level
    ]
    alternatives.sort(key=lambda part: abs(np.log(part.width / diameter)))
    if len(alternatives) == 1:
        return first
    if _miss(alternatives[1], diameter) >= CLEAR_WIDTH_RATIO * _miss(alternatives[0], diameter):
        return alternatives[0]
    raise DataError(
        f"{len(alternatives)} needles: {'; '.join(describe_tube(volume, part) for part in alternatives)}",
        expected="one needle",
        fix=PICK_FIX,
    )


def _miss(part: Component, diameter: float) -> float:
    """Return by what factor the width of a tube misses the diameter."""
    return float(np.exp(abs(np.log(part.width / diameter))))


def _mean_hu(volume: Volume, part: Component) -> float:
    i, j, k = part.voxels.T
    return float(np.mean(volume.values[k, j, i]))
