"""Read the header of one DICOM file, of an enhanced one that of each frame; voxels are not read.

Stack slices into a volume, after checks of all headers and before any voxel is read.

Metal, tissue and air are distinguished by their attenuation, air by its -1000 HU. Hence only images made with
X-rays are taken (cone-beam scanners and C-arms say CT, some XA), and only with a rescaling: what is stored is
no HU, often these plus 1024, and an offset that is guessed would move the face of the tissue. A stated tilt
of the gantry is only remarked on where the slices stand straight above each other: a series that was
straightened keeps the entry, and the standard says that nothing is to be computed from it.
"""

import os
import sys
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pydicom
from pydicom.errors import InvalidDicomError
from pydicom.uid import UID, ImplicitVRLittleEndian

from needlefit.arrays import Floats, are_bounded
from needlefit.errors import DataError
from needlefit.imaging.image_headers import ImageHeader, check_expansion
from needlefit.imaging.volume import AXES_COSINE_TOLERANCE, VoxelGrid, check_grid, orthogonalize
from needlefit.project.input_files import open_regular

READ_TAGS = (
    *("SOPClassUID", "SeriesInstanceUID", "SeriesNumber", "SeriesDescription", "FrameOfReferenceUID"),
    *("Modality", "GantryDetectorTilt"),
    *("ImageType", "Rows", "Columns", "NumberOfFrames", "SamplesPerPixel", "BitsAllocated"),
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

MAX_FRAMES = 2**16
_SUFFIXES = (".dcm", ".ima", ".dicom")
_PREAMBLE_BYTES = 132
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
    # UID, number and name of its series; the latter two empty where the file has none.
    series: str
    number: str
    description: str
    modality: str  # what kind of machine made it, "CT" for most; empty where the file does not say
    tilt: float  # stated angle of the gantry, degrees
    syntax: UID  # how the voxels are packed
    frame_of_reference: str  # slices of one volume share it
    kind: tuple[str, ...]  # imageType; "LOCALIZER" among them marks an overview
    # Size, and numbers and bits of a voxel.
    rows: int
    columns: int
    frames: int
    samples: int
    bits: int
    position: Floats | None  # (3,) or None; centre of the first voxel, LPS, mm
    axes: Floats | None  # (2, 3) or None; LPS directions of growing column and row index
    pixel: Floats | None  # (2,) or None; spacing of rows and of columns, mm
    rescale: Floats | None  # (2,) or None; slope and intercept
    padding: Floats | None  # (2,) or None; least and greatest stored value that means "not measured"
    table: bool  # whether values are rescaled by a table
    unit: str = ""  # rescaleType; empty where the file does not say: HU
    # Index of the image among those of an enhanced multi-frame file; None in a file of one image.
    frame: int | None = None

    @property
    def name(self) -> str:
        """Name of the file, and of the frame in it."""
        return self.file.name + self._place

    @property
    def where(self) -> str:
        """Path of the file, and the frame in it."""
        return str(self.file) + self._place

    @property
    def _place(self) -> str:
        return "" if self.frame is None else f", frame {self.frame + 1}"


def read_headers(file: Path) -> tuple[DicomSlice, ...]:
    """Return the header of each image in a file; none if it is no DICOM image but, say, a report or a text.

    DataError if it is named as a DICOM file and is none, is cut short, or an entry cannot be understood.
    """
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore"
        )  # what pydicom doubts and we use is checked here, the rest is not ours
        try:
            with open_regular(file, sys.maxsize) as content:
                data = pydicom.dcmread(
                    _BoundedFile(content), stop_before_pixels=True, specific_tags=list(READ_TAGS)
                )
        except InvalidDicomError as error:
            if file.suffix.lower() in _SUFFIXES:
                raise damaged_file_error(file) from error
            return ()
        except DataError:  # no file that may be read
            raise
        except Exception as error:  # whatever the bytes provoke
            raise damaged_file_error(file) from error
        storage = str(data.file_meta.get("MediaStorageSOPClassUID") or data.get("SOPClassUID") or "")
        if storage and "Image Storage" not in UID(storage).name:
            if UID(storage).name == storage and "SOPClassUID" not in data:  # a UID cut short, nothing behind
                raise damaged_file_error(file)
            return ()
        if not all(name in data for name in ("SeriesInstanceUID", "Rows", "Columns")):
            raise damaged_file_error(file)
        whole = _parse_slice(file, data)
        if whole.frames > 1 and "PerFrameFunctionalGroupsSequence" in data:
            return _parse_frames(file, data, whole)
        return (whole,)


