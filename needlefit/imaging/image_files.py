"""Read NRRD and MetaImage files by SimpleITK, which works in LPS, and NIfTI files by nibabel, from RAS.

Of NIfTI files SimpleITK would invent a position where none is stated, and refuse slices of a tilted gantry.
"""

import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import SimpleITK as sitk
from numpy.typing import NDArray

from needlefit.errors import DataError, NeedlefitError, located
from needlefit.geometry.frames import RAS_TO_LPS
from needlefit.imaging.volume import READABLE_VOLUMES, VoxelGrid, check_grid, fill_unknown
from needlefit.imaging.volume_files import MAX_HEADER_BYTES, list_series_files
from needlefit.project.reader_process import Arrays, Planes, allow_memory

IMAGE_IOS = {".nrrd": "NrrdImageIO", ".nhdr": "NrrdImageIO", ".mha": "MetaImageIO", ".mhd": "MetaImageIO"}
# A function that reads the voxels (K, J, I) of a file, their grid, the bytes of one voxel, and the texts of
# the header by their keys
Image = tuple[Callable[[], NDArray[Any]], VoxelGrid, int, dict[str, str]]


def read_image(arrays: Arrays, path: str) -> tuple[list[str], dict[str, str]]:
    """Read an image file: add its values and grid to the arrays; return warnings, and texts of its header.

    DataError if the file is no image, is cut short, has not three dimensions, states no coordinate system,
    or claims an absurd size.
    """
    with located(path):
        file = Path(path)
        is_itk = file.suffix.lower() in IMAGE_IOS
        try:
            read, grid, voxel_bytes, texts = _open_itk(file) if is_itk else _open_nifti(file)
            check_grid(grid)
            # voxels packed, a buffer, and an array of them or of single precision
            allow_memory(math.prod(grid.size) * (3 * voxel_bytes + 8))
            values = read()
        except (NeedlefitError, MemoryError):
            raise
        except Exception as error:  # SimpleITK and nibabel raise what the bytes provoke
            raise DataError(
                f"cannot be read as a volume, or its voxels are not all there: {_last_line(error)}",
                expected=f"three dimensions, one number a voxel; {READABLE_VOLUMES}",
                fix="check that the file is not cut short, with the file of voxels that it may name, and its "
                "name ends as its format wants; export all slices as one volume, of several time points one; "
                "of segments that overlap: set Modify other segments to Overwrite all in the Segment Editor, "
                "and save again",
            ) from error
        notes = fill_unknown(values)
        arrays["values"] = values.view(Planes)
        arrays |= vars(grid)
        return notes, texts


def _open_nifti(file: Path) -> Image:
    image = nibabel.load(file)
    assert isinstance(image, nibabel.Nifti1Image), "it is no NIfTI file"  # NIfTI-2 is one, too
    header, kind, shape = image.header, image.get_data_dtype(), image.shape
    while len(shape) > 3 and shape[-1] == 1:
        shape = shape[:-1]
    _check_voxels(shape, kind.kind in "iuf")
    if not any(int(header[code]) for code in ("qform_code", "sform_code")):
        raise DataError(
            "does not state where it stands in the patient: qform_code and sform_code are 0",
            expected="a NIfTI header with a qform or an sform",
            fix="convert the scan from its DICOM series again",
        )
    if (unit := header.get_xyzt_units()[0]) not in ("mm", "unknown"):
        raise DataError(f"its lengths are in {unit}", expected="lengths in mm", fix="save it in mm, as NRRD")
    affine = RAS_TO_LPS.rotation @ image.affine[:3]
    columns, rows, _ = shape
    spacing = np.linalg.norm(affine[:, :3], axis=0)
    grid = VoxelGrid(shape, affine[:, 3], spacing, affine[:, :3] / spacing)
    corners = np.array([[0, 0, 0, 1], [columns, 0, 0, 1], [0, rows, 0, 1]]).T  # of a slice: no qform leans
    other = header.get_qform() if header["qform_code"] else image.affine  # which is that of the sform, if any
    apart = np.linalg.norm(((image.affine - other) @ corners)[:3], axis=0).max()
    if apart > spacing.min():
        raise DataError(
            f"its qform and its sform place a voxel {apart:.3g} mm apart",
            expected="one place in the patient",
            fix="convert the scan from its DICOM series again, or remove the wrong one (its code is then 0)",
        )
    # i runs fastest: the transpose is k, j, i
    return (
        lambda: np.ascontiguousarray(np.asarray(image.dataobj, np.float32).reshape(shape).T),
        grid,
        kind.itemsize,
        {},
    )


def _open_itk(file: Path) -> Image:
    reader = sitk.ImageFileReader()
    reader.SetImageIO(IMAGE_IOS[file.suffix.lower()])
    reader.SetFileName(str(file))
    reader.ReadImageInformation()
    # none of a vector
    kind = re.fullmatch(r"(\d+)-bit .*", sitk.GetPixelIDValueAsString(reader.GetPixelID()))
    _check_voxels(reader.GetSize(), kind is not None)
    texts = {key: reader.GetMetaData(key) for key in reader.GetMetaDataKeys()}
    space = texts.get("NRRD_space", "")  # where there is none SimpleITK makes up the patient's left
    # MetaImage is LPS by its definition
    if reader.GetImageIO() == "NrrdImageIO" and space != "left-posterior-superior":
        raise DataError(
            f"its space is {space or 'not stated'}, which does not describe the patient",
            expected="`space: left-posterior-superior` or another anatomical one in the header",
            fix="export it from a program that knows the patient's axes, such as 3D Slicer",
        )
    voxel_bytes = int(kind[1]) // 8 if kind else 0
    # what SimpleITK would make up, too: a spacing, and where voxels begin
    with file.open("rb") as content:
        header = content.read(MAX_HEADER_BYTES)
    if reader.GetImageIO() == "MetaImageIO" and not re.search(rb"(?m)^Element(Spacing|Size)\s*=", header):
        raise DataError(
            "does not state the distances of its voxels",
            expected="`ElementSpacing = ` and three numbers, mm, in the header",
            fix="export the scan again, or add them",
        )
    total_bytes = math.prod(reader.GetSize()) * voxel_bytes
    for data in list_series_files(file)[1:]:
        if (size := data.stat().st_size) > total_bytes:
            raise DataError(
                f"{data.name} has {size} bytes, its voxels {total_bytes}",
                expected="a file of voxels alone",
                fix="save the scan as one file: .nrrd or .mha",
            )
    direction = np.reshape(reader.GetDirection(), (3, 3))
    grid = VoxelGrid(reader.GetSize(), np.array(reader.GetOrigin()), np.array(reader.GetSpacing()), direction)
    # indexed k, j, i, the reverse of the image's sizes
    return lambda: sitk.GetArrayFromImage(reader.Execute()), grid, voxel_bytes, texts


def _check_voxels(shape: Sequence[int], are_numbers: bool) -> None:
    if len(shape) != 3 or not are_numbers:
        of = "one number" if are_numbers else "several numbers"
        raise ValueError(f"it is no single volume, but {' x '.join(map(str, shape))} voxels of {of}")


def _last_line(error: Exception) -> str:
    """Return the last line of an error, which names the cause, without addresses of memory."""
    lines = re.findall(r"^(?!Reason: ).+", str(error), re.MULTILINE) or ["cut short"]  # a reason is errno's
    return re.sub(r"\w+\(0x[0-9a-f]+\): ", "", lines[-1])[:200]
