"""Segment the needle: thresholds with hysteresis, then the component that is a tube."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import find_objects, label

from needlefit.arrays import Floats, Ints
from needlefit.errors import DataError
from needlefit.imaging.volume import Volume, to_patient
from needlefit.schemas.reconstruction import ReconstructionRecord

THRESHOLD_FRACTIONS = (0.4, 0.25, 0.15)
"""Low thresholds to try, as parts of the way from tissue to metal; the high one lies a quarter higher."""

MIN_METAL_CONTRAST_HU = 500.0
"""What must stand out from tissue by less than this (HU) is no metal."""

MAX_AIR_HU = -500.0
"""HU."""

MIN_SECOND_NEEDLE_RATIO = 0.6
"""A second tube of at least this part of the needle's length is another needle."""

MAX_FACE_FRACTION = 0.15
"""A component with more of its voxels than this on the volume's faces is the corner of something larger."""

MIN_COMPONENT_VOXELS = 8
"""Smaller components are noise."""


@dataclass(frozen=True)
class Component:
    """A connected component of bright voxels, with its measures.

    Attributes
    ----------
    voxels : (N, 3) int array
        i, j, k.
    length : float
        Extent along the main axis, mm.
    width : float
        Diameter of a rod of this length and as many voxels, mm.
    bend : float
        Root mean square distance from the parabola that fits best, mm.
    on_face : float
        Part of the voxels that lie on the volume's faces.
    """

    voxels: Ints
    length: float
    width: float
    bend: float
    on_face: float


def segment_needle(volume: Volume, recipe: ReconstructionRecord) -> Component:
    """Return the component that is the needle.

    Raises
    ------
    DataError
        If nothing is as bright as metal, no component is a tube, or two are.
    """
    for low, high in list_thresholds(volume, recipe):
        parts = find_components(volume, low, high)
        tubes = [part for part in parts if is_tube(part, recipe)]
        if tubes:
            break
    else:
        raise _no_tube_error(parts, recipe)
    tubes.sort(key=lambda part: part.length, reverse=True)
    needle = _join_pieces(volume, tubes[0], [p for p in parts if p is not tubes[0]], recipe)
    _refuse_second(volume, needle, tubes[1:])
    return needle


def list_thresholds(volume: Volume, recipe: ReconstructionRecord) -> list[tuple[float, float]]:
    """Return the pairs of low and high thresholds (HU) to try, the strictest first.

    Tissue is the median of what is not air; metal the level that as many voxels reach as the shortest
    needle fills.
    """
    given = recipe.segmentation
    if given.threshold_low_hu is not None and given.threshold_high_hu is not None:
        return [(given.threshold_low_hu, given.threshold_high_hu)]
    tissue = median_tissue_hu(volume)
    metal = _metal_hu(volume, tissue, recipe)
    pairs = []
    for level in THRESHOLD_FRACTIONS:
        low, high = (tissue + part * (metal - tissue) for part in (level, 1.25 * level))
        low = low if given.threshold_low_hu is None else given.threshold_low_hu
        high = high if given.threshold_high_hu is None else given.threshold_high_hu
        pairs.append((min(low, high), high))
    return pairs


def find_components(volume: Volume, low: float, high: float) -> list[Component]:
    """Return the components above `low` that somewhere exceed `high` (HU), with their measures.

    Raises
    ------
    DataError
        If no voxel exceeds `high`.
    """
    mask = volume.values > low
    labels, _ = label(mask, structure=np.ones((3, 3, 3), dtype=bool))
    del mask
    parts = []
    for number, box in enumerate(find_objects(labels), start=1):
        inside = labels[box] == number
        if np.count_nonzero(inside) < MIN_COMPONENT_VOXELS or not np.any(volume.values[box][inside] > high):
            continue
        start = np.array([s.start for s in box])
        parts.append(measure_component(volume, (np.argwhere(inside) + start)[:, ::-1]))
    if not parts:
        raise DataError(
            f"no voxels exceed {high:.0f} HU",
            where="segmentation.threshold_high_hu",
            expected="a needle brighter than that",
            fix="lower segmentation.threshold_high_hu, or give a mask",
        )
    return parts


def is_tube(part: Component, recipe: ReconstructionRecord) -> bool:
    """Return whether a component is long, thin and smooth enough to be the needle."""
    rules, diameter = recipe.segmentation, recipe.needle.diameter_mm
    return (
        part.length >= rules.min_length_mm
        and part.length >= rules.min_elongation * part.width
        and part.width <= rules.max_widening * diameter
        and part.bend <= rules.max_widening * diameter / 2
        and part.on_face <= MAX_FACE_FRACTION
    )


def fit_parabola(along: Floats, across: Floats) -> Floats:
    """Return the coefficients (3, d) of the least-squares parabola across(along), highest power first."""
    return np.polyfit(along, across, 2 if np.ptp(along) > 0 else 0)


def principal_axes(points: Floats) -> tuple[Floats, Floats]:
    """Return the centre (3,) of `points` (N, 3) and their principal axes, rows (3, 3), longest first."""
    center = points.mean(axis=0)
    _, axes = np.linalg.eigh(np.cov((points - center).T))
    return center, axes.T[::-1]


