"""Find the needle's voxels: tubes above thresholds, cut off from what is wider."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from needlefit.arrays import Floats, Ints
from needlefit.datasets.layers import MAX_START_DISTANCE_MM
from needlefit.errors import DataError
from needlefit.imaging.bright_voxels import MAX_LISTED_VOXELS, list_bright_voxels
from needlefit.imaging.constants import HU, MM, PART, SCANNER
from needlefit.imaging.needle.axis_spline import FEWEST
from needlefit.imaging.volume import Volume, to_patient
from needlefit.schemas.reconstruction import ReconstructionRecord

MAX_PIECES = 100  # largest number of pieces, the longest, that are joined: noise may leave thousands


def cut_wide_parts(volume: Volume, voxels: Ints, max_width: float) -> list[Ints]:
    """Return the thin pieces of a component, each (n, 3), i, j, k; none where nothing of it is wide.

    A wide part is the union of all balls of more than `max_width` mm across that fit into the component; it
    is cut off together with as much of the needle as its blur covers.

    `voxels`: (N, 3); i, j, k.
    """
    low = voxels.min(axis=0) - 1
    size = voxels.max(axis=0) - low + 2
    # of a large box every second, third, ... voxel
    every = int(np.ceil((np.prod(size, dtype=np.float64) / MAX_LISTED_VOXELS) ** (1 / 3)))
    mask = np.zeros(size, dtype=np.bool_)
    mask[tuple((voxels - low).T)] = True
    radius, step, spacing = max_width / 2, float(volume.spacing.min()), every * volume.spacing
    # from a voxel's centre to one outside
    core = _distance(mask[::every, ::every, ::every], spacing) > radius + every * step / 2
    if not core.any():
        return []
    away = _distance(~core, spacing)[tuple(((voxels - low) // every).T)]
    mask[tuple((voxels - low)[away <= 1.5 * radius + every * step].T)] = False
    left = list_bright_voxels(mask.T.astype(np.float32), 0.5)
    return [part + low for part in left.list_parts(0.5)]


def _distance(mask: NDArray[np.bool_], spacing: Floats) -> NDArray[np.float32]:
    """Return the distance (mm) of every voxel of a mask to the nearest outside it."""
    return distance_transform_edt(mask, sampling=spacing).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Component:
    """A connected component of bright voxels, with its measures."""

    voxels: Ints  # (N, 3); i, j, k
    points: Floats  # (N, 3); the same, LPS, mm
    values: Floats  # (N,); HU
    length: float  # extent along the main axis, mm
    width: float  # diameter of a rod of this length and as many voxels, mm
    bend: float  # root mean square distance from the parabola that fits best, mm


def find_tubes(volume: Volume, recipe: ReconstructionRecord) -> list[Component]:
    """Return the components that may be the needle, the longest first.

    They are those of the first threshold that shows one. Each has the pieces that lie on its curve, which
    rays, a holder or the change from one slice to the next cut off.

    DataError if nothing is as bright as metal, or no component is a tube.
    """
    for low, high in list_thresholds(volume, recipe):
        parts = cut_components(volume, find_components(volume, low, high), recipe)
        parts.sort(key=lambda part: part.length, reverse=True)
        left, joined = parts, list[Component]()
        while seeds := [part for part in left if is_tube(part, recipe, 2 * MM.EDGE_BLUR)]:
            tube, own = _join_pieces(volume, seeds[0], left, recipe)
            left = [part for part in left if part not in own]  # of one needle each
            joined += [tube] if is_tube(tube, recipe) else []
        if joined:
            return sorted(joined, key=lambda tube: tube.length, reverse=True)
    largest, width = parts[0], find_widest(recipe)
    raise DataError(
        f"no needle was found; the longest bright object is {largest.length:.1f} mm "
        f"long, {largest.width:.1f} mm wide, {largest.bend:.1f} mm (RMS) off a parabola",
        expected=f"{MM.NEEDLE_LENGTH:g} mm or longer, at most {width:.1f} mm wide, {width / 2:.1f} mm off",
        fix=(
            "give a scan with more of the needle and its tip; or set needle.diameter_mm in "
            "a recipe (--recipe); or give the needle's voxels, or points on it (--mask)"
        ),
    )


def find_widest(recipe: ReconstructionRecord) -> float:
    """Return the largest width of the needle's image, mm."""
    return PART.WIDENING * recipe.needle.diameter_mm


