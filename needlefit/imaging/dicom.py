"""Read a DICOM series as one volume: choose the series, check that it is one stack, and rescale its voxels.

Metal, tissue and air are distinguished by their attenuation, air by its -1000 HU. Hence only images made with
X-rays are taken (cone-beam scanners and C-arms say CT, some XA), and only with a rescaling: what is stored is
not HU but often HU + 1024. Slices of a tilted gantry lean; their positions are taken as stated. SimpleITK
would refuse such slices, and invent the positions of missing ones: it is used to unpack voxels only.
"""

import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pydicom
import SimpleITK as sitk
from numpy.typing import NDArray
from pydicom.errors import InvalidDicomError
from pydicom.uid import UID
from scipy.linalg import polar

from needlefit.arrays import Floats, are_bounded
from needlefit.errors import DataError, located
from needlefit.geometry.frames import UNIT_VECTOR_TOLERANCE
from needlefit.grouping import group_values
from needlefit.imaging.volume import SPACINGS_MM, VoxelGrid, check_grid, check_size, fill_unknown
from needlefit.imaging.volume_files import list_series_files
from needlefit.project.folders import MAX_LISTED_FILES
from needlefit.project.input_files import is_file, open_regular
from needlefit.project.reader_process import Arrays, allow_memory

# largest distance (mm) of a voxel from its place on an even stack: positions are written to 0.1 mm or better
MAX_OFFSET_MM = 0.1
# Modalities whose values are attenuations; converters leave the entry out, or write OT (other).
XRAY_MODALITIES = ("", "CT", "XA", "RF", "DX", "PX", "IO", "OT")
# allowed values of these entries; "" where there is none
PLAIN_ENTRIES = {
    "NumberOfFrames": ("", "1"),
    "SamplesPerPixel": ("", "1"),
    "PhotometricInterpretation": ("", "MONOCHROME2"),
    "ModalityLUTSequence": ("",),
    "Modality": XRAY_MODALITIES,
    # US is "unspecified", as cone-beam scanners write: air then shows whether the values are HU
    "RescaleType": ("", "HU", "HU_MOD", "US"),
}
EXPORT_FIX = (
    "export the series from the scanner again, as original axial slices in HU; or load it in 3D Slicer, and "
    "save the volume as NRRD, in HU (air -1000, water 0); a micro-CT scans air and water for this"
)
SLICE_BYTES_PER_PIXEL = 32  # memory (bytes) of a pixel of a slice: packed, unpacked, and in double precision
SUFFIXES = (".dcm", ".ima", ".dicom")
NUMBERS = {
    "Rows": 1,
    "Columns": 1,
    "ImagePositionPatient": 3,
    "ImageOrientationPatient": 6,
    "PixelSpacing": 2,
    "RescaleSlope": 1,
    "RescaleIntercept": 1,
}  # entries that are numbers, and the count of each


@dataclass(frozen=True, eq=False)
class DicomSlice:
    """The header of one image of a series."""

    file: Path
    data: pydicom.Dataset
    number: dict[str, Floats]  # the entries `NUMBERS`; NaN where it has none

    def text(self, name: str) -> str:
        """Return an entry as text; empty where the file has none."""
        value = self.data.get(name)
        return "" if value is None else str(value).strip()

    @property
    def series(self) -> str:
        """UID of its series, or what stands for it."""
        return self.text("SeriesInstanceUID") or f"not stated, number {self.text('SeriesNumber') or 'none'}"

    @property
    def is_localizer(self) -> bool:
        """Whether the file is marked as an overview."""
        return "LOCALIZER" in (self.data.get("ImageType") or ())


def read_series(arrays: Arrays, path: str, series: str | None) -> tuple[list[str], dict[str, str]]:
    """Read the one series that `path` refers to: add its values and its grid to the arrays; return warnings.

    Values are rescaled slice by slice; voxels that were not measured (padding) get the value of air.
    Localizers are left out.

    DataError if the series is not one sound stack, or a voxel cannot be read.
    """
    images = find_series(Path(path), series)
    slices, grid = stack_slices([item for item in images if not item.is_localizer] or images)
    allow_memory(grid.size[0] * grid.size[1] * SLICE_BYTES_PER_PIXEL + 5 * math.prod(grid.size))  # and a mask
    values = arrays["values"] = np.empty(grid.size[::-1], np.float32)
    arrays |= vars(grid)
    for item, plane in zip(slices, values, strict=True):
        plane[...] = _read_plane(item)
    with located(path):
        fill_unknown(values)
    localizers = len(images) - len(slices)
    return [f"{localizers} localizer(s) were left out"] * (localizers > 0), {}