def measure_component(volume: Volume, voxels: Ints) -> Component:
    """Return the component of `voxels` (N, 3), i, j, k, with its measures."""
    points = to_patient(volume, voxels)
    center, axes = principal_axes(points)
    local = (points - center) @ axes.T
    voxel = float(np.prod(volume.spacing))
    length = float(np.ptp(local[:, 0])) + voxel ** (1 / 3)
    curve = fit_parabola(local[:, 0], local[:, 1:])
    off = local[:, 1:] - np.stack([np.polyval(c, local[:, 0]) for c in curve.T], axis=1)
    bend = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
    width = float(np.sqrt(4 * len(voxels) * voxel / (np.pi * length)))
    last = np.array(volume.values.shape[::-1]) - 1
    on_face = float(np.mean(np.any((voxels == 0) | (voxels == last), axis=1)))
    return Component(voxels, length, width, bend, on_face)


def median_tissue_hu(volume: Volume) -> float:
    """Return the median of all voxels that are not air (HU), from every third voxel along each axis."""
    some = volume.values[::3, ::3, ::3]
    dense = some[some > MAX_AIR_HU]
    return float(np.median(dense if dense.size > some.size / 100 else some))


def _metal_hu(volume: Volume, tissue: float, recipe: ReconstructionRecord) -> float:
    """Return the level (HU) that as many voxels reach as half the shortest needle fills."""
    bright = np.concatenate([s[s > tissue + MIN_METAL_CONTRAST_HU] for s in volume.values])
    rod = np.pi / 4 * recipe.needle.diameter_mm**2 * recipe.segmentation.min_length_mm
    wanted = max(MIN_COMPONENT_VOXELS, int(rod / float(np.prod(volume.spacing)) / 2))
    if len(bright) < wanted:
        raise DataError(
            f"{len(bright)} voxels stand out from tissue ({tissue:.0f} HU) by {MIN_METAL_CONTRAST_HU:.0f} HU",
            expected=f"the {wanted} and more of a metal needle",
            fix="check that the scan holds the needle and is in HU; or give both thresholds, or a mask",
        )
    return float(np.partition(bright, -wanted)[-wanted])


def _join_pieces(
    volume: Volume, needle: Component, others: Sequence[Component], recipe: ReconstructionRecord
) -> Component:
    """Return the needle together with the pieces that lie on its curve, beyond gaps that rays have cut."""
    waiting = [p for p in others if p.width <= recipe.segmentation.max_widening * recipe.needle.diameter_mm]
    found = True
    while found:
        found = False
        for part in waiting:
            if _continues(volume, needle, part, recipe):
                needle = measure_component(volume, np.concatenate([needle.voxels, part.voxels]))
                waiting = [p for p in waiting if p is not part]
                found = True
                break
    return needle


def _continues(volume: Volume, needle: Component, part: Component, recipe: ReconstructionRecord) -> bool:
    """Whether a piece lies on the needle's parabola, points along it, and is near its end."""
    points = to_patient(volume, needle.voxels)
    center, axes = principal_axes(points)
    local = (points - center) @ axes.T
    piece = (to_patient(volume, part.voxels) - center) @ axes.T
    gap = max(local[:, 0].min() - piece[:, 0].max(), piece[:, 0].min() - local[:, 0].max())
    if gap > recipe.segmentation.join_gap_mm or np.ptp(piece[:, 0]) < 2 * part.width:
        return False
    curve = fit_parabola(local[:, 0], local[:, 1:])
    off = piece[:, 1:] - np.stack([np.polyval(c, piece[:, 0]) for c in curve.T], axis=1)
    allowed = recipe.needle.diameter_mm * (1 + max(gap, 0.0) / recipe.segmentation.min_length_mm)
    return bool(np.linalg.norm(off, axis=1).mean() <= allowed)


def _refuse_second(volume: Volume, needle: Component, tubes: Sequence[Component]) -> None:
    """Raise DataError if a tube as long and as bright as the needle is no part of it."""
    kept = {tuple(v) for v in needle.voxels[:: max(1, len(needle.voxels) // 5000)].tolist()}
    level = _mean_hu(volume, needle.voxels)
    for tube in tubes:
        if any(tuple(v) in kept for v in tube.voxels.tolist()):
            continue
        if (
            tube.length >= MIN_SECOND_NEEDLE_RATIO * needle.length
            and _mean_hu(volume, tube.voxels) >= MIN_SECOND_NEEDLE_RATIO * level
        ):
            at = to_patient(volume, tube.voxels.mean(axis=0)[None])[0]
            raise DataError(
                f"two needles: tubes of {needle.length:.0f} and {tube.length:.0f} mm",
                where=f"second one at L, P, S = {at[0]:.0f}, {at[1]:.0f}, {at[2]:.0f} mm",
                expected="one needle",
                fix="crop the scan, or give a mask of the one meant",
            )


def _mean_hu(volume: Volume, voxels: Ints) -> float:
    i, j, k = voxels.T
    return float(np.mean(volume.values[k, j, i]))


def _no_tube_error(parts: Sequence[Component], recipe: ReconstructionRecord) -> DataError:
    largest = max(parts, key=lambda part: part.length)
    rules = recipe.segmentation
    return DataError(
        f"none of {len(parts)} bright components is a tube; the longest is {largest.length:.1f} mm long, "
        f"{largest.width:.1f} mm wide and strays {largest.bend:.1f} mm from a parabola",
        expected=f"{rules.min_length_mm:g} mm or longer, at most "
        f"{rules.max_widening * recipe.needle.diameter_mm:.1f} mm wide",
        fix="set the thresholds, needle.diameter_mm or min_length_mm in the recipe, or give a mask",
    )