def _join_pieces(
    volume: Volume, needle: Component, parts: Sequence[Component], recipe: ReconstructionRecord
) -> tuple[Component, list[Component]]:
    """Return a needle together with the thin parts that are one tube with it across a gap, and these."""
    own, widest, n = [needle], find_widest(recipe), 0
    thin = [part for part in parts if 2 * part.width <= part.length and part.width <= widest]
    left = thin[:MAX_PIECES]
    while n < len(left):
        union = measure_component(volume, np.concatenate([needle.voxels, left[n].voxels]))
        gap = union.length - needle.length - left[n].length
        # a marker lies beside the needle: half of a piece lies beyond its end
        beyond = -left[n].length / 2 <= gap <= MM.HIDDEN
        if left[n] is own[0] or not beyond or union.bend > widest / 2:
            n += 1
        else:
            own.append(left.pop(n))
            needle, n = union, 0
    return needle, own


def cut_components(
    volume: Volume, parts: Sequence[Component], recipe: ReconstructionRecord
) -> list[Component]:
    """Return the components with what is wider than a needle cut off those that are as long as one."""
    found = []
    for part in parts:
        if part.length < MM.NEEDLE_LENGTH:
            found.append(part)
            continue
        pieces = cut_wide_parts(volume, part.voxels, find_widest(recipe))
        trimmed = [measure_component(volume, one) for one in pieces if len(one) >= FEWEST]
        found += trimmed or [part]
    return found


def list_thresholds(volume: Volume, recipe: ReconstructionRecord) -> list[tuple[float, float]]:
    """Return the pairs of low and high thresholds (HU) to try, the strictest first.

    Tissue is the median of what is not air; metal the level that as many voxels reach as the shortest
    needle fills.
    """
    tissue = volume.tissue
    listed = volume.list_bright(tissue + HU.METAL_CONTRAST).values
    bright = listed[listed > tissue + HU.METAL_CONTRAST]
    rod = np.pi / 4 * recipe.needle.diameter_mm**2 * MM.NEEDLE_LENGTH
    wanted = max(FEWEST, int(rod / float(np.prod(volume.spacing)) / 2))
    if len(bright) < wanted:
        raise DataError(
            f"{len(bright)} voxels stand out from tissue ({tissue:.0f} HU) by {HU.METAL_CONTRAST:.0f} HU",
            expected=f"the {wanted} and more of a metal needle",
            fix="check that the scan holds the needle and is in HU; or give a mask",
        )
    metal = float(np.partition(bright, -wanted)[-wanted])
    heights = [part * (metal - tissue) for part in PART.THRESHOLDS]
    return [(tissue + height, tissue + 1.25 * height) for height in heights]


def find_components(volume: Volume, low: float, high: float) -> list[Component]:
    """Return the components above `low` that somewhere exceed `high` (HU), with their measures.

    DataError if no voxel exceeds `high`.
    """
    parts = [
        measure_component(volume, ijk)
        for ijk in volume.list_bright(low).list_parts(low, (FEWEST, np.inf))
        if np.any(volume.values[tuple(ijk.T[::-1])] > high)
    ]
    if not parts:
        raise DataError(
            f"no voxels exceed {high:.0f} HU", expected="a needle brighter than that", fix="give a mask"
        )
    return parts


