"""Find what may be the needle: thresholds with hysteresis, then tubes, cut off from what is wider."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import find_objects, label

from needlefit.arrays import Floats, Ints
from needlefit.errors import DataError
from needlefit.imaging.needle.wide_parts import cut_wide_parts
from needlefit.imaging.volume import Volume, to_index, to_patient
from needlefit.schemas.reconstruction import ReconstructionRecord

THRESHOLD_FRACTIONS = (0.4, 0.25, 0.15)
"""Low thresholds to try, as parts of the way from tissue to metal; the high one lies a quarter higher."""

CLIPPED_HU = 3071.0
"""Largest number of 12 bits, HU: on such a scale metal stands out by about this."""

MIN_METAL_CONTRAST_HU = 500.0
"""What must stand out from tissue by less than this (HU) is no metal."""

MAX_AIR_HU = -500.0
"""HU."""

MAX_FACE_FRACTION = 0.15
"""A component with more of its voxels than this on the volume's faces is the corner of something larger."""

MIN_COMPONENT_VOXELS = 8
"""Smaller components are noise."""

MIN_DISTINCT_CHECK = 100
"""Points of a component of which three must differ along it to fit a parabola."""

NEAR_END_MM = 5.0
"""Length of the end of a piece that must lie on the curve which it goes on, mm."""

MIN_GROWTH_NOISE_SD = 4.0
"""A needle is followed to levels that lie above the tissue by more than so many deviations of its noise."""

MIN_GROWTH_MM = 3.0
"""At a lower threshold a tube must become longer by so much to be taken from there, mm."""

GROWTH_REACH_MM, GROWTH_MARGIN_MM = 60.0, 5.0
"""Distance beyond the ends of a tube, and beside it, in which it is looked for at lower thresholds, mm."""

MAX_GROWTH_WIDENING = 1.5
"""A tube that becomes wider than that at a lower threshold takes in what surrounds it."""


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


def find_tubes(volume: Volume, recipe: ReconstructionRecord) -> list[Component]:
    """Return the components that may be the needle, each with the pieces that lie on its curve.

    Raises
    ------
    DataError
        If nothing is as bright as metal, or no component is a tube.
    """
    levels = list_thresholds(volume, recipe)
    for n, (low, high) in enumerate(levels):
        parts = cut_components(volume, find_components(volume, low, high), recipe)
        # what a holder cuts in two may be too short on either side
        seeds = [part for part in parts if is_tube(part, recipe, recipe.segmentation.min_length_mm / 2)]
        joined = [part for part in _join_tubes(volume, seeds, parts, recipe) if is_tube(part, recipe)]
        if joined:
            floor = median_tissue_hu(volume) + MIN_GROWTH_NOISE_SD * tissue_noise_hu(volume)
            lower = [low for low, _ in levels[n + 1 :] if low > floor]
            return [_grow_tube(volume, joined[0], lower, recipe), *joined[1:]]
    raise _no_tube_error(parts, recipe)


