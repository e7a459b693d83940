"""Follow a needle along points on it, placed or taken from a mask, where no threshold separates it."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator

from needlefit.arrays import Floats
from needlefit.errors import DataError, located
from needlefit.geometry.curves import arc_length
from needlefit.imaging.constants import HU, MM, PART
from needlefit.imaging.needle.axis_spline import (
    FEWEST,
    ROUNDS,
    AxisSpline,
    find_sections,
    fit_axis,
    frames_along,
)
from needlefit.imaging.needle.segmentation import Component, measure_component, principal_axes
from needlefit.imaging.volume import Volume, measure_face_distance, to_index, to_patient
from needlefit.imaging.volume_files import read_volume
from needlefit.schemas.reconstruction import ReconstructionRecord

MIN_POINTS = 3  # smallest number of points: fewer do not show which way a needle bends
# distance (mm) of the places at which the needle is looked for; of a mask, or of what a threshold shows, one
# point is taken over twice that
STEP_MM = 2 * MM.STATION


def read_mask_points(path: Path) -> Floats:
    """Return points (N, 3), LPS, mm, along the needle that a mask marks: what is above 0 in a volume.

    The mask is an image file, or a .zip of one; it may stand on other voxels than the scan's.

    DataError if it marks nothing.
    """
    mask = read_volume(path)
    with located(path):
        marked = to_patient(mask, np.argwhere(mask.values > 0)[:, ::-1])
        if len(marked) < FEWEST:
            raise DataError(
                f"the mask marks {len(marked)} voxels",
                expected="the needle's voxels above 0, all others 0",
                fix="segment the needle in this scan, and save the segmentation as NRRD or NIfTI",
            )
        return _average_pieces(marked, np.ones(len(marked)))


def follow_points(volume: Volume, points: Floats, recipe: ReconstructionRecord) -> AxisSpline:
    """Return the rough axis of the needle on which points (N, 3), LPS, mm, lie, from end to end.

    The points may be in any order. DataError if they are fewer than `MIN_POINTS`, or no needle shows there.
    """
    points = np.unique(points, axis=0)
    if len(points) < MIN_POINTS:
        raise DataError(
            f"{len(points)} points are on the needle",
            expected=f"at least {MIN_POINTS}, from end to end: it is followed along these alone",
            fix="place more points on the needle, or move those of --corrections back",
            where="points on the needle",
        )
    center, axes = principal_axes(points)
    with located("what lies between points on the needle"):
        return _follow(volume, points[np.argsort((points - center) @ axes[0])], recipe)


def follow_tube(volume: Volume, tube: Component, recipe: ReconstructionRecord) -> AxisSpline:
    """Return the rough axis of the needle of which `tube` is the part that a threshold shows.

    DataError if too little of its surroundings lies in the volume.
    """
    with located("what a threshold shows of the needle"):
        return _follow(volume, list_middles(tube), recipe)


def list_middles(tube: Component) -> Floats:
    """Return points (N, 3), LPS, mm, in the middle of what a threshold shows."""
    return _average_pieces(tube.points, tube.values - tube.values.min() + 1.0)


def _average_pieces(points: Floats, weights: Floats) -> Floats:
    """Return the weighted means (M, 3) of points (N, 3) in pieces of `2 * STEP_MM` along their main axis."""
    center, axes = principal_axes(points)
    along = (points - center) @ axes[0]
    piece = np.floor((along - along.min()) / (2 * STEP_MM)).astype(int)
    mass = np.bincount(piece, weights)
    moments = np.stack([np.bincount(piece, weights * axis) for axis in points.T], axis=1)
    return moments[mass > 0] / mass[mass > 0, None]


def _follow(volume: Volume, points: Floats, recipe: ReconstructionRecord) -> AxisSpline:
    s = arc_length(points)
    count = max(2, round(float(s[-1]) / STEP_MM) + 1)
    places = PchipInterpolator(s, points)(np.linspace(0.0, s[-1], count))
    for _ in range(ROUNDS):  # to the needle's middle; where it is faint they stay
        shifts, amplitude, _ = find_sections(volume, frames_along(places), recipe.needle.diameter_mm)
        shown = amplitude > PART.FAINT * np.median(amplitude)
        places = places + np.where(shown[:, None], shifts, 0.0)
    level = float(np.median(amplitude))
    if level < HU.METAL_CONTRAST / 2 or shown.mean() < PART.SHOWN:
        away = float(np.median(measure_face_distance(volume, places)))
        if away < 0:
            problem = "lies outside the volume"
        elif away < MM.PATCH:
            problem = f"lies {away:.1f} mm from the volume's face: its surroundings are outside"
        else:
            dark = 100 * (1 - shown.mean())
            problem = f"is {level:.0f} HU brighter than its surroundings, and faint on {dark:.0f} %"
        raise DataError(
            problem,
            expected=f"a needle, and {MM.PATCH:g} mm of what surrounds it",
            fix="scan more around it; take back points that are not on it: RAS has x and y of the other sign",
        )
    places = places[shown]
    before = [*_extend(volume, places[::-1], level, recipe)]
    whole = np.array([*before[::-1], *places, *_extend(volume, places, level, recipe)])
    s = arc_length(whole)
    return fit_axis(s, whole, np.ones(len(whole)), 2 * MM.KNOT)


def select_axis_voxels(volume: Volume, axis: AxisSpline) -> Component:
    """Return the voxels on an axis: what hangs together with one of them is the needle."""
    middle = axis.spline(np.arange(0.0, axis.length, float(volume.spacing.min()) / 2))
    index = np.unique(np.rint(to_index(volume, middle)).astype(np.int64), axis=0)
    inside = ((index >= 0) & (index < np.array(volume.grid.size))).all(axis=1)
    return measure_component(volume, index[inside])


def _extend(volume: Volume, places: Floats, level: float, recipe: ReconstructionRecord) -> Iterator[Floats]:
    """Yield the places of the needle beyond the last of `places` (N, 3), until it is faint or ends.

    A guide of metal that is stated may hide it.
    """
    known, faint, hidden = list(places), 0.0, 0.0
    thickness = recipe.guide.thickness_mm or 0.0
    while faint <= MM.EDGE_BLUR and hidden <= thickness + 2 * MM.BEYOND_END:
        recent = np.array(known[-round(2 * MM.KNOT / STEP_MM) :])
        middle, (way, *_) = principal_axes(recent)
        way = way * np.sign(way @ (recent[-1] - recent[0]))
        here = middle + way * ((recent[-1] - middle) @ way + STEP_MM + faint + hidden)
        where = frames_along(np.stack([here - way, here, here + way]))
        shifts, amplitude, around = find_sections(volume, where, recipe.needle.diameter_mm)
        beside = float(np.linalg.norm(shifts[1]))
        if (
            amplitude[1] > min(PART.FAINT * level, HU.METAL_CONTRAST / 2)
            and beside < recipe.needle.diameter_mm
        ):
            known.append(here + shifts[1])
            yield known[-1]
            faint = hidden = 0.0
        elif thickness and around[1] > HU.METAL:
            hidden += STEP_MM
        else:
            faint += STEP_MM