def is_tube(part: Component, recipe: ReconstructionRecord, least: float = MM.NEEDLE_LENGTH) -> bool:
    """Return whether a component is smooth, as thin as a needle, and `least` mm long or longer."""
    width = find_widest(recipe)
    return part.length >= least and part.width <= width and part.bend <= width / 2


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
    powers = np.vander(local[:, 0], 3)
    off = local[:, 1:] - powers @ np.linalg.lstsq(powers, local[:, 1:])[0]  # from the parabola
    bend = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
    width = float(np.sqrt(4 * len(voxels) * voxel / (np.pi * length)))
    values = volume.values[tuple(voxels.T[::-1])].astype(np.float64)
    return Component(voxels, points, values, length, width, bend)


@dataclass(frozen=True)
class NeedleSelection:
    """The needle, the other tubes, and what a person should know."""

    needle: Component
    others: tuple[Component, ...]
    warnings: tuple[str, ...]


def select_needle(
    volume: Volume,
    recipe: ReconstructionRecord,
    point: Floats | None = None,
    tubes: Sequence[Component] | None = None,
) -> NeedleSelection:
    """Return the needle: the tube at `point` (LPS, mm) if it is stated, else the longest.

    `tubes`: those of the volume, where they were found already.

    DataError if nothing is as bright as metal, no component is a tube, another tube may be the needle, too,
    or none is at the point.
    """
    tubes = find_tubes(volume, recipe) if tubes is None else tubes
    if point is None:
        alike = list_needles(tubes, recipe.needle.diameter_mm)
        if len(alike) > 1:
            raise DataError(
                f"{len(alike)} needles: {'; '.join(map(describe_tube, alike))}",
                expected="one needle",
                fix=(
                    "reconstruct every one (--all); or state a point on the needle that is "
                    "meant (LPS) in a table of scans: needle_x_mm, needle_y_mm, "
                    "needle_z_mm; or crop the scan, or give a mask"
                ),
            )
        needle = alike[0]
    else:
        distances = [float(cKDTree(part.points).query(point)[0]) for part in tubes]
        nearest = int(np.argmin(distances))
        if distances[nearest] > MAX_START_DISTANCE_MM:
            listed = "; ".join(map(describe_tube, tubes))
            raise DataError(
                f"no tube passes the stated point of the needle; there is {listed}",
                expected=f"a tube within {MAX_START_DISTANCE_MM:g} mm of it",
                fix="correct the point (LPS of the scan, mm), or leave the three cells empty",
                where="needle_x_mm, needle_y_mm, needle_z_mm",
            )
        needle = tubes[nearest]
    others = tuple(part for part in tubes if part is not needle)
    listed = "; ".join(map(describe_tube, others))
    note = f"beside the needle ({describe_tube(needle)}) the scan holds {listed}"
    return NeedleSelection(needle, others, (note,) if others else ())


def describe_tube(part: Component) -> str:
    """Return the measures of a tube in words."""
    first, last = (", ".join(f"{x:.0f}" for x in end) for end in find_ends(part))
    return f"a tube of {part.length:.0f} mm, {part.width:.1f} mm wide, from L, P, S = {first} to {last} mm"


def find_ends(part: Component) -> Floats:
    """Return the two ends (2, 3) of a component along its main axis, LPS, mm."""
    along = part.points @ principal_axes(part.points)[1][0]
    return part.points[[int(np.argmin(along)), int(np.argmax(along))]]


def list_needles(
    tubes: Sequence[Component], diameter: float, ratio: float = PART.SECOND_NEEDLE
) -> list[Component]:
    """Return the tubes, of those given longest first, that may be a needle beside the longest one."""
    level, length = ratio * tubes[0].values.mean(), ratio * tubes[0].length
    alike = [part for part in tubes if part.length >= length and part.values.mean() >= level]
    shown = math.hypot(diameter, math.sqrt(8 * math.log(2)) * SCANNER.BLUR.value)  # blur widens its image
    misses = [abs(math.log(part.width / shown)) for part in alike]
    clear = min(misses) + math.log(PART.CLEAR)
    return [part for part, miss in zip(alike, misses, strict=True) if miss < clear]
