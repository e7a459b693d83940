"""Read a DICOM series as one volume: choose the series, check that it is one stack, and rescale its voxels.

Metal, tissue and air are distinguished by their attenuation, air by its -1000 HU. Hence only images made with
X-rays are taken (cone-beam scanners and C-arms say CT, some XA), and only with a rescaling: what is stored is
no HU, often these plus 1024. Slices of a tilted gantry lean; they are read where their positions say.
SimpleITK would refuse these, and make up the places of missing slices: it unpacks voxels only.
"""

import math
import sys
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pydicom
import SimpleITK as sitk
from numpy.typing import NDArray
from pydicom.errors import InvalidDicomError
from pydicom.uid import UID

from needlefit.arrays import Floats, are_bounded
from needlefit.errors import DataError, located
from needlefit.imaging.volume import SPACINGS_MM, VoxelGrid, check_grid, orthogonalize
from needlefit.imaging.volume_files import list_series_files
from needlefit.project.folders import MAX_LISTED_FILES
from needlefit.project.input_files import is_file, open_regular
from needlefit.project.reader_process import Arrays, allow_memory

# largest distance (mm) of a slice from its place on an even stack: positions are written to 0.1 mm or better
MAX_OFFSET_MM = 0.1
MAX_LEAN = 1e-3  # largest tilt of the stack, as a sine: axes are written to three decimals or better
# Modalities whose values are attenuations; converters leave the entry out, or write OT (other).
XRAY_MODALITIES = ("", "CT", "XA", "RF", "DX", "PX", "IO", "OT")
# allowed values of these entries; "" where there is none
PLAIN_ENTRIES = {
    "NumberOfFrames": ("", "1"),
    "SamplesPerPixel": ("", "1"),
    "PhotometricInterpretation": ("", "MONOCHROME2"),
    "ModalityLUTSequence": ("",),
    "Modality": XRAY_MODALITIES,
    # US is "unspecified", as cone-beam scanners write.
    "RescaleType": ("", "HU", "HU_MOD", "US"),
}
UNSPECIFIED_UNIT = (
    "the scan's headers call the unit of its values unspecified (RescaleType US): thresholds and the edge of "
    "the tissue are right only if air is -1000 and water 0"
)
EXPORT_FIX = (
    "export the series from the scanner again, as original axial slices in HU; or load it in 3D Slicer, and "
    "save the volume as NRRD, in HU (air -1000, water 0); a micro-CT scans air and water for this"
)
# size (bytes) of the header of the voxels' entry, where types are stated and where not
ELEMENT_HEADER_BYTES = (12, 8)
SLICE_BYTES_PER_PIXEL = 32  # memory (bytes) of a pixel of a slice: packed, unpacked, and in double precision
SUFFIXES = (".dcm", ".ima", ".dicom")
NEEDED_NUMBERS = {
    "ImagePositionPatient": 3,
    "ImageOrientationPatient": 6,
    "PixelSpacing": 2,
    "RescaleSlope": 1,
    "RescaleIntercept": 1,
}  # entries that are numbers, and the count of each
NUMBERS = {**NEEDED_NUMBERS, "PixelPaddingValue": 1}
sitk.ProcessObject.SetGlobalWarningDisplay(False)  # errors are reported once, by our own messages


@dataclass(frozen=True, eq=False)
class DicomSlice:
    """The header of one image of a series."""

    file: Path
    data: pydicom.Dataset
    number: dict[str, Floats]  # the entries `NUMBERS` that it has

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


def read_series(arrays: Arrays, path: str, series: str | None) -> list[str]:
    """Read the one series that `path` refers to: add "values" and "grid" to the arrays; return warnings.

    Values are rescaled slice by slice; voxels that were not measured (padding) get the least value that
    was, so that no threshold and no edge finds them. Localizers are left out.

    DataError if the series is not one sound stack, or a voxel cannot be read.
    """
    images = find_series(Path(path), series)
    slices, grid = stack_slices([item for item in images if not item.is_localizer] or images)
    largest = max(item.file.stat().st_size for item in slices)
    allow_memory(grid.size[0] * grid.size[1] * SLICE_BYTES_PER_PIXEL + 4 * math.prod(grid.size) + largest)
    values = arrays["values"] = np.empty(grid.size[::-1], np.float32)
    arrays |= grid.placing
    for item, plane in zip(slices, values, strict=True):
        plane[...] = _read_plane(item)
    least = np.fmin.reduce(values, axis=None)
    if np.isnan(least):
        raise DataError(
            "holds nothing but padding",
            expected="measured values; padding is what PixelPaddingValue states",
            fix="check PixelPaddingValue, or export the series again",
            where=slices[0].file.parent,
        )
    for plane in values:
        plane[np.isnan(plane)] = least
    localizers = len(images) - len(slices)
    notes = [f"{localizers} localizer(s) were left out"] * (localizers > 0)
    return notes + [UNSPECIFIED_UNIT] * any(item.text("RescaleType").upper() == "US" for item in slices)


