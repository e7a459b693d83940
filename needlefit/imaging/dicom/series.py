"""Find and read DICOM series."""

import hashlib
import math
import re
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import SimpleITK as sitk
from numpy.typing import NDArray
from pydicom import dcmread
from pydicom.pixels.utils import iter_pixels

from needlefit.errors import DataError, refusal
from needlefit.imaging.dicom.stack import (
    LOCALIZER,
    XRAY_MODALITIES,
    DicomSlice,
    damaged_file_error,
    damaged_unless_read,
    describe_headers,
    read_headers,
    stack_slices,
)
from needlefit.imaging.volume import begins_as_dicom, grid_to_json, is_dicomdir, list_series_files
from needlefit.project.input_files import is_file, open_regular
from needlefit.project.reader_process import Arrays, allow_memory

_MAX_LISTED = 10
UNNUMBERED = "none"  # what the acquisition is called whose slices state no number


def find_series(path: Path, series: str | None = None, notes: list[str] | None = None) -> list[DicomSlice]:
    """Return the slices of the one series that `path` refers to, in no order; note files that were set aside.

    `path`: a folder with its subfolders, its DICOMDIR, or one file of a series.
    `series`: number or UID of the series, where a folder holds several.

    DataError if there is no DICOM image there, no series of the name, or several to choose from.
    """
    if is_dicomdir(path):
        path = path.parent
    if is_file(path):
        headers = read_headers(path)
        if not headers:
            if begins_as_dicom(path):
                raise refusal(f"""is DICOM, but no image
                    expected: a CT series, or one of its slices
                    fix: name the scan's folder; contours (RTSTRUCT) are read by `needlefit import`, and for a
                        scan by --mask and --layers
                    where: {path}""")
            raise refusal(f"""is not a volume that can be read
                expected: a DICOM image, or a file that ends in .nrrd, .nii, .nii.gz or .mha; values in HU
                fix: export the scan so; import pictures (a micro-CT's TIFF) into 3D Slicer with their
                    spacing, turn their values to HU (air -1000, water 0), and save them as NRRD
                where: {path}""")
        return _group_slices(list_series_files(path), notes, chosen=True)[headers[0].series]
    groups = _group_slices(list_series_files(path), notes, chosen=series is not None)
    if not groups:
        inside = sorted(entry.name + "/" * entry.is_dir() for entry in path.iterdir())
        shown = ", ".join(inside[:_MAX_LISTED]) + (", ..." if len(inside) > _MAX_LISTED else "")
        raise refusal(f"""{f"holds no DICOM image; there is {shown}" if inside else "is an empty folder"}
            expected: the files of a DICOM series, in the folder or below it
            fix: name the folder in which the slices lie, or the .nrrd or .nii.gz file itself
            where: {path}""")
    if series is not None:
        named = [one for uid, one in groups.items() if series == uid or series.strip() == one[0].number]
        if len(named) != 1:
            raise refusal(f"""holds {len(named) or "no"} series {series}: {_list_series(groups, path)}
                expected: the number or the UID of one of them
                fix: {"give the UID" if named else "give one of the numbers listed"}
                where: {path}""")
        return named[0]
    stacks = {}  # of slices, not overviews, single images and pictures of reports
    for uid, slices in groups.items():
        placed = [item for item in slices if item.position is not None and LOCALIZER not in item.kind]
        if len(placed) > 1 or any(item.frames > 1 for item in slices):
            stacks[uid] = slices
    if not stacks and len(groups) > 1:
        raise refusal(f"""holds no stack of slices; it holds {_list_series(groups, path)}
            expected: the slices of a CT volume, in one series
            fix: name the folder in which they lie, or export the series of the scan again
            where: {path}""")
    stacks = stacks or groups
    if len(stacks) > 1:  # what is no CT is refused only where it is all there is
        stacks = {uid: one for uid, one in stacks.items() if one[0].modality in XRAY_MODALITIES} or stacks
    if len(stacks) > 1:
        raise refusal(f"""holds {len(stacks)} series: {_list_series(stacks, path)}
            expected: one series, or the name of the one that is meant
            fix: give the number or the UID of the one that is meant with --series, or under `series` in a
                table of scans
            where: {path}""")
    return next(iter(stacks.values()))


