"""Read a DICOM series as one volume: choose the series, check that it is one stack, and rescale its voxels.

Metal, tissue and air are distinguished by their attenuation, air by its -1000 HU. Hence only images made with
X-rays are taken (cone-beam scanners and C-arms say CT, some XA), and only with a rescaling: what is stored is
no HU, often these plus 1024. Slices of a tilted gantry lean; they are read where their positions say.
SimpleITK would refuse these, and make up the places of missing slices: it unpacks voxels only.
"""

import math
import sys
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pydicom
import SimpleITK as sitk
from numpy.typing import NDArray
from pydicom.dataelem import RawDataElement
from pydicom.errors import InvalidDicomError
from pydicom.pixels.utils import iter_pixels
from pydicom.uid import UID

from needlefit.arrays import Floats, are_bounded
from needlefit.errors import DataError, located
from needlefit.imaging.volume import (
    VoxelGrid,
    begins_as_dicom,
    check_expansion,
    check_grid,
    grid_to_json,
    is_dicomdir,
    list_series_files,
    orthogonalize,
)
from needlefit.project.input_files import is_file, open_regular
from needlefit.project.reader_process import Arrays, allow_memory

# A slice may stand this far from its place on an even stack, mm: positions are written to 0.1 mm or better.
MAX_OFFSET_MM = 0.1
MAX_LEAN = 1e-3  # of the stack, as a sine: axes are written to three decimals or better
MIN_STEP_MM = 1e-3  # slices closer than this are one, mm
MAX_STEP_RATIO = 1.5  # a step longer than this many usual ones lacks slices
# Modalities whose values are attenuations; converters leave the entry out, or write OT (other).
XRAY_MODALITIES = frozenset({"", "CT", "XA", "RF", "DX", "PX", "IO", "OT"})
# What RescaleType says of values in HU; US is "unspecified", as cone-beam scanners write.
HU_UNITS = ("", "HU", "HU_MOD", "US")
UNSPECIFIED_UNIT = (
    "the scan's headers call the unit of its values unspecified (RescaleType US): thresholds and the edge of "
    "the tissue are right only if air is -1000 and water 0"
)
HU_FIX = (
    "export it in HU; a micro-CT scanner needs scans of air (-1000) and water (0) for that. Or compute HU "
    "yourself, linearly from both, and save the volume as NRRD"
)
EXPORT_FIX = "export the series from the scanner or the archive again, as original axial slices in HU"
LOCALIZER = "LOCALIZER"
UNNUMBERED = "none"  # what the acquisition is called whose slices state no number
MAX_LISTED = 10  # series, files
DEFERRED_BYTES = 2**16  # longer entries, as the voxels, are not read with the header
SLICE_BYTES_PER_PIXEL = 32  # a slice stands in memory packed, unpacked, and in double precision
UNDEFINED_LENGTH = 0xFFFFFFFF  # of voxels that are packed
SUFFIXES = (".dcm", ".ima", ".dicom")
# Where an enhanced file keeps, for one frame or for all, what a plain one keeps at its top.
FRAME_GROUPS = (
    *("PlanePositionSequence", "PlaneOrientationSequence", "PixelMeasuresSequence"),
    *("PixelValueTransformationSequence", "CTImageFrameTypeSequence"),
)
READ_TAGS = (
    *("SOPClassUID", "SOPInstanceUID", "SeriesInstanceUID", "SeriesNumber", "SeriesDescription"),
    *("FrameOfReferenceUID", "Modality", "AcquisitionNumber", "ImageType"),
    *("Rows", "Columns", "NumberOfFrames", "SamplesPerPixel", "BitsAllocated", "PixelRepresentation"),
    *("PhotometricInterpretation", "ImagePositionPatient", "ImageOrientationPatient", "PixelSpacing"),
    *("RescaleSlope", "RescaleIntercept", "RescaleType", "ModalityLUTSequence", "PixelPaddingValue"),
    *("PixelPaddingRangeLimit", "SharedFunctionalGroupsSequence", "PerFrameFunctionalGroupsSequence"),
    "PixelData",
)