def read_header(file: Path) -> DicomSlice | None:
    """Return the header of the image in a file; None if it is no DICOM image but, say, a report or a text.

    DataError if it is named as a DICOM file and is none, or is cut short.
    """
    try:
        with open_regular(file, sys.maxsize) as content, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what pydicom doubts and we use is checked here
            data = pydicom.dcmread(content, stop_before_pixels=True)
            stated = UID(str(data.file_meta.get("MediaStorageSOPClassUID") or data.get("SOPClassUID") or ""))
            if stated.name != stated and "Image Storage" not in stated.name:
                return None
            stored = file.stat().st_size - content.tell()
            header = ELEMENT_HEADER_BYTES[bool(data.original_encoding[0])]
            needed = header + data.get("BitsAllocated", 16) * data.Rows * data.Columns // 8
            syntax = UID(str(data.file_meta.get("TransferSyntaxUID") or ""))
            if stored <= header or (not syntax.is_compressed and stored < needed):
                raise EOFError  # voxels that are not there would be read as others
            number = {
                name: np.array(value, dtype=np.float64).ravel()
                for name in NUMBERS
                if (value := data.get(name)) not in (None, "")
            }
    except (DataError, MemoryError):
        raise
    except Exception as error:  # pydicom raises what the bytes provoke
        if isinstance(error, InvalidDicomError) and file.suffix.lower() not in SUFFIXES:
            return None
        raise _damaged(file) from error
    for name, array in number.items():
        if len(array) != NUMBERS[name] or not are_bounded(array):
            raise DataError(
                f"{name} is {array.tolist()}",
                expected=f"{NUMBERS[name]} finite number(s), as the DICOM standard asks for",
                fix=EXPORT_FIX,
                where=file,
            )
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
    named = read_header(path) if is_file(path) else None
    if is_file(path) and named is None:
        raise DataError(
            "is not a volume that can be read",
            expected="a DICOM image, or a file that ends in .nrrd, .nii, .nii.gz or .mha; values in HU",
            fix="name the scan's folder, or export it so; structure sets (RTSTRUCT) are read by `needlefit "
            "import`; pictures (a micro-CT's TIFF) 3D Slicer saves as NRRD, in HU",
            where=path,
        )
    groups: dict[str, list[DicomSlice]] = {}
    for item in map(read_header, list_series_files(path)):
        if item is not None:
            groups.setdefault(item.series, []).append(item)
    if named is not None:
        return groups[named.series]
    if series is not None:
        meant = series.strip()
        chosen = [group for uid, group in groups.items() if meant in (uid, group[0].text("SeriesNumber"))]
    else:  # stacks of slices made with X-rays, if there are any
        chosen = [*groups.values()]
        for wanted in (_is_stack, lambda slices: slices[0].text("Modality").upper() in XRAY_MODALITIES):
            chosen = [*filter(wanted, chosen)] or chosen
    if len(chosen) == 1:
        return chosen[0]
    listed = "; ".join(_describe(group, path) for group in [*(chosen or groups.values())][:MAX_LISTED_FILES])
    called = f" {series}" if series else ""
    raise DataError(
        f"holds {len(chosen) or 'no'} series{called} of DICOM images{listed and f': {listed}'}",
        expected="one series, in the folder or below it, or the name of the one that is meant",
        fix="name the folder in which the slices lie, or the .nrrd or .nii.gz file itself; of several series "
        "give the number or the UID with --series, or under `series` in a table of scans",
        where=path,
    )


def _is_stack(slices: Sequence[DicomSlice]) -> bool:
    """Whether a series is a stack, not an overview, a single image or pictures of a report."""
    placed = [item for item in slices if "ImagePositionPatient" in item.number and not item.is_localizer]
    return len(placed) > 1 or "NumberOfFrames" in slices[0].data


def _describe(slices: Sequence[DicomSlice], path: Path) -> str:
    """Return a series in words: one in a subfolder with its name."""
    item, folder = slices[0], slices[0].file.parent
    inside = "" if folder == path else f" in {folder.relative_to(path)}/"
    kind = f"{item.text('Modality') or 'no modality'}, {len(slices)} images{inside}"
    called = f"number {item.text('SeriesNumber') or 'none'} {item.text('SeriesDescription')!r}"
    return f"{called} ({kind}), UID {item.series}"


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
    with located(first.file.parent):
        if len(slices) < 2:
            raise DataError(
                "holds one slice",
                expected="a stack of slices",
                fix="copy all files of the series into the folder",
            )
        axes = first.number["ImageOrientationPatient"].reshape(2, 3)
        direction = orthogonalize(np.vstack([axes, np.cross(*axes)]).T)
        positions = np.array([item.number["ImagePositionPatient"] for item in slices])  # (K, 3)
        order = np.argsort(positions @ direction[:, 2], kind="stable")
        ordered = [slices[index] for index in order]
        origin, step = _fit_steps(ordered, positions[order], direction[:, 2])
        spacing = float(np.linalg.norm(step))
        upright = step / spacing
        lean = float(np.linalg.norm(np.cross(upright, direction[:, 2])))
        if lean <= MAX_LEAN:  # axes that were rounded are turned upright on the stack
            direction = orthogonalize(
                np.column_stack([direction[:, :2] - np.outer(upright, upright @ direction[:, :2]), upright])
            )
        elif lean * spacing * len(slices) > MAX_OFFSET_MM:
            direction = np.column_stack([direction[:, :2], upright])
        # PixelSpacing is row spacing (y), then column spacing (x); the grid is x, y, z
        steps = np.array([*first.number["PixelSpacing"][::-1], spacing])
        size = (int(first.data.Columns), int(first.data.Rows), len(ordered))
        grid = VoxelGrid(size, origin, steps, direction)
        check_grid(grid)
    return ordered, grid


