"""Read the headers of DICOM files and stack slices into a volume, all checked before any voxel is read.

Metal, tissue and air are distinguished by their attenuation, air by its -1000 HU. Hence only images made with
X-rays are taken (cone-beam scanners and C-arms say CT, some XA), and only with a rescaling: what is stored is
no HU, often these plus 1024, and an offset that is guessed would move the face of the tissue. Slices of a
tilted gantry lean; they are read where their positions say. A stated tilt is only remarked on where the
slices stand straight above each other: a series that was straightened keeps the entry, and the standard says
that nothing is to be computed from it.
"""

import math
import os
import sys
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pydicom
from pydicom.errors import InvalidDicomError
from pydicom.uid import UID, ImplicitVRLittleEndian

from needlefit.arrays import Floats, are_bounded
from needlefit.errors import DataError, located, refusal
from needlefit.geometry.frames import normalize
from needlefit.imaging.volume import (
    AXES_COSINE_TOLERANCE,
    DICOM_PREAMBLE_BYTES,
    VoxelGrid,
    begins_as_dicom,
    check_expansion,
    check_grid,
    is_tilted,
    orthogonalize,
)
from needlefit.project.input_files import open_regular

READ_TAGS = (
    *("SOPClassUID", "SeriesInstanceUID", "SeriesNumber", "SeriesDescription", "FrameOfReferenceUID"),
    *("Modality", "GantryDetectorTilt", "AcquisitionNumber"),
    *("ImageType", "Rows", "Columns", "NumberOfFrames", "SamplesPerPixel", "BitsAllocated"),
    "PhotometricInterpretation",
    *("PixelRepresentation", "ImagePositionPatient", "ImageOrientationPatient", "PixelSpacing"),
    *("RescaleSlope", "RescaleIntercept", "ModalityLUTSequence", "PixelPaddingValue"),
    *("PixelPaddingRangeLimit", "RescaleType"),
    *("SharedFunctionalGroupsSequence", "PerFrameFunctionalGroupsSequence"),
)
# Where an enhanced file keeps, for one frame or for all, what a plain one keeps at its top.
_FRAME_ENTRIES = {
    "PlanePositionSequence": ("ImagePositionPatient",),
    "PlaneOrientationSequence": ("ImageOrientationPatient",),
    "PixelMeasuresSequence": ("PixelSpacing",),
    "PixelValueTransformationSequence": ("RescaleSlope", "RescaleIntercept", "RescaleType"),
    "CTImageFrameTypeSequence": ("FrameType",),
}

# By the field of a slice: entries that are texts as they are.
_TEXTS = {
    "number": "SeriesNumber",
    "description": "SeriesDescription",
    "acquisition": "AcquisitionNumber",
    "frame_of_reference": "FrameOfReferenceUID",
}
MAX_FRAMES = 2**16
_SUFFIXES = (".dcm", ".ima", ".dicom")
# So much more may be asked for than there is: a preamble, the head of an element behind the last.
MAX_OVERREAD_BYTES = 256


class _BoundedFile:
    """A file in which no element may reach beyond the end: pydicom would allocate what its length claims."""

    def __init__(self, file: BinaryIO) -> None:
        self._file, self._size = file, file.seek(0, os.SEEK_END)
        file.seek(0)
        self.tell = file.tell

    def read(self, size: int = -1, /) -> bytes:
        """Read bytes; EOFError if far more are requested than there are."""
        if size > max(self._size - self.tell(), 0) + MAX_OVERREAD_BYTES:
            raise EOFError
        return self._file.read(size)

    def seek(self, target: int, origin: int = os.SEEK_SET, /) -> int:
        """Move to a position; EOFError beyond the end, which plain files allow."""
        place = self._file.seek(target, origin)
        if place > self._size:
            raise EOFError
        return place