def _group_slices(
    files: Sequence[Path], notes: list[str] | None, *, chosen: bool
) -> dict[str, list[DicomSlice]]:
    """Return the slices of every series, by UID; the same order on every machine.

    Damaged files are set aside, with a note. DataError if there is no other file, or one may be a slice: it
    is named as those beside it are, by the next number or one between, and no series was `chosen`.
    """
    groups: dict[str, list[DicomSlice]] = {}
    damaged, others = dict[Path, DataError](), list[Path]()
    for file in files:
        try:
            headers = read_headers(file)
        except DataError as error:
            damaged[file] = error
            continue
        if headers:
            groups.setdefault(headers[0].series, []).extend(headers)
        elif not begins_as_dicom(file):
            others.append(file)
    numbers: dict[str, list[int]] = {}
    for item in (item for slices in groups.values() for item in slices):
        name, number = _split_number(item.file)
        numbers.setdefault(name, []).append(number)
    for file in (*damaged, *others):
        name, number = _split_number(file)
        known = numbers.get(name, [])
        if known and min(known) - 1 <= number <= max(known) + 1 and not chosen:
            raise damaged.get(file) or damaged_file_error(file)
    if damaged and not groups:
        raise next(iter(damaged.values()))
    if damaged and notes is not None:
        listed = ", ".join(file.name for file in [*damaged][:_MAX_LISTED])
        notes.append(f"{len(damaged)} damaged file(s) beside the series were left out: {listed}")
    return groups


def _split_number(file: Path) -> tuple[str, int]:
    """Return the path of a file with a sign for each number in it, and the last one; -1 without one."""
    found = re.findall(r"\d+", file.name)
    return re.sub(r"\d+", "#", str(file)), int(found[-1]) if found else -1


def _list_series(groups: dict[str, list[DicomSlice]], path: Path) -> str:
    """Return the series in words: those in a subfolder with its name."""
    lines = []
    for uid, slices in groups.items():
        one, folder = slices[0], slices[0].file.parent
        inside = "" if folder == path else f" in {folder.relative_to(path)}/"
        called = f"{f'number {one.number}' if one.number else 'without a number'} {one.description!r}"
        kind = f"{one.modality or 'no modality'}{', localizer' * (LOCALIZER in one.kind)}"
        lines.append(f"{called} ({kind}, {len(slices)} image{'s' * (len(slices) > 1)}{inside}), UID {uid}")
    more = [f"and {len(lines) - _MAX_LISTED} more"] if len(lines) > _MAX_LISTED else []
    return "; ".join(lines[:_MAX_LISTED] + more)


SLICE_BYTES_PER_PIXEL = 32  # a slice stands in memory packed, unpacked, and in double precision

sitk.ProcessObject.SetGlobalWarningDisplay(False)  # errors are reported once, by our own messages


def read_series(arrays: Arrays, path: str, series: str | None, acquisition: str | None) -> dict[str, Any]:
    """Read the one series that `path` refers to: add the array "values"; return its grid, and warnings.

    Values are rescaled slice by slice; voxels that were not measured (padding) get the least value that
    was, so that no threshold and no edge finds them. Localizers and copies of slices are left out.

    `acquisition`: number of the acquisition, where the series holds several.

    DataError if the series is not one sound stack, or a voxel cannot be read.
    """
    notes: list[str] = []
    found = find_series(Path(path), series, notes)
    slices = _drop_copies(_drop_localizers(found, notes), notes)
    parts: dict[str, list[DicomSlice]] = {}
    for item in slices:
        parts.setdefault(item.acquisition or UNNUMBERED, []).append(item)
    listed = ", ".join(
        f"`{name}` ({len(one)} slices{' without a number' * (name == UNNUMBERED)})"
        for name, one in parts.items()
    )
    where = slices[0].file.parent
    if acquisition is not None:
        if (chosen := parts.get(acquisition.strip())) is None:
            raise refusal(f"""no acquisition of the series is {acquisition}; it holds {listed}
                expected: one of these
                fix: give one of those listed
                where: {where}""")
        slices = chosen
    try:
        slices, grid = stack_slices(slices)
    except DataError as error:
        sound = []
        for name, one in parts.items():
            with suppress(DataError):
                stack_slices(one)
                sound.append(name)
        if acquisition is not None or len(parts) == 1 or not sound:
            raise
        raise refusal(f"""its slices are no single stack, but those of {len(parts)} acquisitions: {listed}
            expected: one acquisition
            fix: name the one that is meant with --acquisition, or under `acquisition` in a table of scans:
                {" or ".join(sound)}
            where: {where}""") from error
    notes += describe_headers(slices, grid)
    allow_memory(max(item.rows * item.columns for item in slices) * SLICE_BYTES_PER_PIXEL)
    allow_memory(4 * math.prod(grid.size))
    values = arrays["values"] = np.empty(grid.size[::-1], np.float32)
    reader = sitk.ImageFileReader()
    reader.SetImageIO("GDCMImageIO")
    frames = _read_frames([item for item in slices if item.frame is not None])
    for item, plane in zip(slices, values, strict=True):
        if item.frame is None:
            reader.SetFileName(str(item.file))
            try:
                image = reader.Execute()
            except RuntimeError as error:
                raise _unreadable_voxels_error(item) from error
            stored = np.array(sitk.GetArrayViewFromImage(image), dtype=np.float64)[0]
        else:
            stored = next(frames)
        if item.padding is not None:
            assert item.rescale is not None  # the stack was checked
            slope, intercept = item.rescale
            # padding is given in stored values, before the rescaling; 0.5 allows for rounding
            kept = (stored - intercept) / slope
            stored[(kept > item.padding[0] - 0.5) & (kept < item.padding[1] + 0.5)] = np.nan
        plane[...] = stored
    if any(item.padding is not None for item in slices):
        least = np.fmin.reduce(values, axis=None)
        if np.isnan(least):
            raise refusal(f"""holds nothing but padding
                expected: measured values; padding is what PixelPaddingValue states
                fix: check PixelPaddingValue, or export the series again
                where: {slices[0].file.parent}""")
        for plane in values:
            plane[np.isnan(plane)] = least
    frame = slices[0].frame_of_reference
    return {**grid_to_json(grid), "warnings": notes, "frame_of_reference": frame}