sitk.ProcessObject.SetGlobalWarningDisplay(False)  # errors are reported once, by our own messages


@dataclass(frozen=True, eq=False)
class DicomSlice:
    """The header of one image of a series."""

    file: Path
    data: pydicom.Dataset
    frame: int | None = None  # index of the image in an enhanced multi-frame file

    @property
    def name(self) -> str:
        """Name of the file, and of the frame in it."""
        return self.file.name + ("" if self.frame is None else f", frame {self.frame + 1}")

    @property
    def where(self) -> str:
        """Path of the file, and the frame in it."""
        return str(self.file.parent / self.name)

    def text(self, name: str) -> str:
        """Return an entry as text; empty where the file has none."""
        value = self.data.get(name)
        return "" if value is None else str(value).strip()

    def numbers(self, *names: str, count: int = 1) -> Floats | None:
        """Return the numbers of entries, one after the other, (len(names) * count,); None: one is missing."""
        try:
            values = [self.data.get(name) for name in names]
            if any(value is None or value == "" for value in values):
                return None
            array = np.array(values, dtype=np.float64).ravel()
        except Exception:  # pydicom parses an entry when it is asked for, and raises what its bytes provoke
            values, array = ["unreadable"], np.empty(0)
        if len(array) != count * len(names) or not are_bounded(array):
            raise DataError(
                f"{' and '.join(names)} is {values}",
                expected="finite numbers, as many as the DICOM standard asks for",
                fix="export the series from the scanner or the archive again",
                where=self.where,
            )
        return array

    @cached_property
    def position(self) -> Floats | None:
        """Centre of the first voxel (3,), LPS, mm."""
        return self.numbers("ImagePositionPatient", count=3)

    @cached_property
    def axes(self) -> Floats | None:
        """LPS directions (6,) of growing column index, and of growing row index."""
        return self.numbers("ImageOrientationPatient", count=6)

    @cached_property
    def pixel(self) -> Floats | None:
        """Spacing (2,) of rows and of columns, mm."""
        return self.numbers("PixelSpacing", count=2)

    @cached_property
    def rescale(self) -> Floats | None:
        """Slope and intercept (2,)."""
        return self.numbers("RescaleSlope", "RescaleIntercept")

    @cached_property
    def padding(self) -> tuple[float, float] | None:
        """Least and greatest stored value that means "not measured"."""
        ends = [self.numbers(name) for name in ("PixelPaddingValue", "PixelPaddingRangeLimit")]
        if ends[0] is None:
            return None
        values = np.concatenate([end for end in ends if end is not None])
        if self.data.get("PixelRepresentation") == 1:  # some scanners write -2000 as 63536
            bits = int(self.data.get("BitsAllocated", 16))
            values = np.where(values >= 2.0 ** (bits - 1), values - 2.0**bits, values)
        return float(values.min()), float(values.max())

    @property
    def series(self) -> str:
        """UID of its series, or what stands for it."""
        return self.text("SeriesInstanceUID") or f"not stated, number {self.text('SeriesNumber') or 'none'}"

    @property
    def is_localizer(self) -> bool:
        """Whether the file is marked as an overview."""
        return LOCALIZER in (self.data.get("FrameType") or self.data.get("ImageType") or ())

    @property
    def syntax(self) -> UID:
        """How the voxels are packed."""
        return UID(str(self.data.file_meta.get("TransferSyntaxUID") or ""))


