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

from collections.abc import Sequence
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
from needlefit.imaging.refusals import located, refusal
from needlefit.imaging.volume import Volume, require_same_frame, to_patient
from needlefit.imaging.volume_files import is_image_file, open_member, read_planes, read_segments, read_volume
from needlefit.project.input_files import path_exists

MAX_NAME_CHARS = 200
EXPECTED_LABELS = "a whole number of each voxel's layer, 0 outside the tissue, and no more than a few layers"
SAVE_AGAIN_FIX = "save the segmentation again from 3D Slicer"


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
    with open_member(path) as place, located(place):
        if not is_image_file(place):
            volume, found = read_segments(place, names)
            return _check_labels(volume, tuple(Segment(n, name) for n, name in enumerate(found, 1)))
        stated, axes = _read_stated_segments(place) if path_exists(place) else ((), 3)
        if stated and axes > 3:
            planes = read_planes(place)
            values, labelled = np.zeros_like(planes[0].values), 0
            for label, segment in enumerate(stated, 1):
                if segment.plane >= len(planes):
                    raise refusal(f"""segment {segment.name} is in layer {segment.plane}, of {len(planes)} in
                            the file
                        expected: layers that are there
                        fix: {SAVE_AGAIN_FIX}""")
                inside = planes[segment.plane].values == segment.value
                if met := int(values[inside].max(initial=0)):
                    raise _overlap_error([stated[met - 1].name, segment.name])
                values[inside], labelled = label, labelled + int(np.count_nonzero(inside))
            if labelled < sum(np.count_nonzero(plane.values) for plane in planes):
                raise refusal(f"""voxels have labels that no segment has
                    expected: labels of the segments that the header names
                    fix: {SAVE_AGAIN_FIX}""")
            merged = tuple(Segment(label, segment.name) for label, segment in enumerate(stated, 1))
            volume, stated = replace(planes[0], values=values), merged
        else:
            volume = read_volume(place)
        labels = _check_labels(volume, stated)
        chosen = choose_segments([one.name or str(one.value) for one in labels.segments], names)
        return replace(labels, segments=tuple(labels.segments[n] for n in chosen))


def _check_labels(volume: Volume, stated: tuple[Segment, ...]) -> Labels:
    low, high = float(volume.values.min()), float(volume.values.max())
    labels_only = all(np.array_equal(slice_, np.rint(slice_)) for slice_ in volume.values)
    if low < 0 or high >= 2**16 or not labels_only:
        raise refusal(f"""its voxels run from {low:g} to {high:g}{", with fractions" * (not labels_only)}:
                this is a scan
            expected: {EXPECTED_LABELS}
            fix: give the segmentation, not the scan that it was made from""")
    size = int(high) + 1
    counts = sum(np.bincount(s.ravel().astype(np.int64), minlength=size) for s in volume.values)
    present: list[int] = [value for value in np.flatnonzero(counts).tolist() if value]
    if not 1 <= len(present) <= MAX_SEGMENTS:
        none = "holds no label: all voxels are 0"
        fix = "give the segmentation of the layers" if present else "segment the layers, and save it again"
        raise refusal(f"""{f"holds {len(present)} labels: this is a scan" if present else none}
            expected: {EXPECTED_LABELS}
            fix: {fix}""")
    if not stated:
        return Labels(volume, tuple(Segment(value, "") for value in present))
    empty = [f"{segment.name} (label {segment.value})" for segment in stated if segment.value not in present]
    if empty:
        raise refusal(f"""no voxel belongs to segment {", ".join(empty)}
            expected: voxels in every segment
            fix: remove the empty segments, or fill them""")
    unnamed = sorted(set(present) - {segment.value for segment in stated})
    if unnamed:
        raise refusal(f"""voxels have the labels {", ".join(map(str, unnamed))}, which no segment has
            expected: labels {", ".join(str(segment.value) for segment in stated)}
            fix: {SAVE_AGAIN_FIX}""")
    return Labels(volume, stated)


def _read_stated_segments(path: Path) -> tuple[tuple[Segment, ...], int]:
    """Return the segments that a header names, in its order, and its axes; DataError if two are the same."""
    header = check_image_header(path)
    texts, count = header.texts, 0
    while f"Segment{count}_ID" in texts or f"Segment{count}_LabelValue" in texts:
        count += 1
    segments = tuple(
        Segment(
            parse_count(texts.get(f"Segment{n}_LabelValue", f"{n + 1}"), 0, 2**16),
            texts.get(f"Segment{n}_Name", "").strip()[:MAX_NAME_CHARS],
            parse_count(texts.get(f"Segment{n}_Layer", "0"), 0, MAX_SEGMENTS),
        )
        for n in range(count)
    )
    if len({(segment.plane, segment.value) for segment in segments}) < len(segments):
        raise _overlap_error([segment.name for segment in segments])
    return segments, len(header.size)


def _overlap_error(names: Sequence[str]) -> DataError:
    return refusal(f"""its segments overlap: {", ".join(names)}
        expected: every voxel in one layer
        fix: in the Segment Editor set "Modify other segments" to "Overwrite all", and save it again""")


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
    with located(path):
        require_same_frame(labels.volume, frame_of_reference)
        order = np.zeros(int(labels.volume.values.max()) + 1, dtype=np.uint8)
        order[[segment.value for segment in labels.segments]] = np.arange(1, len(labels.segments) + 1)
        layers = order[labels.volume.values.astype(np.uint16)]  # (K, J, I), 0 outside
        inside = [np.flatnonzero(layers.any(axis=(axis - 1, axis - 2))) for axis in range(3)]
        low = np.array([where[0] for where in inside])  # the box around all labels
        layers = layers[tuple(slice(int(where[0]), int(where[-1]) + 1) for where in inside)]
        numbers = range(1, len(labels.segments) + 1)
        return tuple(_extract_surface(layers >= layer, low, layer, labels) for layer in numbers)


def _extract_surface(mask: NDArray[np.bool_], low: NDArray[np.int64], layer: int, labels: Labels) -> Surface:
    """Return the surface of a mask (K, J, I) that begins at voxel `low` (3,), k, j, i."""
    kji, faces = extract_boundary(mask, labels.volume.spacing[::-1])
    points = to_patient(labels.volume, (kji + low)[:, ::-1])
    name, last = labels.segments[layer - 1].name, layer == len(labels.segments)
    surface, loose = extract_solid(make_id(f"layer {layer} {name}".strip(), ""), points, faces, layer)
    place = f"layer {layer}{f' ({name})' if name else ''}" + " and those beyond" * (not last)
    if loose > MAX_LOOSE_FRACTION:
        raise refusal(f"""{place} fall{"s" * last} apart: islands or cavities of {100 * loose:.0f} % of the
                largest piece
            expected: layers in one piece, one within or behind the other, in the order of the segments
            fix: label bubbles and the needle as the tissue around them, remove islands, sort the segments""")
    for fault in find_surface_faults(surface, Path()):
        raise refusal(f"""the surface of {place} {fault.what}
            expected: a closed boundary
            fix: smooth the segmentation, and remove layers thinner than a voxel""")
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