def _drop_localizers(slices: list[DicomSlice], notes: list[str]) -> list[DicomSlice]:
    """Return the slices without localizers; one that is not marked as such stands across the others."""
    kept = [item for item in slices if LOCALIZER not in item.kind] or slices
    normals = [np.full(3, np.nan) if item.axes is None else np.cross(*item.axes) for item in kept]
    [(usual, _)] = Counter(tuple(normal.round(1)) for normal in normals).most_common(1)
    turns = np.abs(normals @ np.array(usual))  # cosines; nan where the axes are not stated
    kept = [item for item, turn in zip(kept, turns, strict=True) if not turn < 0.5] or kept
    if len(kept) < len(slices):
        left = len(slices) - len(kept)
        notes.append(f"{left} image(s) of the series, localizers or across its slices, were left out")
    return kept


def _drop_copies(slices: list[DicomSlice], notes: list[str]) -> list[DicomSlice]:
    """Return the slices without those that repeat another one's place, rescaling and stored voxels."""
    places: dict[tuple[Any, ...], list[DicomSlice]] = {}
    for item in slices:
        stated = (item.position, item.axes, item.pixel, item.rescale)
        places.setdefault(tuple(None if one is None else one.tobytes() for one in stated), []).append(item)
    kept: list[DicomSlice] = []
    for same in places.values():
        digests: set[object] = set()
        for item in same:
            digest: object = object()
            # only what stands where another slice does is read for its content
            if len(same) > 1 and item.frame is None:
                with damaged_unless_read(item.file), open_regular(item.file, sys.maxsize) as content:
                    data = dcmread(content, specific_tags=["PixelData"], force=True)
                    digest = hashlib.sha256(data.PixelData).digest()
            if digest not in digests:
                digests.add(digest)
                kept.append(item)
    if len(kept) < len(slices):
        notes.append(f"{len(slices) - len(kept)} slice(s) with the place and voxels of another were left out")
    return kept


def _read_frames(frames: Sequence[DicomSlice]) -> Iterator[NDArray[np.float64]]:
    """Yield the rescaled values (rows, columns) of frames of enhanced files, in their order."""
    for file, group in groupby(frames, key=lambda item: item.file):
        items = list(group)
        try:
            stored = iter_pixels(file, indices=[item.frame for item in items if item.frame is not None])
            for item, plane in zip(items, stored, strict=True):
                assert item.rescale is not None  # the stack was checked
                yield plane.reshape(item.rows, item.columns) * item.rescale[0] + item.rescale[1]
        except (DataError, MemoryError):
            raise
        except Exception as error:  # whatever the bytes provoke in one of several decoders
            raise _unreadable_voxels_error(items[0]) from error


def _unreadable_voxels_error(item: DicomSlice) -> DataError:
    packed = f"; it is compressed as {item.syntax.name}" if item.syntax.is_compressed else ""
    return refusal(f"""its voxels cannot be read{packed}
        expected: a whole DICOM file
        fix: it is cut short or damaged: copy it again, or export the series
            again{", uncompressed" if packed else ""}
        where: {item.file}""")