def _parse_frames(file: Path, data: pydicom.Dataset, whole: DicomSlice) -> tuple[DicomSlice, ...]:
    """Return the header of each frame of an enhanced file; `whole` is what all have in common."""
    try:
        own = list(data.PerFrameFunctionalGroupsSequence)
        shared = (data.get("SharedFunctionalGroupsSequence") or [pydicom.Dataset()])[0]
        if len(own) != whole.frames or len(own) > MAX_FRAMES:
            raise damaged_file_error(file)
        return tuple(
            replace(_parse_slice(file, _merge_groups(data, shared, one)), frame=n, frames=1)
            for n, one in enumerate(own)
        )
    except DataError:
        raise
    except Exception as error:  # as in `read_headers`
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
    return DicomSlice(
        file=file,
        series=str(data.SeriesInstanceUID),
        number=_to_text(data.get("SeriesNumber")),
        description=_to_text(data.get("SeriesDescription")),
        modality=_to_text(data.get("Modality")).upper(),
        tilt=_parse_tilt(file, data),
        syntax=UID(str(data.file_meta.get("TransferSyntaxUID") or ImplicitVRLittleEndian)),
        frame_of_reference=_to_text(data.get("FrameOfReferenceUID")),
        kind=(kind,) if isinstance(kind, str) else tuple(map(str, kind)),
        rows=_parse_whole_number(file, data, "Rows", 0),
        columns=_parse_whole_number(file, data, "Columns", 0),
        frames=_parse_whole_number(file, data, "NumberOfFrames", 1),
        samples=_parse_whole_number(file, data, "SamplesPerPixel", 1),
        bits=_parse_whole_number(file, data, "BitsAllocated", 16),
        position=_parse_numbers(file, data, ("ImagePositionPatient",), (3,)),
        # six numbers: the direction of a row (growing column index), then of a column
        axes=_parse_numbers(file, data, ("ImageOrientationPatient",), (2, 3)),
        pixel=_parse_numbers(file, data, ("PixelSpacing",), (2,)),
        rescale=_parse_numbers(file, data, ("RescaleSlope", "RescaleIntercept"), (2,)),
        padding=_parse_padding(file, data),
        table="ModalityLUTSequence" in data,
        unit=_to_text(data.get("RescaleType")).upper(),
    )


def _parse_tilt(file: Path, data: pydicom.Dataset) -> float:
    angle = _parse_numbers(file, data, ("GantryDetectorTilt",), (1,))
    return 0.0 if angle is None else float(angle[0])