@dataclass(frozen=True)
class DicomSlice:
    """The header of one image of a series."""

    file: Path
    series: str  # UID of its series
    number: str  # of its series, as its name below; both empty where the file has none
    description: str
    modality: str  # what kind of machine made it, "CT" for most; empty where the file does not say
    acquisition: str  # number of the acquisition in its series; empty where the file has none
    tilt: float  # stated angle of the gantry, degrees
    syntax: UID  # how the voxels are packed
    frame_of_reference: str  # slices of one volume share it
    kind: tuple[str, ...]  # ImageType; "LOCALIZER" among them marks an overview
    rows: int
    columns: int
    frames: int
    samples: int  # numbers of a voxel
    bits: int  # of a number
    position: Floats | None  # (3,); centre of the first voxel, LPS, mm
    axes: Floats | None  # (2, 3); LPS directions of growing column and row index
    pixel: Floats | None  # (2,); spacing of rows and of columns, mm
    rescale: Floats | None  # (2,); slope and intercept
    padding: Floats | None  # (2,); least and greatest stored value that means "not measured"
    table: bool  # whether values are rescaled by a table
    # One in the last digit of position, mm, and axes.
    steps: tuple[float, float]
    unit: str = ""  # RescaleType; empty where the file does not say: HU
    inverted: bool = False  # whether small numbers are white (MONOCHROME1)
    # Index of the image among those of an enhanced multi-frame file; None in a file of one image.
    frame: int | None = None

    @property
    def name(self) -> str:
        """Name of the file, and of the frame in it."""
        return self.file.name + ("" if self.frame is None else f", frame {self.frame + 1}")

    @property
    def where(self) -> str:
        """Path of the file, and the frame in it."""
        return str(self.file.parent / self.name)


def read_headers(file: Path) -> tuple[DicomSlice, ...]:
    """Return the header of each image in a file; none if it is no DICOM image but, say, a report or a text.

    DataError if it is named as a DICOM file and is none, is cut short, or an entry cannot be understood.
    """
    with warnings.catch_warnings(), located(file):
        # what pydicom doubts and we use is checked here, the rest is not ours
        warnings.simplefilter("ignore")
        with damaged_unless_read(file):
            try:
                with open_regular(file, sys.maxsize) as content:
                    tags = list(READ_TAGS)
                    bounded, known = _BoundedFile(content), begins_as_dicom(file)
                    data = pydicom.dcmread(bounded, stop_before_pixels=True, specific_tags=tags, force=known)
            except InvalidDicomError:
                if file.suffix.lower() in _SUFFIXES:
                    raise
                return ()
        storage = str(data.file_meta.get("MediaStorageSOPClassUID") or data.get("SOPClassUID") or "")
        if storage and "Image Storage" not in UID(storage).name:
            if UID(storage).name == storage and "SOPClassUID" not in data:  # a UID cut short, nothing behind
                raise damaged_file_error(file)
            return ()
        if "Rows" not in data or "Columns" not in data:
            raise damaged_file_error(file)
        whole = _parse_slice(file, data)
        if whole.frames <= 1 or "PerFrameFunctionalGroupsSequence" not in data:
            return (whole,)
        with damaged_unless_read(file):
            own = list(data.PerFrameFunctionalGroupsSequence)
            shared = (data.get("SharedFunctionalGroupsSequence") or [pydicom.Dataset()])[0]
            if len(own) != whole.frames or len(own) > MAX_FRAMES:
                raise damaged_file_error(file)
            return tuple(
                replace(_parse_slice(file, _merge_groups(data, shared, one)), frame=n, frames=1)
                for n, one in enumerate(own)
            )


@contextmanager
def damaged_unless_read(file: Path) -> Iterator[None]:
    """Turn whatever the bytes of a file provoke into the error of a damaged file."""
    try:
        yield
    except DataError:
        raise
    except Exception as error:
        raise damaged_file_error(file) from error


def _merge_groups(data: pydicom.Dataset, *groups: pydicom.Dataset) -> pydicom.Dataset:
    """Return the entries of one frame as those of a file of one image; later groups count more."""
    merged = pydicom.Dataset()
    merged.file_meta = data.file_meta
    merged.update({element.tag: element for element in data if element.VR != "SQ"})
    for group in groups:
        for name, entries in _FRAME_ENTRIES.items():
            for item in list(group.get(name) or ())[:1]:
                merged.update({item[key].tag: item[key] for key in entries if key in item})
    if "FrameType" in merged:
        merged.ImageType = merged.FrameType
    return merged


