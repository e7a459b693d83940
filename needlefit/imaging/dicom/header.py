"""Read the header of one DICOM file, of an enhanced one that of each frame; voxels are not read."""

import os
import sys
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pydicom
from pydicom.errors import InvalidDicomError
from pydicom.uid import UID, ImplicitVRLittleEndian

from needlefit.arrays import Floats, are_bounded
from needlefit.errors import DataError
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
_FRAME_ENTRIES = {
    "PlanePositionSequence": ("ImagePositionPatient",),
    "PlaneOrientationSequence": ("ImageOrientationPatient",),
    "PixelMeasuresSequence": ("PixelSpacing",),
    "PixelValueTransformationSequence": ("RescaleSlope", "RescaleIntercept", "RescaleType"),
    "CTImageFrameTypeSequence": ("FrameType",),
}
"""Where an enhanced file keeps, for one frame or for all, what a plain one keeps at its top."""

MAX_FRAMES = 2**16
_SUFFIXES = (".dcm", ".ima", ".dicom")
_PREAMBLE_BYTES = 132
MAX_OVERREAD_BYTES = 256
"""So much more may be asked for than there is: a preamble, the head of an element behind the last."""


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
    """The header of one image of a series.

    Attributes
    ----------
    series, number, description : str
        UID, number and name of its series; the latter two empty where the file has none.
    modality : str
        What kind of machine made it, "CT" for most; empty where the file does not say.
    tilt : float
        Stated angle of the gantry, degrees.
    syntax : UID
        How the voxels are packed.
    frame_of_reference : str
        Slices of one volume share it.
    kind : tuple of str
        ImageType; "LOCALIZER" among them marks an overview.
    rows, columns, frames, samples, bits : int
        Size, and numbers and bits of a voxel.
    position : (3,) array or None
        Centre of the first voxel, LPS, mm.
    axes : (2, 3) array or None
        LPS directions of growing column and row index.
    pixel : (2,) array or None
        Spacing of rows and of columns, mm.
    rescale : (2,) array or None
        Slope and intercept.
    padding : (2,) array or None
        Least and greatest stored value that means "not measured".
    table : bool
        Whether values are rescaled by a table.
    unit : str
        RescaleType; empty where the file does not say: HU.
    frame : int or None
        Index of the image among those of an enhanced multi-frame file; None in a file of one image.
    """

    file: Path
    series: str
    number: str
    description: str
    modality: str
    tilt: float
    syntax: UID
    frame_of_reference: str
    kind: tuple[str, ...]
    rows: int
    columns: int
    frames: int
    samples: int
    bits: int
    position: Floats | None
    axes: Floats | None
    pixel: Floats | None
    rescale: Floats | None
    padding: Floats | None
    table: bool
    unit: str = ""
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

    Raises
    ------
    DataError
        If it is named as a DICOM file and is none, is cut short, or an entry cannot be understood.
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