def read_series(arrays: Arrays, path: str, series: str | None, acquisition: str | None) -> dict[str, Any]:
    """Read the one series that `path` refers to: add the array "values"; return its grid, and warnings.

    Values are rescaled slice by slice; voxels that were not measured (padding) get the least value that
    was, so that no threshold and no edge finds them. Localizers and copies of slices are left out.

    `acquisition`: number of the acquisition, where the series holds several.

    DataError if the series is not one sound stack, or a voxel cannot be read.
    """
    notes: list[str] = []
    slices = _drop_others(find_series(Path(path), series, notes), notes)
    slices, grid = stack_slices(_choose_acquisition(slices, acquisition))
    if any(one.text("RescaleType").upper() == "US" for one in slices):
        notes.append(UNSPECIFIED_UNIT)
    allow_memory(grid.size[0] * grid.size[1] * SLICE_BYTES_PER_PIXEL + 4 * math.prod(grid.size))
    values = arrays["values"] = np.empty(grid.size[::-1], np.float32)
    for item, plane, stored in zip(slices, values, _read_planes(slices), strict=True):
        if item.padding is not None and item.rescale is not None:
            # padding is given in stored values, before the rescaling; 0.5 allows for rounding
            kept = (stored - item.rescale[1]) / item.rescale[0]
            stored[(kept > item.padding[0] - 0.5) & (kept < item.padding[1] + 0.5)] = np.nan
        plane[...] = stored
    least = np.fmin.reduce(values, axis=None)
    if np.isnan(least):
        raise DataError(
            "holds nothing but padding",
            expected="measured values; padding is what PixelPaddingValue states",
            fix="check PixelPaddingValue, or export the series again",
            where=f"{slices[0].file.parent}",
        )
    for plane in values:
        plane[np.isnan(plane)] = least
    return {**grid_to_json(grid), "warnings": notes}


def read_headers(file: Path) -> list[DicomSlice]:
    """Return the header of each image in a file; none if it is no DICOM image but, say, a report or a text.

    DataError if it is named as a DICOM file and is none, or is cut short.
    """
    tags, known = list(READ_TAGS), begins_as_dicom(file)
    with _damaged_unless_read(file), open_regular(file, sys.maxsize) as content:
        try:
            data = pydicom.dcmread(content, DEFERRED_BYTES, specific_tags=tags, force=known)
        except InvalidDicomError:
            if file.suffix.lower() in SUFFIXES:
                raise
            return []
        stated = UID(str(data.file_meta.get("MediaStorageSOPClassUID") or data.get("SOPClassUID") or ""))
        if stated.name != stated and "Image Storage" not in stated.name:
            return []
        voxels = data.get_item("PixelData", keep_deferred=True)
        assert isinstance(voxels, RawDataElement)  # KeyError: the file ends before its voxels
        needed = data.get("BitsAllocated", 16) * data.Rows * data.Columns // 8  # of one frame, bytes
        stored, plain = file.stat().st_size - voxels.value_tell, voxels.length != UNDEFINED_LENGTH
        if plain and not needed <= voxels.length <= stored:
            raise EOFError
        frames = data.get("PerFrameFunctionalGroupsSequence")
        if not frames:
            return [DicomSlice(file, data)]
        shared = (data.get("SharedFunctionalGroupsSequence") or [pydicom.Dataset()])[0]
        top = [element for element in data if element.VR != "SQ" and element.keyword != "PixelData"]
        slices = [DicomSlice(file, pydicom.Dataset(), n) for n in range(len(frames))]
        for item, own in zip(slices, frames, strict=True):
            item.data.file_meta = data.file_meta
            for element in top:
                item.data.add(element)
            for group in (shared.get(name) or own.get(name) for name in FRAME_GROUPS):
                item.data.update(group[0] if group else {})
        return slices