def _parse_slice(file: Path, data: pydicom.Dataset) -> DicomSlice:
    kind = data.get("ImageType") or ()
    texts: dict[str, Any] = {field: _to_text(data.get(tag)) for field, tag in _TEXTS.items()}
    tilt = _parse_numbers(data, ("GantryDetectorTilt",), (1,))
    stated = [n for n in ("PixelPaddingValue", "PixelPaddingRangeLimit") if data.get(n) is not None]
    values = [_parse_whole_number(data, name, 0) for name in stated]
    bits = _parse_whole_number(data, "BitsAllocated", 16)
    if data.get("PixelRepresentation") == 1:  # some scanners write -2000 as 63536
        values = [value - 2**bits if value >= 2 ** (bits - 1) else value for value in values]
    padding = None
    if "PixelPaddingValue" in stated:
        padding = np.array([min(values), max(values)], dtype=np.float64)
    return DicomSlice(
        file=file,
        series=_to_text(data.get("SeriesInstanceUID"))
        or f"not stated, number {texts['number'] or 'not stated'}",
        **texts,
        modality=_to_text(data.get("Modality")).upper(),
        tilt=0.0 if tilt is None else float(tilt[0]),
        syntax=UID(str(data.file_meta.get("TransferSyntaxUID") or ImplicitVRLittleEndian)),
        kind=(kind,) if isinstance(kind, str) else tuple(map(str, kind)),
        rows=_parse_whole_number(data, "Rows", 0),
        columns=_parse_whole_number(data, "Columns", 0),
        frames=_parse_whole_number(data, "NumberOfFrames", 1),
        samples=_parse_whole_number(data, "SamplesPerPixel", 1),
        bits=bits,
        position=_parse_numbers(data, ("ImagePositionPatient",), (3,)),
        steps=(
            _find_last_digit(data, "ImagePositionPatient"),
            _find_last_digit(data, "ImageOrientationPatient"),
        ),
        # six numbers: the direction of a row (growing column index), then of a column
        axes=_parse_numbers(data, ("ImageOrientationPatient",), (2, 3)),
        pixel=_parse_numbers(data, ("PixelSpacing",), (2,)),
        rescale=_parse_numbers(data, ("RescaleSlope", "RescaleIntercept"), (2,)),
        padding=padding,
        table="ModalityLUTSequence" in data,
        unit=_to_text(data.get("RescaleType")).upper(),
        inverted=_to_text(data.get("PhotometricInterpretation")).upper() == "MONOCHROME1",
    )


def _parse_numbers(data: pydicom.Dataset, names: tuple[str, ...], shape: tuple[int, ...]) -> Floats | None:
    """Return the entries `names` as one array of `shape`; None if all are missing or empty."""
    try:
        entries = [data.get(name) for name in names]
    except Exception:  # pydicom parses an entry when it is asked for, and raises what its bytes provoke
        raise _unclear_entry_error(" and ".join(names), "unreadable") from None
    if all(entry is None or entry == "" for entry in entries):
        return None
    try:
        array = np.array(entries, dtype=np.float64).reshape(shape)
    except (TypeError, ValueError):
        raise _unclear_entry_error(" and ".join(names), entries) from None
    if not are_bounded(array):
        raise _unclear_entry_error(" and ".join(names), entries)
    return array


def _find_last_digit(data: pydicom.Dataset, name: str) -> float:
    """Return the value of one in the last digit that an entry is written with; 0 where it seems exact."""
    texts = [getattr(one, "original_string", str(one)).strip() for one in data.get(name) or ()]
    digits = [text.partition(".")[2] for text in texts]
    rounded = any(part.strip("0") for part in digits) and all(part.isdigit() or not part for part in digits)
    return 10.0 ** -max(map(len, digits)) if rounded else 0.0


def _parse_whole_number(data: pydicom.Dataset, name: str, default: int) -> int:
    found = _parse_numbers(data, (name,), (1,))
    return default if found is None else int(found[0])


def _to_text(value: object) -> str:
    return "" if value is None else str(value).strip()


def _unclear_entry_error(name: str, value: object) -> DataError:
    return refusal(f"""{name} is {value}
        expected: finite numbers, as many as the DICOM standard asks for
        fix: export the series from the scanner or the archive again""")


def damaged_file_error(file: Path) -> DataError:
    """Return the error for a file of a series that is not DICOM, or is truncated."""
    empty = file.stat().st_size <= DICOM_PREAMBLE_BYTES
    return refusal(f"""{"is empty" if empty else "its DICOM header is damaged or cut short"}
        expected: a whole DICOM file
        fix: copy the file again, or export the series again
        where: {file}""")