def _grow_tube(
    volume: Volume, tube: Component, levels: Sequence[float], recipe: ReconstructionRecord
) -> Component:
    """Return the tube as far as lower levels (HU) show it: near a hub or in rays it is darker."""
    low, high = _growth_box(volume, tube)
    box = tuple(slice(a, b) for a, b in zip(low[::-1], high[::-1], strict=True))
    own = {tuple(voxel) for voxel in tube.voxels[:: max(1, len(tube.voxels) // 1000)].tolist()}
    grown = tube
    for level in levels:
        labels, _ = label(volume.values[box] > level, structure=np.ones((3, 3, 3), dtype=bool))
        found = [
            np.argwhere(labels[part] == number)[:, ::-1] + [side.start for side in part[::-1]] + low
            for number, part in enumerate(find_objects(labels), start=1)
        ]
        whole = [measure_component(volume, one) for one in found if len(one) >= MIN_COMPONENT_VOXELS]
        parts = cut_components(volume, whole, recipe)
        same = [part for part in parts if own & {tuple(voxel) for voxel in part.voxels.tolist()}]
        longest = max(same, key=lambda part: part.length, default=tube)
        longest = _join_pieces(volume, longest, [part for part in parts if part is not longest], recipe)
        wide = longest.width > MAX_GROWTH_WIDENING * tube.width
        if is_tube(longest, recipe) and not wide and longest.length > grown.length + MIN_GROWTH_MM:
            grown = longest
    return grown


def _growth_box(volume: Volume, tube: Component) -> tuple[Ints, Ints]:
    """Return the first voxel of the box around a tube and beyond its ends, and the one after its last."""
    points = to_patient(volume, tube.voxels)
    center, axes = principal_axes(points)
    along = (points - center) @ axes[0]
    ends = center + np.outer([along.min() - GROWTH_REACH_MM, along.max() + GROWTH_REACH_MM], axes[0])
    index = np.vstack([to_index(volume, ends), tube.voxels])
    margin = GROWTH_MARGIN_MM / volume.spacing
    size = np.array(volume.grid.size)
    low = np.clip(np.floor(index.min(axis=0) - margin), 0, size).astype(np.int64)
    high = np.clip(np.ceil(index.max(axis=0) + margin) + 1, 0, size).astype(np.int64)
    return low, high


def cut_components(
    volume: Volume, parts: Sequence[Component], recipe: ReconstructionRecord
) -> list[Component]:
    """Return the components with what is wider than a needle cut off those that are as long as one."""
    rules = recipe.segmentation
    found = []
    for part in parts:
        if part.length < rules.min_length_mm:
            found.append(part)
            continue
        pieces = cut_wide_parts(volume, part.voxels, rules.max_widening * recipe.needle.diameter_mm)
        if len(pieces) == 1 and len(pieces[0]) == len(part.voxels):
            found.append(part)
        else:
            found += [measure_component(volume, one) for one in pieces if len(one) >= MIN_COMPONENT_VOXELS]
    return found


def _join_tubes(
    volume: Volume, tubes: Sequence[Component], parts: Sequence[Component], recipe: ReconstructionRecord
) -> list[Component]:
    """Return the tubes, longest first, without those that are pieces of a longer one."""
    left = sorted(tubes, key=lambda part: part.length, reverse=True)
    found = []
    while left:
        tube = _join_pieces(volume, left[0], [part for part in parts if part is not left[0]], recipe)
        kept = {tuple(voxel) for voxel in tube.voxels.tolist()}
        left = [part for part in left[1:] if tuple(part.voxels[0].tolist()) not in kept]
        found.append(tube)
    return sorted(found, key=lambda part: part.length, reverse=True)


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
    heights = [part * (metal - tissue) for part in THRESHOLD_FRACTIONS]
    # beside large balls on an extended scale a starved shaft is darker than these
    heights += [part * CLIPPED_HU for part in THRESHOLD_FRACTIONS if part * CLIPPED_HU < heights[-1]]
    for height in heights:
        low, high = tissue + height, tissue + 1.25 * height
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


def is_tube(part: Component, recipe: ReconstructionRecord, min_length: float | None = None) -> bool:
    """Return whether a component is long, thin and smooth enough to be the needle.

    `min_length`: mm; by default that of the recipe.
    """
    rules, diameter = recipe.segmentation, recipe.needle.diameter_mm
    return (
        part.length >= (rules.min_length_mm if min_length is None else min_length)
        and part.length >= rules.min_elongation * part.width
        and part.width <= rules.max_widening * diameter
        and part.bend <= rules.max_widening * diameter / 2
        and part.on_face <= MAX_FACE_FRACTION
    )


def fit_parabola(along: Floats, across: Floats) -> Floats:
    """Return the coefficients (3, d) of the least-squares parabola across(along), highest power first."""
    some = np.round(along[:MIN_DISTINCT_CHECK], 6)
    return np.polyfit(along, across, min(2, len(np.unique(some)) - 1))


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


def tissue_noise_hu(volume: Volume) -> float:
    """Return the standard deviation of what is neither air nor metal (HU), by its median deviation."""
    some = volume.values[::3, ::3, ::3]
    dense = some[some > MAX_AIR_HU]
    return 0.0 if not dense.size else 1.4826 * float(np.median(np.abs(dense - np.median(dense))))


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
    far = np.abs(piece[:, 0] - np.clip(piece[:, 0], local[:, 0].min(), local[:, 0].max()))
    near = piece[far <= far.min() + NEAR_END_MM]  # farther off, a parabola that is drawn on says little
    off = near[:, 1:] - np.stack([np.polyval(c, near[:, 0]) for c in curve.T], axis=1)
    # a needle that crosses slices stands one beside the other
    thick = recipe.needle.diameter_mm + float(volume.spacing.max()) / 2
    allowed = thick * (1 + max(gap, 0.0) / recipe.segmentation.min_length_mm)
    if np.linalg.norm(off, axis=1).mean() > allowed:
        return False
    both = measure_component(volume, np.concatenate([needle.voxels, part.voxels]))
    return both.bend <= max(needle.bend, recipe.segmentation.max_widening * recipe.needle.diameter_mm / 2)


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