def _list_faults(item: DicomSlice, first: DicomSlice) -> Iterator[str]:
    """Yield what is wrong with one slice of a stack, also against the `first` one."""
    number = item.number
    for name, allowed in PLAIN_ENTRIES.items():
        if (text := item.text(name).upper()) not in allowed:
            yield f"its {name} is {text[:40]}"
    if item.is_localizer:
        yield "is a localizer (scout, topogram), no slice"
    if missing := [name for name in NEEDED_NUMBERS if name not in number]:
        yield f"has no {', '.join(missing)}"
    axes = number["ImageOrientationPatient"].reshape(2, 3)
    if not (np.abs(axes @ axes.T - np.eye(2)) <= 2 * MAX_LEAN).all():
        yield f"ImageOrientationPatient is {axes.round(4).tolist()}, no two perpendicular unit vectors"
    if number["RescaleSlope"] == 0:
        yield "its RescaleSlope is 0"
    for name in ("Rows", "Columns", "FrameOfReferenceUID"):
        if (here := item.text(name)) != (there := first.text(name)):
            yield f"its {name} is {here}, that of {first.file.name} is {there}"
    for name in ("PixelSpacing", "ImageOrientationPatient"):
        if not np.allclose(number[name], first.number[name], 0, MAX_LEAN):
            yield f"its {name} is {number[name]}, that of {first.file.name} is {first.number[name]}"


def _fit_steps(ordered: Sequence[DicomSlice], positions: Floats, normal: Floats) -> tuple[Floats, Floats]:
    """Return the place of the first slice and the step from slice to slice, (3,) each, mm.

    By least squares: rounding of single positions must not add up over the stack. `positions` (K, 3) are in
    their order along the `normal`.
    """
    count, rises = np.arange(len(ordered)), np.diff(positions, axis=0)
    steps = rises @ normal
    step, origin = np.polyfit(count, positions, 1)
    away = np.linalg.norm(origin + np.outer(count, step) - positions, axis=1)
    lengths = np.column_stack([steps, np.linalg.norm(rises - np.outer(steps, normal), axis=1)])
    is_apart = steps >= SPACINGS_MM[0]  # of several slices at each place most steps are 0
    usual = np.median(lengths[is_apart] if is_apart.any() else lengths, axis=0)
    is_one = is_apart & (np.rint(steps / usual[0]) == 1)  # a missing slice makes a step of two
    if is_one.all() and away.max() <= MAX_OFFSET_MM:
        return origin, step
    odd = (np.abs(lengths - usual) > MAX_OFFSET_MM).any(axis=1) | ~is_one
    n = int((odd if odd.any() else away[1:]).argmax())
    (behind, beside), (step_mm, lean_mm) = lengths[n], usual
    raise DataError(
        f"{ordered[n + 1].file.name} stands {behind:.4g} mm behind {ordered[n].file.name} and "
        f"{beside:.3g} mm beside it, where {step_mm:.4g} and {lean_mm:.3g} mm are usual; {odd.sum()} of "
        f"{len(odd)} steps differ, and one slice stands {away.max():.3g} mm from its place in an even stack",
        expected=f"an even stack, to {MAX_OFFSET_MM:g} mm, one slice at each place, straight above each "
        "other or all leaning alike",
        fix="copy missing files; move copies and other scans (phases, kernels) to other folders; "
        f"{EXPORT_FIX}",
        where=ordered[n + 1].file,
    )


def _read_plane(item: DicomSlice) -> NDArray[np.float64]:
    """Return the rescaled values (rows, columns) of a slice; nan where nothing was measured."""
    reader = sitk.ImageFileReader()
    reader.SetImageIO("GDCMImageIO")
    reader.SetFileName(str(item.file))
    try:
        plane = sitk.GetArrayFromImage(reader.Execute()).astype(np.float64)[0]
    except RuntimeError as error:
        syntax = UID(str(item.data.file_meta.get("TransferSyntaxUID") or ""))
        raise _damaged(item.file, f"; its voxels are packed as {syntax.name}") from error
    if (low := item.number.get("PixelPaddingValue")) is not None:
        # padding is given in stored values, before the rescaling; some scanners write -2000 as 63536
        stored = np.rint((plane - item.number["RescaleIntercept"]) / item.number["RescaleSlope"])
        plane[(stored - low) % 2**16 == 0] = np.nan
    return plane