LOCALIZER = "LOCALIZER"
# A slice may stand this far from its place on an even stack, mm, besides what rounding moves it by.
MAX_OFFSET_MM = 0.05
MAX_POSITION_STEP_MM = 0.1  # positions that are written with less than this digit are taken as exact, mm
MAX_AXES_STEP = 1e-3  # the same of axes, as cosines
MIN_STEP_MM = 1e-3  # slices closer than this are one, mm
MAX_STEP_RATIO = 1.5  # a step longer than this many usual ones lacks slices
# Modalities whose values are attenuations; converters leave the entry out, or write OT (other).
XRAY_MODALITIES = frozenset({"", "CT", "XA", "RF", "DX", "PX", "IO", "OT"})
# What RescaleType says of values in HU; US is "unspecified", as cone-beam scanners write.
HU_UNITS = ("", "HU", "HU_MOD", "US")
HU_FIX = (
    "export it in HU; a micro-CT scanner needs scans of air (-1000) and water (0) for that. Or compute HU "
    "yourself, linearly from both, and save the volume as NRRD"
)

MIN_TILT_DEG = 0.05  # a stated angle of the gantry below this, degrees, is none
# Transfer syntaxes that SimpleITK unpacks: none, deflated, RLE, JPEG, JPEG-LS, JPEG 2000.
DECODED_SYNTAXES = frozenset(
    f"1.2.840.10008.1.2{end}"
    for end in ("", ".1", ".1.99", ".2", ".5", ".4.50", ".4.51", ".4.57", ".4.70", ".4.80", ".4.81")
) | {"1.2.840.10008.1.2.4.90", "1.2.840.10008.1.2.4.91"}

EXPECTED_STACK = "every slice straight above the one before, or all of them leaning alike"
_EXPORT_FIX = "export the series from the scanner or the archive again, as original axial slices"


def stack_slices(slices: Sequence[DicomSlice]) -> tuple[list[DicomSlice], VoxelGrid]:
    """Return the slices in the order of their positions, and the grid of their voxels.

    The order is along the normal of the slices (row cross column direction), so that the axes of the
    grid are right-handed; file names and instance numbers do not matter.

    DataError if the slices are not one even, complete stack of plain images, straight or evenly leaning.
    """
    first = slices[0]
    with located(first.file.parent):
        faults = [(item, fault) for item in slices if (fault := _kind_fault(item)) is not None]
        if faults:
            (item, (what, expected, fix)), others = faults[0], len(faults) - 1
            more = f" ({others} more of {len(slices)} files have a fault of this sort)" if others else ""
            raise DataError(what + more, where=item.where, expected=expected, fix=fix)
        _check_alike(slices)
        assert first.pixel is not None
        assert first.axes is not None
        # rounding moves each of three coordinates by half of the last digit, and a length by all of them
        rounded, turned = (max(one) for one in zip(*(item.steps for item in slices), strict=True))
        allowed = MAX_OFFSET_MM + np.sqrt(3) / 2 * rounded * (rounded <= MAX_POSITION_STEP_MM)
        turned = max(AXES_COSINE_TOLERANCE, np.sqrt(3) * turned * (turned <= MAX_AXES_STEP))
        if not (np.abs(first.axes @ first.axes.T - np.eye(2)) <= turned).all():
            raise refusal(f"""ImageOrientationPatient is {first.axes.round(4).tolist()}
                expected: two perpendicular unit vectors
                fix: {_EXPORT_FIX}
                where: {first.where}""")
        # made perpendicular to the last digit
        axes = orthogonalize(np.vstack([first.axes, np.cross(*first.axes)]).T).T[:2]  # (2, 3)
        positions = np.array([item.position for item in slices])  # (K, 3)
        normal = np.cross(axes[0], axes[1])
        order = np.argsort(positions @ normal, kind="stable")
        ordered, positions = [slices[index] for index in order], positions[order]
        step = _measure_slice_step(ordered, positions, normal, allowed)
        if np.linalg.norm(step - (step @ normal) * normal) <= turned * np.linalg.norm(step):
            # axes that were rounded are turned upright on the stack, which shows its normal better
            normal = normalize(step)
            axes = orthogonalize(np.vstack([axes - np.outer(axes @ normal, normal), normal]).T).T[:2]
        origin = positions[0]
        if allowed > MAX_OFFSET_MM:  # all positions together are not rounded as each of them is
            way, count = normalize(step), np.arange(len(ordered))
            step = way * np.polyfit(count, positions @ way, 1)[0]
            origin = positions.mean(axis=0) - step * count.mean()
        spacing = float(np.linalg.norm(step))
        grid = VoxelGrid(
            size=(first.columns, first.rows, len(ordered)),
            origin=origin,
            # PixelSpacing is row spacing (y), then column spacing (x); the grid is x, y, z
            spacing=np.array([*first.pixel[::-1], spacing]),
            direction=np.column_stack([axes[0], axes[1], step / spacing]),
        )
        check_grid(grid)
        frames = Counter(item.file for item in slices)
        for item in ordered:  # unpacked files hold all voxels that they claim
            needed = frames[item.file] * item.rows * item.columns * item.bits // 8
            size = item.file.stat().st_size
            if not item.syntax.is_compressed and not item.syntax.is_deflated and size < needed:
                raise refusal(f"""claims {item.columns} x {item.rows} voxels, {needed} bytes, and has {size}
                    expected: all its voxels
                    fix: the file is cut short or damaged: copy it again, or export the series again
                    where: {item.where}""")
        voxels, voxel_bytes = math.prod(grid.size), max(item.bits for item in slices) // 8
        check_expansion(voxels * voxel_bytes, 4 * voxels, sum(file.stat().st_size for file in frames))
    return ordered, grid


