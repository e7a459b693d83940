"""Read NRRD and MetaImage files by SimpleITK, which works in LPS, and NIfTI files by nibabel, from RAS.

SimpleITK would make up where a NIfTI file stands that does not say it, and refuse slices of a tilted gantry.
"""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import SimpleITK as sitk
from nibabel.filebasedimages import ImageFileError
from nibabel.spatialimages import HeaderDataError
from numpy.typing import NDArray

from needlefit.errors import DataError, located
from needlefit.geometry.frames import RAS_TO_LPS
from needlefit.imaging.volume import (
    VoxelGrid,
    check_expansion,
    check_grid,
    fill_unknown,
    grid_to_json,
    missing_voxels,
    not_one_volume,
    orthogonalize,
    unreadable_header,
)
from needlefit.project.reader_process import Arrays, allow_memory

IMAGE_IOS = {".nrrd": "NrrdImageIO", ".nhdr": "NrrdImageIO", ".mha": "MetaImageIO", ".mhd": "MetaImageIO"}
MILLIMETRES = {"meter": 1e3, "mm": 1.0, "micron": 1e-3}  # one unit of a NIfTI header in mm
NO_UNIT = (
    "the header states no unit of length (`xyzt_units`), and mm are taken: compare a known length, and state "
    "the unit where the file is made"
)
NO_SPACING = "the header states voxels of 1 x 1 x 1 mm, or no size at all: compare a known length"

sitk.ProcessObject.SetGlobalWarningDisplay(False)  # errors are reported once, by our own messages


@dataclass(frozen=True)
class ImageHeader:
    """The header of an image file, and what reads its voxels."""

    grid: VoxelGrid
    voxel_bytes: int  # of one voxel, as stored
    read: Callable[[], NDArray[np.float32]]  # (K, J, I)
    warnings: tuple[str, ...] = ()
    segments: tuple[tuple[str, str], ...] = ()  # texts about segments, by their keys


def read_image(arrays: Arrays, path: str, stored: int, labels: bool = False) -> dict[str, Any]:
    """Read an image file: add the array "values"; return its grid, warnings, and segments' texts.

    `stored`: bytes of the file, with that of its voxels.
    `labels`: whether the file holds labels.

    DataError if the file is none, is cut short, has not three dimensions, does not say in which coordinate
    system it stands, or claims an absurd size.
    """
    with located(path):
        file = Path(path)
        header = _open_itk(file, labels) if file.suffix.lower() in IMAGE_IOS else _open_nifti(file)
        grid, notes = header.grid, list(header.warnings)
        check_grid(grid)
        content, memory = (math.prod(grid.size) * size for size in (header.voxel_bytes, 4))
        check_expansion(content, memory, stored)
        allow_memory(2 * (content + memory) + stored)  # a buffer, one to convert into
        try:
            values = arrays["values"] = header.read()
        except (RuntimeError, OSError, EOFError, ValueError) as error:
            raise missing_voxels(f" ({_last_line(error)})") from error
        fill_unknown(values, notes, labels=labels)
        grid = replace(grid, direction=orthogonalize(grid.direction))
        return {**grid_to_json(grid), "texts": dict(header.segments), "warnings": notes}


