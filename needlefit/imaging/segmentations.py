"""Read segmentations: volumes in which every voxel holds the number of its layer."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from needlefit.errors import DataError, located
from needlefit.imaging.volume import Volume
from needlefit.imaging.volume_files import is_image_file, open_member, read_labels_file

MAX_SEGMENTS = 64  # layers of a segmentation; a volume with more labels is a scan
SEGMENTS_FIX = "name the layers from the outside inwards: FILE=segments:NAME,NAME"
MAX_NAME_CHARS = 200
EXPECTED_LABELS = "a whole number of each voxel's layer, 0 outside the tissue, and no more than a few layers"
SAVE_AGAIN_FIX = "save the segmentation again from 3D Slicer"


@dataclass(frozen=True)
class Segment:
    """One layer of tissue in a segmentation: the `value` of its voxels, and its name ("": there is none)."""

    value: int
    name: str


@dataclass(frozen=True)
class Labels:
    """A segmentation; `segments` are the layers 1, 2, ... in this order."""

    volume: Volume
    segments: tuple[Segment, ...]


def read_labels(path: Path, names: Sequence[str] = ()) -> Labels:
    """Read a segmentation: `.seg.nrrd` of 3D Slicer, any label volume, a .zip of one.

    The layers are the segments that are named, in this order; by default all in the order in which the file
    lists them, or, where it names none, the labels in the order of their values. A label without a name is
    named by its value.

    DataError if it is not a volume, its segments overlap, one is empty or missing, or its values are no
    labels.
    """
    with open_member(path) as place, located(place):
        if not is_image_file(place):
            raise DataError(
                "is no label map",
                expected=".seg.nrrd, or another volume of labels (NRRD, NIfTI, MetaImage)",
                fix="load it in 3D Slicer, contours (RTSTRUCT) too, and save the segmentation as .seg.nrrd",
            )
        volume, texts = read_labels_file(place)
        labels = _check_labels(volume, _parse_segments(texts))
        chosen = choose_segments([one.name or str(one.value) for one in labels.segments], names)
        return replace(labels, segments=tuple(labels.segments[n] for n in chosen))


def _check_labels(volume: Volume, stated: tuple[Segment, ...]) -> Labels:
    """Return the labels of a volume as those of the stated segments, or of nameless ones without any."""
    low, high = float(volume.values.min()), float(volume.values.max())
    labels_only = all(np.array_equal(slice_, np.rint(slice_)) for slice_ in volume.values)
    if low < 0 or high >= 2**16 or not labels_only:
        raise DataError(
            f"its voxels run from {low:g} to "
            f"{high:g}{', with fractions' * (not labels_only)}: this is a scan",
            expected=EXPECTED_LABELS,
            fix="give the segmentation, not the scan that it was made from",
        )
    size = int(high) + 1
    counts = sum(np.bincount(s.ravel().astype(np.int64), minlength=size) for s in volume.values)
    present: list[int] = [value for value in np.flatnonzero(counts).tolist() if value]
    if not 1 <= len(present) <= MAX_SEGMENTS:
        none = "holds no label: all voxels are 0"
        fix = "give the segmentation of the layers" if present else "segment the layers, and save it again"
        raise DataError(
            f"holds {len(present)} labels: this is a scan" if present else none,
            expected=EXPECTED_LABELS,
            fix=fix,
        )
    if not stated:
        return Labels(volume, tuple(Segment(value, "") for value in present))
    empty = [f"{segment.name} (label {segment.value})" for segment in stated if segment.value not in present]
    if empty:
        raise DataError(
            f"no voxel belongs to segment {', '.join(empty)}",
            expected="voxels in every segment",
            fix=f"fill the empty segments, or leave them out, or {SEGMENTS_FIX}",
        )
    unnamed = sorted(set(present) - {segment.value for segment in stated})
    if unnamed:
        raise DataError(
            f"voxels have the labels {', '.join(map(str, unnamed))}, which no segment has",
            expected=f"labels {', '.join(str(segment.value) for segment in stated)}",
            fix=SAVE_AGAIN_FIX,
        )
    return Labels(volume, stated)


def _parse_segments(texts: Mapping[str, str]) -> tuple[Segment, ...]:
    """Return the segments that the texts of a header name, in its order; DataError if two are the same."""
    segments: list[Segment] = []
    while any(f"Segment{len(segments)}_{key}" in texts for key in ("ID", "LabelValue")):
        n = len(segments)
        text = texts.get(f"Segment{n}_LabelValue", f"{n + 1}").strip()
        if not re.fullmatch(r"[0-9]{1,5}", text):
            raise DataError(
                f"its header states {text[:40]!r} where a segment has a whole number",
                expected="numbers of up to 5 digits",
                fix=SAVE_AGAIN_FIX,
            )
        segments.append(Segment(int(text), texts.get(f"Segment{n}_Name", "").strip()[:MAX_NAME_CHARS]))
    if len({segment.value for segment in segments}) < len(segments):
        raise DataError(
            f"its segments overlap: {', '.join(segment.name for segment in segments)}",
            expected="every voxel in one layer",
            fix='in the Segment Editor set "Modify other segments" to "Overwrite all", and save it again',
        )
    return tuple(segments)


def choose_segments(present: Sequence[str], names: Sequence[str]) -> list[int]:
    """Return the places of the segments that are named, in that order; all where none is.

    DataError if a name is not there or twice, or there are no segments or too many.
    """
    chosen = [] if names else list(range(len(present)))
    for name in names:
        found = [n for n, one in enumerate(present) if one.casefold() == name.casefold()]
        if len(found) != 1:
            raise DataError(
                f"holds {len(found) or 'no'} segment{'s' * (len(found) > 1)} called {name!r}",
                expected=f"one of {', '.join(present[:MAX_SEGMENTS])}",
                fix="correct the name",
            )
        chosen += found
    if not 1 <= len(chosen) <= MAX_SEGMENTS:
        raise DataError(
            f"holds {len(chosen)} segments", expected=f"1 to {MAX_SEGMENTS} layers", fix=SEGMENTS_FIX
        )
    return chosen