def describe_headers(slices: Sequence[DicomSlice], grid: VoxelGrid) -> list[str]:
    """Return warnings about a straight stack whose headers state a tilt, or leave the unit of values open."""
    notes, tilt = [], max((item.tilt for item in slices), key=abs)
    if abs(tilt) >= MIN_TILT_DEG and not is_tilted(grid.direction):
        notes.append(
            f"the scan's headers state a gantry tilted by {abs(tilt):g} degrees (GantryDetectorTilt), but "
            "its slices stand straight: right if it was straightened after the scan, else all in it is "
            "sheared"
        )
    if any(item.unit == "US" for item in slices):
        notes.append(
            "the scan's headers call the unit of its values unspecified (RescaleType US): thresholds and the "
            "edge of the tissue are right only if air is -1000 and water 0"
        )
    return notes


def _kind_fault(item: DicomSlice) -> tuple[str, str, str] | None:
    """Return what forbids one file in any stack: what, expected, fix."""
    if item.frames > 1:
        fix = "convert it to NRRD, e.g. with 3D Slicer, or export it as single-frame (classic) or enhanced CT"
        return f"holds {item.frames} frames without their positions", "one slice a file, or enhanced CT", fix
    if LOCALIZER in item.kind:
        fix = "name the folder with the slices of the scan, or export its series"
        return "is a localizer (scout, topogram), no slice", "the slices of a CT volume", fix
    if item.modality not in XRAY_MODALITIES:
        fix = "give the CT; if this is one and its header is wrong, save it as NRRD, e.g. with 3D Slicer"
        what = f"is no CT: its Modality is {item.modality}"
        return what, "attenuation of X-rays, in HU: its thresholds separate needle, tissue and air", fix
    places = {"ImagePositionPatient": item.position, "ImageOrientationPatient": item.axes}
    missing = [name for name, value in (places | {"PixelSpacing": item.pixel}).items() if value is None]
    if missing:
        return f"has no {', '.join(missing)}", "where the slice stands in the patient", _EXPORT_FIX
    if item.samples != 1 or item.table:
        what = "rescales its values by a table" if item.table else f"holds {item.samples} colours a voxel"
        return what, "one attenuation a voxel, with a slope and an intercept", _EXPORT_FIX
    if item.inverted:
        what = "its PhotometricInterpretation is MONOCHROME1: small numbers are white"
        return what, "MONOCHROME2, in which metal has the greatest numbers, in HU", _EXPORT_FIX
    if item.rescale is None:
        return "has no RescaleSlope, RescaleIntercept: its values are no HU", "how values become HU", HU_FIX
    if item.unit not in HU_UNITS:
        return f"RescaleType is {item.unit}: its values are no HU", "a series in HU", HU_FIX
    if item.rescale[0] == 0.0:
        return "RescaleSlope is 0", "a slope that keeps the values apart", _EXPORT_FIX
    if item.syntax not in DECODED_SYNTAXES:
        name = UID(item.syntax).name
        fix = "decompress the series, e.g. `gdcmconv --raw IN OUT` for every file, or export it uncompressed"
        return f"is compressed as {name}, for which there is no decoder", "plain, RLE, JPEG, JPEG 2000", fix
    return None