def _parse_padding(file: Path, data: pydicom.Dataset) -> Floats | None:
    """Return the least and the greatest padding value as they are stored, with their sign."""
    values = [
        _parse_whole_number(file, data, name, 0)
        for name in ("PixelPaddingValue", "PixelPaddingRangeLimit")
        if data.get(name) is not None
    ]
    if not values or data.get("PixelPaddingValue") is None:
        return None
    if data.get("PixelRepresentation") == 1:  # some scanners write -2000 as 63536
        turn = 2 ** _parse_whole_number(file, data, "BitsAllocated", 16)
        values = [value - turn if value >= turn // 2 else value for value in values]
    return np.array([min(values), max(values)], dtype=np.float64)


def _parse_numbers(
    file: Path, data: pydicom.Dataset, names: tuple[str, ...], shape: tuple[int, ...]
) -> Floats | None:
    """Return the entries `names` as one array of `shape`; None if all are missing or empty."""
    entries = [_read_entry(file, data, name) for name in names]
    if all(entry is None or entry == "" for entry in entries):
        return None
    try:
        array = np.array(entries, dtype=np.float64).reshape(shape)
    except (TypeError, ValueError):
        raise _unclear_entry_error(file, " and ".join(names), entries) from None
    if not are_bounded(array):
        raise _unclear_entry_error(file, " and ".join(names), entries)
    return array


def _parse_whole_number(file: Path, data: pydicom.Dataset, name: str, default: int) -> int:
    value = _read_entry(file, data, name)
    if value is None or value == "":
        return default
    try:
        return int(value)
    except (TypeError, ValueError):
        raise _unclear_entry_error(file, name, value) from None


def _read_entry(file: Path, data: pydicom.Dataset, name: str) -> Any:  # noqa: ANN401 - whatever the file holds
    try:
        return data.get(name)
    except Exception:  # pydicom parses an entry when it is asked for, and raises what its bytes provoke
        raise _unclear_entry_error(file, name, "unreadable") from None


def _to_text(value: object) -> str:
    return "" if value is None else str(value).strip()


def _unclear_entry_error(file: Path, name: str, value: object) -> DataError:
    return DataError(
        f"{name} is {value}",
        where=str(file),
        expected="finite numbers, as many as the DICOM standard asks for",
        fix="export the series from the scanner or the archive again",
    )


def list_directory_files(file: Path, series: str) -> list[Path]:
    """Return the files that a DICOMDIR lists for a series; none where it cannot be read: it only confirms.

    Its records stand in the order of patients, studies, series and images, as programs write them.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with open_regular(file, sys.maxsize) as content:
                records = list(pydicom.dcmread(_BoundedFile(content)).DirectoryRecordSequence)
            found, current = list[Path](), ""
            for record in records:
                if record.get("DirectoryRecordType") == "SERIES":
                    current = str(record.get("SeriesInstanceUID"))
                elif current == series and "ReferencedFileID" in record:
                    parts = record.ReferencedFileID
                    found.append(file.parent.joinpath(*([parts] if isinstance(parts, str) else parts)))
            return found
    except MemoryError:
        raise
    except Exception:  # whatever the bytes provoke
        return []


def damaged_file_error(file: Path) -> DataError:
    """Return the error for a file of a series that is not DICOM, or is truncated."""
    empty = file.stat().st_size <= _PREAMBLE_BYTES
    return DataError(
        "is empty" if empty else "its DICOM header is damaged or cut short",
        where=str(file),
        expected="a whole DICOM file",
        fix="copy the file again, or export the series again",
    )


LOCALIZER = "LOCALIZER"


# A slice may stand this far from its place on an even stack, mm: positions rounded to 0.1 mm do.
MAX_OFFSET_MM = 0.05
MIN_STEP_MM = 1e-3  # slices closer than this are one, mm
MAX_STEP_RATIO = 1.5  # a step longer than this many usual ones lacks slices
# Modalities whose values are attenuations; converters leave the entry out, or write OT (other).
XRAY_MODALITIES = frozenset({"", "CT", "XA", "RF", "DX", "PX", "IO", "OT"})
OTHER_MODALITIES = {
    "MR": "magnetic resonance, in which a needle is a void without a sharp edge",
    "US": "ultrasound",
    "PT": "positron emission tomography",
    "NM": "nuclear medicine",
    "MG": "mammography",
    "OCT": "optical coherence tomography",
    "OPT": "optical coherence tomography",
}

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

EXPECTED_STACK = "every slice straight above the one before"
_EXPORT_FIX = "export the series from the scanner or the archive again, as original axial slices"


def stack_slices(slices: Sequence[DicomSlice]) -> tuple[list[DicomSlice], VoxelGrid]:
    """Return the slices in the order of their positions, and the grid of their voxels.

    The order is along the normal of the slices (row cross column direction), so that the axes of the
    grid are right-handed; file names and instance numbers do not matter.

    DataError if the slices are not one even, straight, complete stack of plain images.
    """
    _check_kinds(slices)
    _check_alike(slices)
    first = slices[0]
    axes, positions = _measure_axes(first), np.array([item.position for item in slices])  # (2, 3), (K, 3)
    normal = np.cross(axes[0], axes[1])
    order = np.argsort(positions @ normal, kind="stable")
    ordered, positions = [slices[index] for index in order], positions[order]
    spacing = _measure_slice_spacing(ordered, positions, normal)
    assert first.pixel is not None
    grid = VoxelGrid(
        size=(first.columns, first.rows, len(ordered)),
        origin=positions[0],
        # PixelSpacing is row spacing (y), then column spacing (x); the grid is x, y, z
        spacing=np.array([first.pixel[1], first.pixel[0], spacing]),
        direction=np.column_stack([axes[0], axes[1], normal]),
    )
    check_grid(grid, str(first.file.parent))
    _check_lengths(ordered)
    return ordered, grid


def describe_tilt(slices: Sequence[DicomSlice]) -> tuple[str, ...]:
    """Return a warning about a straight stack whose headers state a gantry tilt."""
    tilt = max((item.tilt for item in slices), key=abs)
    if abs(tilt) < MIN_TILT_DEG:
        return ()
    return (
        f"the scan's headers state a gantry tilted by {abs(tilt):g} degrees (GantryDetectorTilt), but "
        "its slices stand straight: right if it was straightened after the scan, else all in it is sheared",
    )


def describe_units(slices: Sequence[DicomSlice]) -> tuple[str, ...]:
    """Return a warning about values of which the headers do not say that they are HU."""
    if not any(item.unit == "US" for item in slices):
        return ()
    return (
        "the scan's headers call the unit of its values unspecified (RescaleType US): thresholds and the "
        "edge of the tissue are right only if air is -1000 and water 0",
    )


def _measure_axes(item: DicomSlice) -> Floats:
    """Return the row and column directions (2, 3) of a slice, made perpendicular to the last digit."""
    assert item.axes is not None
    if not (np.abs(item.axes @ item.axes.T - np.eye(2)) <= AXES_COSINE_TOLERANCE).all():
        raise DataError(
            f"ImageOrientationPatient is {item.axes.round(4).tolist()}",
            where=item.where,
            expected="two perpendicular unit vectors",
            fix=_EXPORT_FIX,
        )
    return orthogonalize(np.vstack([item.axes, np.cross(*item.axes)]).T).T[:2]


def _check_kinds(slices: Sequence[DicomSlice]) -> None:
    """See that every file is a plain image with a place in the patient."""
    faults = [(item, fault) for item in slices if (fault := _kind_fault(item)) is not None]
    if not faults:
        return
    (item, (what, expected, fix)), others = faults[0], len(faults) - 1
    more = f" ({others} more of {len(slices)} files have a fault of this sort)" if others else ""
    raise DataError(what + more, where=item.where, expected=expected, fix=fix)


def _kind_fault(item: DicomSlice) -> tuple[str, str, str] | None:
    """Return what forbids one file in any stack: what, expected, fix."""
    if item.frames > 1:
        fix = "convert it to NRRD, e.g. with 3D Slicer, or export it as single-frame (classic) or enhanced CT"
        return f"holds {item.frames} frames without their positions", "one slice a file, or enhanced CT", fix
    if LOCALIZER in item.kind:
        fix = "move localizers (scouts, topograms) to a folder of their own"
        return "is a localizer among the slices of a volume", "slices of the volume only", fix
    places = ("ImagePositionPatient", item.position), ("ImageOrientationPatient", item.axes)
    if item.modality not in XRAY_MODALITIES:
        meaning = OTHER_MODALITIES.get(item.modality, "")
        fix = "give the CT; if this is one and its header is wrong, save it as NRRD, e.g. with 3D Slicer"
        what = f"is no CT: its Modality is {item.modality}" + f", {meaning}" * bool(meaning)
        return what, "attenuation of X-rays, in HU: its thresholds separate needle, tissue and air", fix
    missing = [name for name, value in (*places, ("PixelSpacing", item.pixel)) if value is None]
    if missing:
        return f"has no {', '.join(missing)}", "where the slice stands in the patient", _EXPORT_FIX
    if item.samples != 1 or item.table:
        what = "rescales its values by a table" if item.table else f"holds {item.samples} colours a voxel"
        return what, "one attenuation a voxel, with a slope and an intercept", _EXPORT_FIX
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
    for item in slices[1:]:
        difference = _find_difference(first, item)
        if difference:
            raise DataError(
                f"its {difference[0]} is {difference[2]}, that of {first.name} is {difference[1]}",
                where=item.where,
                expected="the same in every slice of a series",
                fix="move the slices of another scan to a folder of their own, or export the series again",
            )


def _find_difference(one: DicomSlice, other: DicomSlice) -> tuple[str, object, object] | None:
    """Return in what two slices differ, and both values; None if in nothing that matters."""
    assert (
        one.pixel is not None and one.axes is not None and other.pixel is not None and other.axes is not None
    )
    pixels = max(one.rows, one.columns)
    extent = pixels * float(one.pixel.max())
    unlike = (
        ("size", (one.rows, one.columns), (other.rows, other.columns)),
        ("frame of reference", one.frame_of_reference, other.frame_of_reference),
    )
    for name, a, b in unlike:
        if a != b:
            return name, a, b
    if np.abs(one.pixel - other.pixel).max() * pixels > MAX_OFFSET_MM:
        return "pixel spacing", one.pixel.tolist(), other.pixel.tolist()
    if np.abs(one.axes - other.axes).max() * extent > MAX_OFFSET_MM:
        return "orientation", one.axes.round(4).tolist(), other.axes.round(4).tolist()
    return None


def _measure_slice_spacing(ordered: Sequence[DicomSlice], positions: Floats, normal: Floats) -> float:
    """Return the spacing of slices, mm, whose `positions` (K, 3) stand in their order along `normal`."""
    folder = str(ordered[0].file.parent)
    if len(ordered) < 2:
        raise DataError(
            "holds one slice",
            where=folder,
            expected="a stack of slices",
            fix="copy all files of the series into the folder",
        )
    along = (positions - positions[0]) @ normal  # (K,)
    _check_steps(ordered, np.diff(along))
    _check_straight(ordered, along, positions - positions[0] - along[:, None] * normal)
    # the mean step: rounding of single positions must not add up over the stack
    spacing = float(along[-1]) / (len(ordered) - 1)
    astray = np.abs(along - spacing * np.arange(len(ordered)))
    if astray.max() > MAX_OFFSET_MM:
        worst = int(astray.argmax())
        raise DataError(
            f"stands {astray[worst]:.3g} mm from its place in an even stack of {spacing:.4g} mm steps",
            where=ordered[worst].where,
            expected=f"even steps, to {MAX_OFFSET_MM} mm",
            fix="resample the series to even steps, e.g. in 3D Slicer, and save it as NRRD",
        )
    return spacing


def _check_steps(ordered: Sequence[DicomSlice], steps: Floats) -> None:
    """See that no slice is there twice and none is missing; `steps` (K - 1,), mm."""
    usual = float(np.median(steps))
    for (before, after), step in zip(pairwise(ordered), steps, strict=True):
        if step < MIN_STEP_MM:
            raise DataError(
                f"stands at the same place as {before.name}",
                where=after.where,
                expected="every slice once",
                fix="remove the copies; if the series holds several phases or times, export one of them",
            )
        if usual >= MIN_STEP_MM and step > MAX_STEP_RATIO * usual:
            raise DataError(
                f"{round(step / usual) - 1 or 1} slice(s) missing between {before.name} "
                f"and {after.name}: a step of {step:.4g} mm where others are {usual:.4g} mm",
                where=str(before.file.parent),
                expected="a stack without gaps",
                fix="copy the missing files; a series with two spacings must be resampled to one",
            )


def _check_straight(ordered: Sequence[DicomSlice], along: Floats, across: Floats) -> None:
    """See that the stack does not lean; `across` (K, 3) is how far slices shift in their own plane, mm."""
    if np.linalg.norm(across, axis=1).max() <= MAX_OFFSET_MM:
        return
    lean = np.outer(along / along[-1], across[-1])
    angle = np.degrees(np.arctan2(np.linalg.norm(across[-1]), along[-1]))
    if np.linalg.norm(across - lean, axis=1).max() > MAX_OFFSET_MM:
        raise _shifted_slices_error(ordered, across)
    raise DataError(
        f"the stack leans by {angle:.3g} degrees: the gantry was tilted",
        where=str(ordered[0].file.parent),
        expected=EXPECTED_STACK,
        fix="resample the series onto a straight grid, e.g. with the gantry-tilt correction of dcm2niix or "
        "3D Slicer, and save it as NRRD",
    )


def _shifted_slices_error(ordered: Sequence[DicomSlice], across: Floats) -> DataError:
    """Return the error for slices that stand beside the others; `across` (K, 3), mm."""
    beside = np.linalg.norm(across - np.median(across, axis=0), axis=1)
    worst, count = int(beside.argmax()), int((beside > MAX_OFFSET_MM).sum())
    more = f", as {count - 1} more of {len(ordered)} slices do to some extent" if count > 1 else ""
    return DataError(
        f"stands {beside[worst]:.3g} mm beside most of the other slices{more}",
        where=ordered[worst].where,
        expected=EXPECTED_STACK,
        fix=_EXPORT_FIX,
    )


def _check_lengths(slices: Sequence[DicomSlice]) -> None:
    """See that every unpacked file is long enough for the voxels that it claims."""
    frames = Counter(item.file for item in slices)
    for item in slices:
        needed = frames[item.file] * item.rows * item.columns * item.bits // 8
        size = item.file.stat().st_size
        plain = not item.syntax.is_compressed and not item.syntax.is_deflated
        if plain and size < needed:
            raise DataError(
                f"claims {item.columns} x {item.rows} voxels, {needed} bytes, and has {size} bytes",
                where=item.where,
                expected="all its voxels",
                fix="the file is cut short or damaged: copy it again, or export the series again",
            )
    first, packed = slices[0], sum(file.stat().st_size for file in frames)
    voxel_bytes = max(item.bits for item in slices) // 8
    promised = ImageHeader((first.columns, first.rows, len(slices)), voxel_bytes, packed)
    check_expansion(promised, first.file.parent)
