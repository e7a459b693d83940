"""Segmentations: volumes in which every voxel holds the number of its layer."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from needlefit.errors import DataError
from needlefit.imaging.headers.check import check_image_header
from needlefit.imaging.headers.promise import whole
from needlefit.imaging.volume import IMAGE_SUFFIXES, Volume, read, read_planes
from needlefit.project.reading import is_there

MOST_LABELS = 64
"""A volume with more labels is a scan."""

MAX_NAME_CHARS = 200

EXPECTED = "a whole number of each voxel's layer, 0 outside the tissue, and no more than a few layers"
NO_OVERLAP = 'in the Segment Editor set "Modify other segments" to "Overwrite all", and save it again'


@dataclass(frozen=True)
class Segment:
    """One layer of tissue: the `value` of its voxels, and its name ("" where there is none).

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


def read_labels(path: Path) -> Labels:
    """Read a segmentation: `.seg.nrrd` of 3D Slicer, or any label volume (NRRD, NIfTI, MetaImage).

    The layers are the segments in the order in which Slicer lists them, or, where the file names none, the
    labels in the order of their values.

    Raises
    ------
    DataError
        If it is not a volume, its segments overlap, one is empty, or its values are no labels.
    """
    stated, axes = _stated(path) if path.name.lower().endswith(IMAGE_SUFFIXES) and is_there(path) else ((), 3)
    if stated and axes > 3:
        volume, stated = _merged(read_planes(path), stated, path)
    else:
        volume = read(path)
    present = _present(volume, path)
    if not stated:
        return Labels(volume, tuple(Segment(value, "") for value in present))
    empty = [f"{segment.name} (label {segment.value})" for segment in stated if segment.value not in present]
    if empty:
        raise DataError(
            f"no voxel belongs to segment {', '.join(empty)}",
            where=str(path),
            expected="voxels in every segment",
            mend="remove the empty segments, or fill them",
        )
    unnamed = sorted(set(present) - {segment.value for segment in stated})
    if unnamed:
        raise DataError(
            f"voxels have the labels {', '.join(map(str, unnamed))}, which no segment has",
            where=str(path),
            expected=f"labels {', '.join(str(segment.value) for segment in stated)}",
            mend="save the segmentation again from 3D Slicer",
        )
    return Labels(volume, stated)


def _stated(path: Path) -> tuple[tuple[Segment, ...], int]:
    """Return the segments that a header names, in its order, and its axes; DataError if two are the same."""
    header = check_image_header(path)
    segments = _segments(header.texts, path)
    if len({(segment.plane, segment.value) for segment in segments}) < len(segments):
        raise _overlapping([segment.name for segment in segments], path)
    return segments, len(header.size)


def _merged(
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
                mend="save the segmentation again from 3D Slicer",
            )
        inside = planes[segment.plane].values == segment.value
        if met := int(values[inside].max(initial=0)):
            raise _overlapping([segments[met - 1].name, segment.name], path)
        values[inside], labelled = label, labelled + int(np.count_nonzero(inside))
    if labelled < sum(np.count_nonzero(plane.values) for plane in planes):
        raise DataError(
            "voxels have labels that no segment has",
            where=str(path),
            expected="labels of the segments that the header names",
            mend="save the segmentation again from 3D Slicer",
        )
    merged = tuple(Segment(label, segment.name) for label, segment in enumerate(segments, 1))
    return replace(planes[0], values=values), merged


def _overlapping(names: Sequence[str], path: Path) -> DataError:
    return DataError(
        f"its segments overlap: {', '.join(names)}",
        where=str(path),
        expected="every voxel in one layer",
        mend=NO_OVERLAP,
    )


def _segments(said: Mapping[str, str], path: Path) -> tuple[Segment, ...]:
    count = 0
    while f"Segment{count}_ID" in said or f"Segment{count}_LabelValue" in said:
        count += 1
    return tuple(
        Segment(
            whole(said.get(f"Segment{n}_LabelValue", f"{n + 1}"), 0, 2**16, path),
            said.get(f"Segment{n}_Name", "").strip()[:MAX_NAME_CHARS],
            whole(said.get(f"Segment{n}_Layer", "0"), 0, MOST_LABELS, path),
        )
        for n in range(count)
    )


def _present(volume: Volume, path: Path) -> list[int]:
    """Return the labels of a volume, increasing, without 0."""
    low, high = float(volume.values.min()), float(volume.values.max())
    labels_only = all(np.array_equal(slice_, np.rint(slice_)) for slice_ in volume.values)
    if low < 0 or high >= 2**16 or not labels_only:
        fractions = "" if labels_only else ", with fractions"
        raise DataError(
            f"its voxels run from {low:g} to {high:g}{fractions}: this is a scan",
            where=str(path),
            expected=EXPECTED,
            mend="give the segmentation, not the scan that it was made from",
        )
    size = int(high) + 1
    counts = sum(np.bincount(s.ravel().astype(np.int64), minlength=size) for s in volume.values)
    present: list[int] = np.flatnonzero(counts).tolist()
    labels = [value for value in present if value]
    if not 1 <= len(labels) <= MOST_LABELS:
        what = f"holds {len(labels)} labels: this is a scan" if labels else "holds no label: all voxels are 0"
        mend = "give the segmentation of the layers" if labels else "segment the layers, and save it again"
        raise DataError(what, where=str(path), expected=EXPECTED, mend=mend)
    return labels