def read_header(file: Path) -> DicomSlice | None:
    """Return the header of the image in a file; None if it is no DICOM image but, say, a report or a text.

    DataError if it is named as a DICOM file and is none, or its header is cut short.
    """
    try:
        with open_regular(file, sys.maxsize) as content:
            data = pydicom.dcmread(content, stop_before_pixels=True)
            stated = UID(str(data.file_meta.get("MediaStorageSOPClassUID", "")))
            if stated.name != stated and "Image Storage" not in stated.name:
                return None
            if not content.read(1):
                raise EOFError  # of a header that is cut short, the rest would be taken for another series
            number = {name: np.array(data.get(name), np.float64).ravel() for name in NUMBERS}
    except (DataError, MemoryError):
        raise
    except Exception as error:  # pydicom raises what the bytes provoke
        if isinstance(error, InvalidDicomError) and file.suffix.lower() not in SUFFIXES:
            return None
        raise _damaged(file) from error
    return DicomSlice(file, data, number)


def _damaged(file: Path, packed: str = "") -> DataError:
    return DataError(
        f"is damaged or cut short, or no DICOM image{packed}",
        expected="a whole DICOM file",
        fix="copy the file again, or export the series again, uncompressed",
        where=file,
    )


def find_series(path: Path, series: str | None) -> list[DicomSlice]:
    """Return the slices of the one series that `path` refers to, in no order.

    `path`: a folder with its subfolders, or one file of a series.
    `series`: number or UID of the series, where a folder holds several.

    DataError if there is no DICOM image there, no series of the name, or several to choose from; also if a
    DICOM file is damaged.
    """
    if is_file(path):
        named = read_header(path)
        if named is None:
            raise DataError(
                "is not a volume that can be read",
                expected="a DICOM image, or a file that ends in .nrrd, .nii, .nii.gz or .mha; values in HU",
                fix="name the scan's folder, or export it so; structure sets (RTSTRUCT) are read by "
                "`needlefit import`; pictures (a micro-CT's TIFF) 3D Slicer saves as NRRD, in HU",
                where=path,
            )
        series = named.series
    headers = filter(None, map(read_header, list_series_files(path)))
    groups = group_values((item.series, item) for item in headers)
    if series is None:  # stacks of slices made with X-rays, if there are any
        chosen = [*filter(_is_stack, groups.values())] or [*groups.values()]
    else:
        chosen = [group for uid, group in groups.items() if series in (uid, group[0].text("SeriesNumber"))]
    if len(chosen) == 1:
        return chosen[0]
    listed = map(_describe, [*(chosen or groups.values())][:MAX_LISTED_FILES])
    raise DataError(
        f"holds {len(chosen) or 'no'} series of DICOM images{f' called {series}' if series else ''}; in all: "
        f"{'; '.join(listed) or 'none'}",
        expected="one series, in the folder or below it, or the name of the one that is meant",
        fix="name the folder in which the slices lie, or the .nrrd or .nii.gz file itself; of several series "
        "give the number or the UID with --series, or under `series` in a table of scans",
        where=path,
    )


def _is_stack(slices: Sequence[DicomSlice]) -> bool:
    """Whether a series is a stack made with X-rays, not an overview, one image or pictures of a report."""
    placed = (len(item.number["ImagePositionPatient"]) == 3 and not item.is_localizer for item in slices)
    is_stack = sum(placed) > 1 or "NumberOfFrames" in slices[0].data
    return is_stack and slices[0].text("Modality").upper() in XRAY_MODALITIES


def _describe(slices: Sequence[DicomSlice]) -> str:
    """Return a series in words."""
    item = slices[0]
    called = f"number {item.text('SeriesNumber') or 'none'} {item.text('SeriesDescription')!r}"
    kind = f"({item.text('Modality') or 'no modality'}, {len(slices)} images)"
    return f"{called} {kind} in {item.file.parent}/, UID {item.series}"


def stack_slices(slices: Sequence[DicomSlice]) -> tuple[list[DicomSlice], VoxelGrid]:
    """Return the slices in the order of their positions, and the grid of their voxels.

    The order is along the normal of the slices (row cross column direction), so that the axes of the
    grid are right-handed; file names and instance numbers do not matter.

    DataError if the slices are not one even, complete stack of plain images, straight or evenly leaning.
    """
    first = slices[0]
    for item in slices:
        for problem in _list_faults(item, first):
            expected = "plain slices of one CT volume in HU, with their places in the patient"
            raise DataError(problem, expected=expected, fix=EXPORT_FIX, where=item.file)
    with located(first.file):
        size = (int(first.data.Columns), int(first.data.Rows), len(slices))
        check_size(size)
        axes = first.number["ImageOrientationPatient"].reshape(2, 3)
        normal = np.cross(*axes)
        ordered = sorted(slices, key=lambda item: float(item.number["ImagePositionPatient"] @ normal))
        origin, step = _fit_steps(ordered, normal)
        # PixelSpacing is row spacing (y), then column spacing (x); the grid is x, y, z
        steps = np.array([*first.number["PixelSpacing"][::-1], np.linalg.norm(step)])
        grid = VoxelGrid(size, origin, steps, np.column_stack([*axes, step / steps[2]]))
        check_grid(grid)
    return ordered, replace(grid, direction=np.column_stack([polar(axes.T)[0], step / steps[2]]))