def _open_nifti(file: Path) -> ImageHeader:
    try:
        image = nibabel.load(file)
        assert isinstance(image, nibabel.Nifti1Image)  # NIfTI-2 is one, too
        header, shape = image.header, list(image.shape)
        unit = header.get_xyzt_units()[0]
        affine = RAS_TO_LPS.rotation @ image.affine[:3] * MILLIMETRES.get(unit, 1.0)
        codes = int(header["qform_code"]), int(header["sform_code"])
    except (ImageFileError, HeaderDataError, ValueError, AssertionError) as error:
        raise unreadable_header(str(error)[:200]) from error
    while len(shape) > 3 and shape[-1] == 1:
        shape.pop()
    kind = image.get_data_dtype()
    if len(shape) != 3 or kind.kind not in "iuf":
        parts = "numbers" if kind.kind in "iuf" else "numbers of several parts"
        raise not_one_volume(f"{' x '.join(map(str, shape))} {parts}")
    if not any(codes):
        raise DataError(
            "does not state where it stands in the patient: qform_code and sform_code are 0",
            expected="a NIfTI header with a qform or an sform",
            fix="convert the scan from its DICOM series again",
        )
    columns, rows, slices = shape
    spacing = np.linalg.norm(affine[:, :3], axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):  # what this leaves `check_grid` refuses
        grid = VoxelGrid((columns, rows, slices), affine[:, 3], spacing, affine[:, :3] / spacing)

    def read() -> NDArray[np.float32]:
        values = np.asarray(image.dataobj, dtype=np.float32)
        return np.ascontiguousarray(values.reshape(shape).T)  # i runs fastest: its transpose is k, j, i

    return ImageHeader(grid, kind.itemsize, read, () if unit in MILLIMETRES else (NO_UNIT,))


def _open_itk(file: Path, labels: bool) -> ImageHeader:
    reader = sitk.ImageFileReader()
    reader.SetImageIO(IMAGE_IOS[file.suffix.lower()])
    reader.SetFileName(str(file))
    try:
        reader.ReadImageInformation()
    except RuntimeError as error:
        if "number of domain axes" in str(error):
            raise not_one_volume("more than three dimensions") from error
        raise unreadable_header(_last_line(error)) from error
    bits = re.search(r"(\d+)-bit", sitk.GetPixelIDValueAsString(reader.GetPixelID()))
    complex_ = reader.GetPixelID() in (sitk.sitkComplexFloat32, sitk.sitkComplexFloat64)
    parts = 2 if complex_ else reader.GetNumberOfComponents()
    if reader.GetDimension() != 3 or bits is None or parts != 1:
        if labels and parts != 1:
            raise DataError(
                f"its segments overlap, or once did: they lie in {parts} layers",
                expected="every voxel in one layer",
                fix=(
                    'in the Segment Editor set "Modify other segments" to "Overwrite all", '
                    "collapse the layers of the segmentation, and save it again"
                ),
            )
        size = " x ".join(map(str, reader.GetSize()))
        raise not_one_volume(f"{size} voxels of {parts} number{'s' * (parts > 1)}")
    texts = {key: reader.GetMetaData(key) for key in reader.GetMetaDataKeys()}
    space = texts.get("NRRD_space", "")  # where there is none SimpleITK makes up the patient's left
    # MetaImage is LPS by its definition
    if reader.GetImageIO() == "NrrdImageIO" and space != "left-posterior-superior":
        stated = f"its space is {space}, which does not describe the patient"
        raise DataError(
            stated if space else "does not state its space",
            expected="`space: left-posterior-superior` or another anatomical one in the header",
            fix="export it from a program that knows the patient's axes, such as 3D Slicer",
        )
    columns, rows, slices = reader.GetSize()
    origin, spacing, direction = map(
        np.array, (reader.GetOrigin(), reader.GetSpacing(), reader.GetDirection())
    )
    grid = VoxelGrid((columns, rows, slices), origin, spacing, direction.reshape(3, 3))
    segments = tuple((key, text) for key, text in texts.items() if re.fullmatch(r"Segment\d{1,4}_\w+", key))

    def read() -> NDArray[np.float32]:
        image = reader.Execute()  # a view does not keep its image
        # SimpleITK's arrays are indexed k, j, i: the reverse of its sizes
        return sitk.GetArrayViewFromImage(image).astype(np.float32)

    # SimpleITK makes up what is not stated
    return ImageHeader(grid, int(bits[1]) // 8, read, (NO_SPACING,) * bool((spacing == 1).all()), segments)


def _last_line(error: Exception) -> str:
    """Return the last line of an error, which names the cause, without addresses of memory."""
    return re.sub(r"\w+\(0x[0-9a-f]+\): ", "", str(error).strip().splitlines()[-1] or "cut short")[:200]