@contextmanager
def _damaged_unless_read(file: Path) -> Iterator[None]:
    """Turn whatever the bytes of a file provoke into the error of a damaged file."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what pydicom doubts and we use is checked here
            yield
    except (DataError, MemoryError):
        raise
    except Exception as error:
        raise DataError(
            "is damaged or cut short, or no DICOM image",
            expected="a whole DICOM file",
            fix="copy the file again, or export the series again",
            where=file,
        ) from error


def find_series(path: Path, series: str | None, notes: list[str]) -> list[DicomSlice]:
    """Return the slices of the one series that `path` refers to, in no order; note files that were set aside.

    `path`: a folder with its subfolders, its DICOMDIR, or one file of a series.
    `series`: number or UID of the series, where a folder holds several.

    DataError if there is no DICOM image there, no series of the name, or several to choose from; also if a
    file that begins as DICOM is damaged, and no series was chosen.
    """
    path = path.parent if is_dicomdir(path) else path
    named = read_headers(path) if is_file(path) else []
    if is_file(path) and not named:
        raise DataError(
            "is not a volume that can be read",
            expected="a DICOM image, or a file that ends in .nrrd, .nii, .nii.gz or .mha; values in HU",
            fix=(
                "name the scan's folder, or export it so; structure sets (RTSTRUCT) are "
                "read by `needlefit import`; import pictures (a micro-CT's TIFF) into 3D "
                "Slicer with their spacing, turn their values to HU (air -1000, water 0), "
                "and save them as NRRD"
            ),
            where=path,
        )
    groups: dict[str, list[DicomSlice]] = {}
    damaged: list[str] = []
    for file in list_series_files(path):
        try:
            for item in read_headers(file):
                groups.setdefault(item.series, []).append(item)
        except DataError:
            if begins_as_dicom(file) and not named and series is None:
                raise
            damaged.append(file.name)
    if damaged:
        listed = ", ".join(damaged[:MAX_LISTED])
        notes.append(f"{len(damaged)} damaged file(s) beside the series were left out: {listed}")
    if named:
        return groups[named[0].series]
    if series is None:  # stacks of slices made with X-rays, if there are any
        for wanted in (_is_stack, lambda slices: slices[0].text("Modality").upper() in XRAY_MODALITIES):
            groups = {uid: one for uid, one in groups.items() if wanted(one)} or groups
    else:
        meant = series.strip()
        chosen = [one for uid, one in groups.items() if meant in (uid, one[0].text("SeriesNumber"))]
        if len(chosen) == 1:
            return chosen[0]
    if not groups:
        inside = sorted(entry.name + "/" * entry.is_dir() for entry in path.iterdir())
        shown = ", ".join(inside[:MAX_LISTED]) + (", ..." if len(inside) > MAX_LISTED else "")
        raise DataError(
            f"holds no DICOM image; there is {shown}" if inside else "is an empty folder",
            expected="the files of a DICOM series, in the folder or below it",
            fix="name the folder in which the slices lie, or the .nrrd or .nii.gz file itself",
            where=path,
        )
    if series is None and len(groups) == 1:
        return next(iter(groups.values()))
    count = f"{len(groups)} series" if series is None else f"{len(chosen) or 'no'} series {series}"
    raise DataError(
        f"holds {count}: {_list_series(groups, path)}",
        expected="one series, or the name of the one that is meant",
        fix=(
            "give the number or the UID of the one that is meant with --series, or under "
            "`series` in a table of scans"
        ),
        where=path,
    )


def _is_stack(slices: Sequence[DicomSlice]) -> bool:
    """Whether a series is a stack, not an overview, a single image or pictures of a report."""
    placed = [one for one in slices if one.data.get("ImagePositionPatient") and not one.is_localizer]
    return len(placed) > 1 or "NumberOfFrames" in slices[0].data


def _list_series(groups: dict[str, list[DicomSlice]], path: Path) -> str:
    """Return the series in words: those in a subfolder with its name."""
    lines = []
    for uid, slices in groups.items():
        one, folder = slices[0], slices[0].file.parent
        inside = "" if folder == path else f" in {folder.relative_to(path)}/"
        kind = f"{one.text('Modality') or 'no modality'}{', localizer' * one.is_localizer}"
        called = f"number {one.text('SeriesNumber') or 'none'} {one.text('SeriesDescription')!r}"
        lines.append(f"{called} ({kind}, {len(slices)} image{'s' * (len(slices) > 1)}{inside}), UID {uid}")
    more = [f"and {len(lines) - MAX_LISTED} more"] if len(lines) > MAX_LISTED else []
    return "; ".join(lines[:MAX_LISTED] + more)


def _drop_others(slices: list[DicomSlice], notes: list[str]) -> list[DicomSlice]:
    """Return the slices without copies and localizers; an unmarked localizer stands across the others."""
    unique = {(one.text("SOPInstanceUID") or one.where, one.frame): one for one in slices}
    if len(unique) < len(slices):
        notes.append(f"{len(slices) - len(unique)} slice(s) that repeat another one were left out")
    kept = [one for one in unique.values() if not one.is_localizer] or list(unique.values())
    normals = [np.full(3, np.nan) if one.axes is None else np.cross(*one.axes.reshape(2, 3)) for one in kept]
    [(usual, _)] = Counter(tuple(normal.round(1)) for normal in normals).most_common(1)
    turns = np.abs(normals @ np.array(usual))  # cosines; nan where the axes are not stated
    kept = [one for one, turn in zip(kept, turns, strict=True) if not turn < 0.5] or kept
    if left := len(unique) - len(kept):
        notes.append(f"{left} image(s) of the series, localizers or across its slices, were left out")
    return kept


def _choose_acquisition(slices: list[DicomSlice], acquisition: str | None) -> list[DicomSlice]:
    """Return the slices of an acquisition; DataError if there is none, or they are several stacks."""
    parts: dict[str, list[DicomSlice]] = {}
    for item in slices:
        parts.setdefault(item.text("AcquisitionNumber") or UNNUMBERED, []).append(item)
    if acquisition is not None and acquisition.strip() in parts:
        return parts[acquisition.strip()]
    # slices that were scanned one after the other have numbers of their own, and are one stack
    several = len(parts) > 1 and len({str(one.position) for one in slices}) < len(slices)
    if acquisition is None and not several:
        return slices
    listed = ", ".join(f"`{name}` ({len(one)} slices)" for name, one in parts.items())
    raise DataError(
        f"its slices are those of {len(parts)} acquisitions: {listed}",
        expected="one acquisition",
        fix=(
            "name the one that is meant with --acquisition, or under `acquisition` in a "
            f"table of scans: {' or '.join(parts)}"
        ),
        where=f"{slices[0].file.parent}",
    )


def stack_slices(slices: Sequence[DicomSlice]) -> tuple[list[DicomSlice], VoxelGrid]:
    """Return the slices in the order of their positions, and the grid of their voxels.

    The order is along the normal of the slices (row cross column direction), so that the axes of the
    grid are right-handed; file names and instance numbers do not matter.

    DataError if the slices are not one even, complete stack of plain images, straight or evenly leaning.
    """
    for item in slices:
        for wrong, what, fix in _list_faults(item):
            if wrong:
                raise DataError(
                    what,
                    expected="slices of a CT volume in HU, with their places in the patient",
                    fix=fix,
                    where=item.where,
                )
    first = slices[0]
    assert first.pixel is not None and first.axes is not None
    _check_alike(slices)
    with located(first.file.parent):
        if len(slices) < 2:
            raise DataError(
                "holds one slice",
                expected="a stack of slices",
                fix="copy all files of the series into the folder",
            )
        axes = first.axes.reshape(2, 3)
        if not (np.abs(axes @ axes.T - np.eye(2)) <= 2 * MAX_LEAN).all():
            raise DataError(
                f"ImageOrientationPatient is {axes.round(4).tolist()}",
                expected="two perpendicular unit vectors",
                fix=EXPORT_FIX,
                where=first.where,
            )
        direction = orthogonalize(np.vstack([axes, np.cross(*axes)]).T)
        positions = np.array([item.position for item in slices])  # (K, 3)
        order = np.argsort(positions @ direction[:, 2], kind="stable")
        ordered, positions = [slices[index] for index in order], positions[order]
        origin, step = _fit_steps(ordered, positions, direction[:, 2])
        spacing = float(np.linalg.norm(step))
        lean = float(np.linalg.norm(np.cross(step, direction[:, 2]))) / spacing
        if lean <= MAX_LEAN:  # axes that were rounded are turned upright on the stack
            upright = step / spacing
            axes = direction[:, :2] - np.outer(upright, upright @ direction[:, :2])
            direction = orthogonalize(np.column_stack([axes, upright]))
        elif lean * spacing * len(slices) > MAX_OFFSET_MM:
            direction = np.column_stack([direction[:, :2], step / spacing])
        columns, rows = int(first.data.Columns), int(first.data.Rows)
        # PixelSpacing is row spacing (y), then column spacing (x); the grid is x, y, z
        steps = np.array([*first.pixel[::-1], spacing])
        grid = VoxelGrid((columns, rows, len(ordered)), origin, steps, direction)
        check_grid(grid)
        voxels, files = math.prod(grid.size), {item.file for item in ordered}
        bits = int(first.data.get("BitsAllocated", 16))
        check_expansion(voxels * bits // 8, 4 * voxels, sum(file.stat().st_size for file in files))
    return ordered, grid


def _list_faults(item: DicomSlice) -> Iterator[tuple[bool, str, str]]:
    """Yield the checks of one slice: whether one fails, what then is wrong, and the fix."""
    frames, samples = item.data.get("NumberOfFrames") or 1, item.data.get("SamplesPerPixel", 1)
    fix = "convert it to NRRD, e.g. with 3D Slicer, or export it as single-frame (classic) or enhanced CT"
    yield item.frame is None and frames > 1, f"holds {frames} frames without their positions", fix
    fix = "name the folder with the slices of the scan, or export its series"
    yield item.is_localizer, "is a localizer (scout, topogram), no slice", fix
    modality, unit = item.text("Modality").upper(), item.text("RescaleType").upper()
    fix = "give the CT; if this is one and its header is wrong, save it as NRRD, e.g. with 3D Slicer"
    yield modality not in XRAY_MODALITIES, f"is no CT: its Modality is {modality}", fix
    places = {"ImagePositionPatient": item.position, "ImageOrientationPatient": item.axes}
    missing = [name for name, value in (places | {"PixelSpacing": item.pixel}).items() if value is None]
    yield bool(missing), f"has no {', '.join(missing)}", EXPORT_FIX
    shown = item.text("PhotometricInterpretation").upper()
    table = "ModalityLUTSequence" in item.data
    what = (
        f"its voxels are no plain attenuations: SamplesPerPixel {samples}, PhotometricInterpretation {shown}"
    )
    yield samples != 1 or table or shown == "MONOCHROME1", what + ", ModalityLUTSequence" * table, EXPORT_FIX
    yield item.rescale is None, "has no RescaleSlope, RescaleIntercept: its values are no HU", HU_FIX
    yield unit not in HU_UNITS, f"RescaleType is {unit}: its values are no HU", HU_FIX
    yield item.rescale is not None and item.rescale[0] == 0.0, "RescaleSlope is 0", EXPORT_FIX


def _check_alike(slices: Sequence[DicomSlice]) -> None:
    """See that all slices have the size, spacing, orientation and frame of reference of the first."""
    first = slices[0]
    assert first.pixel is not None
    for item in slices[1:]:
        for name, tags, allowed in (
            ("size", ("Rows", "Columns"), 0.0),
            ("pixel spacing", ("PixelSpacing",), MAX_LEAN * float(first.pixel.max())),
            ("orientation", ("ImageOrientationPatient",), MAX_LEAN),
            ("frame of reference", ("FrameOfReferenceUID",), None),
        ):
            own, other = ([one.data.get(tag) for tag in tags] for one in (item, first))
            same = own == other if allowed is None else np.allclose(own, other, rtol=0, atol=allowed)
            if not same:
                raise DataError(
                    f"its {name} is {own}, that of {first.name} is {other}",
                    expected="the same in every slice of a series",
                    fix=(
                        "move the slices of another scan to a folder of their own, or export the series again"
                    ),
                    where=item.where,
                )


def _fit_steps(ordered: Sequence[DicomSlice], positions: Floats, normal: Floats) -> tuple[Floats, Floats]:
    """Return the place of the first slice and the step from slice to slice, (3,) each, mm.

    By least squares: rounding of single positions must not add up over the stack. `positions` (K, 3) are in
    their order along the `normal`.
    """
    steps = np.diff(positions @ normal)
    usual = float(np.median(steps))
    doubled = int((steps < MIN_STEP_MM).sum())
    for (before, after), step in zip(pairwise(ordered), steps, strict=True):
        if step < MIN_STEP_MM:
            raise DataError(
                f"stands at the same place as {before.name}, with other voxels, as "
                f"{doubled} of {len(ordered)} slices do: these are several scans with "
                "one AcquisitionNumber, or none",
                expected="one slice at each place",
                fix=(
                    "export one scan (phase, time, kernel), or move the slices of each to a folder of its own"
                ),
                where=after.where,
            )
        if usual >= MIN_STEP_MM and step > MAX_STEP_RATIO * usual:
            raise DataError(
                f"{round(step / usual) - 1 or 1} slice(s) missing between {before.name} "
                f"and {after.name}: a step of {step:.4g} mm where others are "
                f"{usual:.4g} mm",
                expected="a stack without gaps",
                fix="copy the missing files; a series with two spacings must be resampled to one",
                where=before.file.parent,
            )
    count = np.arange(len(ordered))
    step, origin = np.polyfit(count, positions, 1)
    away = np.linalg.norm(origin + np.outer(count, step) - positions, axis=1)
    if away.max() > MAX_OFFSET_MM:
        worst = int(away.argmax())
        raise DataError(
            f"stands {away[worst]:.3g} mm from its place in an even stack of "
            f"{np.linalg.norm(step):.4g} mm steps, as other slices may",
            expected=(
                f"even steps, to {MAX_OFFSET_MM:g} mm; slices straight above each other, or all leaning alike"
            ),
            fix=f"{EXPORT_FIX}; or resample it to even steps, e.g. in 3D Slicer, and save it as NRRD",
            where=f"{ordered[worst].where}",
        )
    return origin, step


def _read_planes(slices: Sequence[DicomSlice]) -> Iterator[NDArray[np.float64]]:
    """Yield the rescaled values (rows, columns) of slices, in their order."""
    reader = sitk.ImageFileReader()
    reader.SetImageIO("GDCMImageIO")
    for (file, plain), group in groupby(slices, key=lambda one: (one.file, one.frame is None)):
        items = list(group)
        try:
            if plain:
                reader.SetFileName(str(file))
                image = reader.Execute()  # a view does not keep its image
                yield np.array(sitk.GetArrayViewFromImage(image), dtype=np.float64)[0]
                continue
            stored = iter_pixels(file, indices=[one.frame for one in items if one.frame is not None])
            for item, plane in zip(items, stored, strict=True):
                assert item.rescale is not None  # the stack was checked
                yield plane * item.rescale[0] + item.rescale[1]
        except (DataError, MemoryError):
            raise
        except Exception as error:  # whatever the bytes provoke in one of several decoders
            packed = f"; it is compressed as {items[0].syntax.name}" * items[0].syntax.is_compressed
            raise DataError(
                f"its voxels cannot be read{packed}",
                expected="a whole DICOM file",
                fix="it is cut short or damaged: copy it again, or export the series again, uncompressed",
                where=file,
            ) from error