def _list_faults(item: DicomSlice, first: DicomSlice) -> Iterator[str]:
    """Yield what is wrong with one slice of a stack, and in what it differs from the `first` one."""
    number = item.number
    for name, allowed in PLAIN_ENTRIES.items():
        if (text := item.text(name).upper()) not in allowed:
            yield f"its {name} is {text[:40]}"
    if item.is_localizer:
        yield "is a localizer (scout, topogram), no slice"
    for name, count in NUMBERS.items():
        if len(number[name]) != count or not are_bounded(number[name]):
            yield f"its {name} is {item.text(name)[:40] or 'not stated'}, no {count} finite number(s)"
    if item.text("FrameOfReferenceUID") != first.text("FrameOfReferenceUID"):
        yield f"its FrameOfReferenceUID is not that of {first.file.name}"
    last_voxel = np.concatenate([number["Rows"], number["Columns"]])  # to which errors of the spacing add up
    tolerances = {
        "Rows": 0.0,
        "Columns": 0.0,
        "ImageOrientationPatient": UNIT_VECTOR_TOLERANCE,
        "PixelSpacing": MAX_OFFSET_MM / last_voxel.clip(1),
    }
    for name, tolerance in tolerances.items():
        if (np.abs(number[name] - first.number[name]) > tolerance).any():
            yield f"its {name} is {number[name]}, that of {first.file.name} is {first.number[name]}"


def _fit_steps(ordered: Sequence[DicomSlice], normal: Floats) -> tuple[Floats, Floats]:
    """Return the position of the first slice and the step from slice to slice, (3,) each, mm.

    They are fitted by least squares: rounding of single positions must not add up over the stack. Slices are
    in their order along the `normal` (3,).

    DataError if a slice is missing, is there twice, or lies beside the stack.
    """
    positions = np.array([item.number["ImagePositionPatient"] for item in ordered])  # (K, 3)
    count, rises = np.arange(len(ordered)), np.diff(positions, axis=0)
    step, origin = np.polyfit(count, positions, 1)
    away = np.linalg.norm(origin + np.outer(count, step) - positions, axis=1).max()
    # where one slice is missing, or stands twice, one is away by more than a fifth of the step
    if away < min(MAX_OFFSET_MM, np.linalg.norm(step) / 5):
        return origin, step
    along = rises @ normal
    is_apart = along >= SPACINGS_MM[0]  # of several slices at each place most steps are 0
    usual = np.median(rises[is_apart] if is_apart.any() else rises, axis=0)
    n = int(np.linalg.norm(rises - usual, axis=1).round(3).argmax())
    beside = np.linalg.norm(rises[n] - along[n] * normal)
    raise DataError(
        f"{ordered[n + 1].file.name} stands {along[n]:.4g} mm behind {ordered[n].file.name} and {beside:.3g} "
        f"mm beside it, where {usual @ normal:.4g} mm behind is usual; one slice stands {away:.3g} mm from "
        "its place in an even stack",
        expected=f"an even stack, to {MAX_OFFSET_MM:g} mm, one slice at each place, straight above each "
        "other or all leaning alike",
        fix="copy missing files; move copies and other scans (phases, kernels) to other folders; "
        f"{EXPORT_FIX}",
        where=ordered[n + 1].file,
    )


def _read_plane(item: DicomSlice) -> NDArray[np.float64]:
    """Return the rescaled values (rows, columns) of a slice; nan where nothing was measured."""
    try:
        image = sitk.ReadImage(str(item.file), imageIO="GDCMImageIO")
    except RuntimeError as error:
        syntax = UID(str(item.data.file_meta.get("TransferSyntaxUID")))
        raise _damaged(item.file, f"; its voxels are packed as {syntax.name}") from error
    plane = sitk.GetArrayFromImage(image)[0].astype(np.float64)
    if (padding := item.data.get("PixelPaddingValue")) is not None:
        # padding is given in stored values, before the rescaling; some scanners write -2000 as 63536
        stored = np.rint((plane - item.number["RescaleIntercept"]) / item.number["RescaleSlope"])
        plane[(stored - padding) % 2**16 == 0] = np.nan
    return plane