def _check_alike(slices: Sequence[DicomSlice]) -> None:
    """See that all slices have the size, spacing, orientation and kind of values of the first."""
    first = slices[0]
    assert first.pixel is not None and first.axes is not None
    pixels = max(first.rows, first.columns)
    extent = pixels * float(first.pixel.max())
    size, spacing, axes = (first.rows, first.columns), first.pixel.tolist(), first.axes.round(4).tolist()
    for item in slices[1:]:
        assert item.pixel is not None and item.axes is not None
        apart, turned = np.abs(first.pixel - item.pixel), np.abs(first.axes - item.axes)
        own, other = first.frame_of_reference, item.frame_of_reference
        for name, allowed, found, same in (
            ("size", size, (item.rows, item.columns), size == (item.rows, item.columns)),
            ("frame of reference", own, other, own == other),
            ("pixel spacing", spacing, item.pixel.tolist(), apart.max() * pixels <= MAX_OFFSET_MM),
            ("orientation", axes, item.axes.round(4).tolist(), turned.max() * extent <= MAX_OFFSET_MM),
        ):
            if not same:
                raise refusal(f"""its {name} is {found}, that of {first.name} is {allowed}
                    expected: the same in every slice of a series
                    fix: move the slices of another scan to a folder of their own, or export the series again
                    where: {item.where}""")


def _measure_slice_step(
    ordered: Sequence[DicomSlice], positions: Floats, normal: Floats, allowed: float
) -> Floats:
    """Return the step (3,) from slice to slice, mm; `positions` (K, 3) are in their order along `normal`.

    `allowed`: distance from its place at which a slice may stand, mm.
    """
    if len(ordered) < 2:
        raise refusal("""holds one slice
            expected: a stack of slices
            fix: copy all files of the series into the folder""")
    along = (positions - positions[0]) @ normal  # (K,)
    steps = np.diff(along)
    usual = float(np.median(steps))
    doubled = int((steps < MIN_STEP_MM).sum())
    for (before, after), step in zip(pairwise(ordered), steps, strict=True):
        if step < MIN_STEP_MM:
            other = ", with other voxels" * (after.frame is None)  # copies of files were left out
            raise refusal(f"""stands at the same place as {before.name}{other}, as {doubled} of {len(ordered)}
                    slices do: these are several scans with one AcquisitionNumber, or none
                expected: one slice at each place
                fix: export one scan (phase, time, kernel), or move the slices of each to a folder of its own
                where: {after.where}""")
        if usual >= MIN_STEP_MM and step > MAX_STEP_RATIO * usual:
            raise refusal(f"""{round(step / usual) - 1 or 1} slice(s) missing between {before.name}
                    and {after.name}: a step of {step:.4g} mm where others are {usual:.4g} mm
                expected: a stack without gaps
                fix: copy the missing files; a series with two spacings must be resampled to one
                where: {before.file.parent}""")
    # how far slices have shifted in their own plane: a tilted gantry shifts all of them alike
    across = positions - positions[0] - along[:, None] * normal
    lean = across[-1] / along[-1]
    if np.linalg.norm(across, axis=1).max() <= allowed:
        lean = np.zeros(3)
    elif np.linalg.norm(across - np.outer(along, lean), axis=1).max() > allowed:
        beside = np.linalg.norm(across - np.median(across, axis=0), axis=1)
        worst, count = int(beside.argmax()), int((beside > allowed).sum())
        more = f", as {count - 1} more of {len(ordered)} slices do to some extent" if count > 1 else ""
        raise refusal(f"""stands {beside[worst]:.3g} mm beside most of the other slices{more}
            expected: {EXPECTED_STACK}
            fix: {_EXPORT_FIX}
            where: {ordered[worst].where}""")
    # the mean step: rounding of single positions must not add up over the stack
    spacing = float(along[-1]) / (len(ordered) - 1)
    astray = np.abs(along - spacing * np.arange(len(ordered)))
    if astray.max() > allowed:
        worst = int(astray.argmax())
        raise refusal(f"""stands {astray[worst]:.3g} mm from its place in an even stack of {spacing:.4g} mm
                steps
            expected: even steps, to {allowed:.2g} mm
            fix: resample the series to even steps, e.g. in 3D Slicer, and save it as NRRD
            where: {ordered[worst].where}""")
    return spacing * (normal + lean)
