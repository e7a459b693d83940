"""Extract the boundaries of the layers of a segmentation as closed surfaces, smoother than its voxels.

Layer k is drawn as the solid of all labels of layer k and beyond: the solids lie in one another, so that no
gap opens between neighbours, and, listed in order, the last one that holds a point is the point's layer.

The voxels are averaged in cells of `CELL_MM`, smoothed by a normal distribution of `SMOOTHING_SD_MM`, and the
average is turned into a distance along which marching cubes may interpolate: beside a plane the average is
the normal distribution function of the distance, so that its inverse is that distance, up to a factor. A
plane stays where it was whatever its tilt. A boundary with radii R1, R2 moves toward its hollow side by
s^2 / 2 (1 / R1 + 1 / R2), s about 0.7 mm: 0.03 mm at a cylinder of radius 10 mm. Sharp corners are rounded: a
right-angled edge loses about 0.5 mm along its bisector, the corner of a box about 1 mm.

Segmentations: volumes in which every voxel holds the number of its layer.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.special import ndtri
from skimage.measure import block_reduce, marching_cubes

from needlefit.datasets.columns import make_id
from needlefit.datasets.layers import find_surface_faults
from needlefit.errors import DataError
from needlefit.geometry.meshes import extract_solid
from needlefit.geometry.surfaces import Surface
from needlefit.imaging.image_headers import MAX_SEGMENTS, check_image_header, choose_segments, parse_count
from needlefit.imaging.volume import IMAGE_SUFFIXES, Volume, require_same_frame, to_patient
from needlefit.imaging.volume_files import open_member, read_planes, read_segments, read_volume
from needlefit.project.input_files import path_exists

MAX_NAME_CHARS = 200
EXPECTED_LABELS = "a whole number of each voxel's layer, 0 outside the tissue, and no more than a few layers"
OVERLAP_FIX = 'in the Segment Editor set "Modify other segments" to "Overwrite all", and save it again'


@dataclass(frozen=True)
class Segment:
    """One layer of tissue in a segmentation: the `value` of its voxels, and its name ("" where there is
    none).

    `plane` is the one of several numbers of each voxel that holds the value, as 3D Slicer keeps segments that
    were drawn over one another.
    """

    value: int
    name: str
    plane: int = 0


@dataclass(frozen=True)
class Labels:
    """A segmentation; `segments` are the layers 1, 2, ... in this order."""

    volume: Volume
    segments: tuple[Segment, ...]


def read_labels(path: Path, names: Sequence[str] = ()) -> Labels:
    """Read a segmentation: `.seg.nrrd` of 3D Slicer, any label volume, DICOM-SEG, RTSTRUCT, a .zip of one.

    The layers are the segments that are named, in this order; by default all in the order in which the file
    lists them, or, where it names none, the labels in the order of their values. A label without a name is
    named by its value.

    DataError if it is not a volume, its segments overlap, one is empty or missing, or its values are no
    labels.
    """
    with open_member(path) as place:
        if place.is_dir() or not place.name.lower().endswith(IMAGE_SUFFIXES):
            volume, found = read_segments(place, names)
            return _check_labels(volume, tuple(Segment(n, name) for n, name in enumerate(found, 1)), place)
        stated, axes = _read_segments(place) if path_exists(place) else ((), 3)
        if stated and axes > 3:
            volume, stated = _merge_planes(read_planes(place), stated, place)
        else:
            volume = read_volume(place)
        labels = _check_labels(volume, stated, place)
        called = [one.name or str(one.value) for one in labels.segments]
        chosen = choose_segments(called, names, place)
        return replace(labels, segments=tuple(labels.segments[n] for n in chosen))


def _check_labels(volume: Volume, stated: tuple[Segment, ...], path: Path) -> Labels:
    present = _list_labels(volume, path)
    if not stated:
        return Labels(volume, tuple(Segment(value, "") for value in present))
    empty = [f"{segment.name} (label {segment.value})" for segment in stated if segment.value not in present]
    if empty:
        raise DataError(
            f"no voxel belongs to segment {', '.join(empty)}",
            where=str(path),
            expected="voxels in every segment",
            fix="remove the empty segments, or fill them",
        )
    unnamed = sorted(set(present) - {segment.value for segment in stated})
    if unnamed:
        raise DataError(
            f"voxels have the labels {', '.join(map(str, unnamed))}, which no segment has",
            where=str(path),
            expected=f"labels {', '.join(str(segment.value) for segment in stated)}",
            fix="save the segmentation again from 3D Slicer",
        )
    return Labels(volume, stated)


def _read_segments(path: Path) -> tuple[tuple[Segment, ...], int]:
    """Return the segments that a header names, in its order, and its axes; DataError if two are the same."""
    header = check_image_header(path)
    segments = _parse_segments(header.texts, path)
    if len({(segment.plane, segment.value) for segment in segments}) < len(segments):
        raise _overlap_error([segment.name for segment in segments], path)
    return segments, len(header.size)


def _merge_planes(
    planes: Sequence[Volume], segments: Sequence[Segment], path: Path
) -> tuple[Volume, tuple[Segment, ...]]:
    """Return one volume of the labels 1, 2, ... of segments in several; DataError if they overlap."""
    values, labelled = np.zeros_like(planes[0].values), 0
    for label, segment in enumerate(segments, 1):
        if segment.plane >= len(planes):
            raise DataError(
                f"segment {segment.name} is in layer {segment.plane}, of {len(planes)} in the file",
                where=str(path),
                expected="layers that are there",
                fix="save the segmentation again from 3D Slicer",
            )
        inside = planes[segment.plane].values == segment.value
        if met := int(values[inside].max(initial=0)):
            raise _overlap_error([segments[met - 1].name, segment.name], path)
        values[inside], labelled = label, labelled + int(np.count_nonzero(inside))
    if labelled < sum(np.count_nonzero(plane.values) for plane in planes):
        raise DataError(
            "voxels have labels that no segment has",
            where=str(path),
            expected="labels of the segments that the header names",
            fix="save the segmentation again from 3D Slicer",
        )
    merged = tuple(Segment(label, segment.name) for label, segment in enumerate(segments, 1))
    return replace(planes[0], values=values), merged


def _overlap_error(names: Sequence[str], path: Path) -> DataError:
    return DataError(
        f"its segments overlap: {', '.join(names)}",
        where=str(path),
        expected="every voxel in one layer",
        fix=OVERLAP_FIX,
    )


def _parse_segments(texts: Mapping[str, str], path: Path) -> tuple[Segment, ...]:
    count = 0
    while f"Segment{count}_ID" in texts or f"Segment{count}_LabelValue" in texts:
        count += 1
    return tuple(
        Segment(
            parse_count(texts.get(f"Segment{n}_LabelValue", f"{n + 1}"), 0, 2**16, path),
            texts.get(f"Segment{n}_Name", "").strip()[:MAX_NAME_CHARS],
            parse_count(texts.get(f"Segment{n}_Layer", "0"), 0, MAX_SEGMENTS, path),
        )
        for n in range(count)
    )


def _list_labels(volume: Volume, path: Path) -> list[int]:
    """Return the labels of a volume, increasing, without 0."""
    low, high = float(volume.values.min()), float(volume.values.max())
    labels_only = all(np.array_equal(slice_, np.rint(slice_)) for slice_ in volume.values)
    if low < 0 or high >= 2**16 or not labels_only:
        fractions = "" if labels_only else ", with fractions"
        raise DataError(
            f"its voxels run from {low:g} to {high:g}{fractions}: this is a scan",
            where=str(path),
            expected=EXPECTED_LABELS,
            fix="give the segmentation, not the scan that it was made from",
        )
    size = int(high) + 1
    counts = sum(np.bincount(s.ravel().astype(np.int64), minlength=size) for s in volume.values)
    present: list[int] = np.flatnonzero(counts).tolist()
    labels = [value for value in present if value]
    if not 1 <= len(labels) <= MAX_SEGMENTS:
        what = f"holds {len(labels)} labels: this is a scan" if labels else "holds no label: all voxels are 0"
        fix = "give the segmentation of the layers" if labels else "segment the layers, and save it again"
        raise DataError(what, where=str(path), expected=EXPECTED_LABELS, fix=fix)
    return labels


CELL_MM = 1.25  # edge of the cells that marching cubes goes through, as near as whole voxels come to it, mm
SMOOTHING_SD_MM = 0.6  # standard deviation of the smoothing, mm; at least as many voxels
MIN_TAIL = 1e-3  # averages nearer to 0 or 1 than this say nothing of the distance any more
# No boundary comes nearer to the centre of a cell than this, in standard deviations of the smoothing: in a
# file, triangles smaller than its digits would fall together.
MIN_CORNER_DISTANCE_SD = 0.01
MAX_LOOSE_FRACTION = 0.02  # islands and cavities of at most this part of a layer's volume are left out
MARGIN_CELLS = 3  # cells around the labels: what leaves the volume is closed there


def extract_label_surfaces(
    path: Path, names: Sequence[str] = (), frame_of_reference: str = ""
) -> tuple[Surface, ...]:
    """Return the surfaces of a segmentation, LPS, mm: one solid per layer, in order, `into` from 1.

    `names` as in `read_labels`; `frame_of_reference`: that of the scan, in which it must have been drawn.

    DataError if the segmentation has a fault, or a layer and those beyond it fall apart.
    """
    labels = read_labels(path, names)
    require_same_frame(labels.volume, frame_of_reference, str(path))
    order = np.zeros(int(labels.volume.values.max()) + 1, dtype=np.uint8)
    order[[segment.value for segment in labels.segments]] = np.arange(1, len(labels.segments) + 1)
    low, layers = _crop(order[labels.volume.values.astype(np.uint16)])  # (K, J, I), 0 outside
    return tuple(
        _extract_surface(layers >= layer, low, layer, labels, path)
        for layer in range(1, len(labels.segments) + 1)
    )


def _crop(layers: NDArray[np.uint8]) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """Return the first voxel k, j, i of the box around all labels, and the box."""
    inside = [np.flatnonzero(layers.any(axis=tuple(a for a in range(3) if a != axis))) for axis in range(3)]
    box = tuple(slice(int(where[0]), int(where[-1]) + 1) for where in inside)
    return np.array([where[0] for where in inside]), layers[box]


def _extract_surface(
    mask: NDArray[np.bool_], low: NDArray[np.int64], layer: int, labels: Labels, path: Path
) -> Surface:
    kji, faces = extract_boundary(mask, labels.volume.spacing[::-1])
    points = to_patient(labels.volume, (kji + low)[:, ::-1])
    name = labels.segments[layer - 1].name
    surface, loose = extract_solid(make_id(f"layer {layer} {name}".strip(), ""), points, faces, layer)
    place = f"layer {layer}{f' ({name})' if name else ''}" + " and those beyond" * (
        layer < len(labels.segments)
    )
    if loose > MAX_LOOSE_FRACTION:
        raise DataError(
            f"{place} fall{'s' * (layer == len(labels.segments))} apart: islands or cavities of "
            f"{100 * loose:.0f} % of the largest piece",
            where=str(path),
            expected="layers in one piece, one within or behind the other, in the order of the segments",
            fix="label bubbles and the needle as the tissue around them, remove islands, sort the segments",
        )
    faults = [fault.what for fault in find_surface_faults(surface, path)]
    if faults:
        raise DataError(
            f"the surface of {place} {faults[0]}",
            where=str(path),
            expected="a closed boundary",
            fix="smooth the segmentation, and remove layers thinner than a voxel",
        )
    return surface


def extract_boundary(
    mask: NDArray[np.bool_], spacing: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return vertices (V, 3), in fractional voxels k, j, i, and faces (F, 3) of the boundary of a mask (K, J,
    I).

    `spacing` (3,): of voxels along k, j, i, mm. The boundary closes around what touches the mask's edge.
    """
    block = np.maximum(np.rint(CELL_MM / spacing), 1).astype(np.int64)
    before = MARGIN_CELLS * block
    pads = [(b, int(b + (-size) % step)) for b, size, step in zip(before, mask.shape, block, strict=True)]
    cells = block_reduce(np.pad(mask, pads), tuple(block.tolist()), np.mean)
    width = np.maximum(SMOOTHING_SD_MM, spacing) / (block * spacing)
    average = gaussian_filter(cells.astype(np.float32), width)
    # inverse of the smoothing of a plane; 0 and 1 would become infinite
    distance = ndtri(np.clip(average, MIN_TAIL, 1 - MIN_TAIL))
    distance = np.where(
        np.abs(distance) < MIN_CORNER_DISTANCE_SD, np.copysign(MIN_CORNER_DISTANCE_SD, distance), distance
    )
    vertices, faces, _, _ = marching_cubes(distance, 0.0)
    # a cell's centre lies (block - 1) / 2 voxels after its first voxel; the padding comes off
    return vertices * block + (block - 1) / 2 - before, faces.astype(np.int64)
