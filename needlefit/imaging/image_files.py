"""Read and write NRRD, NIfTI and MetaImage files by SimpleITK, which converts their coordinates to LPS."""

import gzip
import math
import re
import zlib
from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import SimpleITK as sitk
from numpy.typing import NDArray

from needlefit.errors import DataError
from needlefit.imaging.refusals import located, refusal
from needlefit.imaging.volume import (
    AXES_COSINE_TOLERANCE,
    READABLE_VOLUMES,
    Volume,
    VoxelGrid,
    check_expansion,
    check_grid,
    grid_to_json,
    not_one_volume,
    orthogonalize,
    sheared_axes,
)
from needlefit.project.folders import replace_file
from needlefit.project.reader_process import Arrays, allow_memory

IMAGE_IOS = {".nrrd": "NrrdImageIO", ".nhdr": "NrrdImageIO", ".mha": "MetaImageIO", ".mhd": "MetaImageIO"}
_COMPLEX = (sitk.sitkComplexFloat32, sitk.sitkComplexFloat64)
# One unit of a NIfTI header in mm.
_MILLIMETRES = {"meter": 1e3, "mm": 1.0, "micron": 1e-3}
_BLOCK_BYTES = 2**20
# zlib's fastest level: on noise, higher ones cost ten times the time for a few per cent.
_COMPRESSION_LEVEL = 1

sitk.ProcessObject.SetGlobalWarningDisplay(False)  # errors are reported once, by our own messages


def read_image(arrays: Arrays, path: str, stored: int, layers: bool = False) -> dict[str, Any]:
    """Read an image file: add the array "values"; return its grid, and texts about segments.

    `stored`: bytes of the file, with that of its voxels.
    `layers`: whether a voxel may have several numbers; the values then have a fourth axis for them.

    DataError if the file is none, is cut short, has not three dimensions, does not say in which coordinate
    system it stands, or claims an absurd size.
    """
    file = Path(path)
    with located(path):
        reader = sitk.ImageFileReader()
        reader.SetImageIO(IMAGE_IOS.get(file.suffix.lower(), "NiftiImageIO"))
        reader.SetFileName(path)
        try:
            reader.ReadImageInformation()
        except RuntimeError as error:
            if "orthonormal" in str(error):
                raise sheared_axes() from error
            if "number of domain axes" in str(error):
                raise not_one_volume("more than three dimensions") from error
            raise _unreadable_header(_last_line(error)) from error
        bits = re.search(r"(\d+)-bit", sitk.GetPixelIDValueAsString(reader.GetPixelID()))
        parts = 2 if reader.GetPixelID() in _COMPLEX else reader.GetNumberOfComponents()
        if reader.GetDimension() != 3 or bits is None or (parts != 1 and not layers):
            size = " x ".join(map(str, reader.GetSize()))
            raise not_one_volume(f"{size} voxels of {parts} number{'s' * (parts > 1)}")
        columns, rows, slices = reader.GetSize()
        origin, spacing, direction = map(
            np.array, (reader.GetOrigin(), reader.GetSpacing(), reader.GetDirection())
        )
        grid = VoxelGrid((columns, rows, slices), origin, spacing, direction.reshape(3, 3))
        check_grid(grid)
        shape = (*grid.size[::-1], parts) if layers else grid.size[::-1]
        content, memory = (math.prod(shape) * size for size in (int(bits[1]) // 8, 4))
        check_expansion(content, memory, stored)
        texts = {key: reader.GetMetaData(key) for key in reader.GetMetaDataKeys()}
        if reader.GetImageIO() == "NiftiImageIO":
            _check_nifti(file, grid)
        elif reader.GetImageIO() == "NrrdImageIO":  # MetaImage is LPS by its definition
            _check_nrrd_space(texts.get("NRRD_space", ""))
        allow_memory(2 * (content + memory) + stored)  # a buffer, one to convert into
        try:
            image = reader.Execute()
        except RuntimeError as error:
            raise _missing_voxels(f" ({_last_line(error)})") from error
        # SimpleITK's arrays are indexed k, j, i: the reverse of its sizes
        values = sitk.GetArrayViewFromImage(image).reshape(shape).astype(np.float32)
        if not np.isfinite([values.min(), values.max()]).all():
            raise refusal(f"""holds {np.count_nonzero(~np.isfinite(values))} voxels that are no finite number
                expected: a number in every voxel
                fix: give voxels outside the scan the value of air, e.g. -1000""")
    arrays["values"] = values
    grid = replace(grid, direction=orthogonalize(grid.direction))
    segments = {key: text for key, text in texts.items() if re.fullmatch(r"Segment\d{1,4}_\w+", key)}
    return {**grid_to_json(grid), "texts": segments}


def write_image(volume: Volume, path: Path, description: str) -> None:
    """Write a volume as NRRD, NIfTI or MetaImage, compressed unless it is .nii; as int16 if that is exact."""
    with np.errstate(invalid="ignore"):  # what does not fit is seen by the comparison
        whole = volume.values.astype(np.int16)
    key = "ITK_FileNotes" if ".nii" in path.name.lower() else "description"
    values = whole if np.array_equal(whole, volume.values) else volume.values
    write_labels(values, volume.grid, {key: description} if description else {}, path)


def write_labels(values: NDArray[Any], grid: VoxelGrid, entries: Mapping[str, str], path: Path) -> None:
    """Write voxels (K, J, I), such as labels, as a compressed file, with entries in its header."""
    image = sitk.GetImageFromArray(values)
    image.SetOrigin(grid.origin.tolist())
    image.SetSpacing(grid.spacing.tolist())
    image.SetDirection(grid.direction.ravel().tolist())
    for key, text in entries.items():
        image.SetMetaData(key, text)
    with replace_file(path) as fresh:
        sitk.WriteImage(image, str(fresh), useCompression=True, compressionLevel=_COMPRESSION_LEVEL)


def _check_nrrd_space(space: str) -> None:
    """See that the file says where the patient's left is: SimpleITK makes it up."""
    if space != "left-posterior-superior":
        stated = f"its space is {space}, which does not describe the patient"
        raise refusal(f"""{stated if space else "does not say its space"}
            expected: `space: left-posterior-superior` or another anatomical one in the header
            fix: export it from a program that knows the patient's axes, such as 3D Slicer""")


def _check_nifti(path: Path, grid: VoxelGrid) -> None:
    """See that a NIfTI file says where the patient's left is, once, and holds all voxels.

    SimpleITK makes up what is not stated, and takes voxels that are missing for zeros.
    """
    import nibabel  # slow to load, and the other formats need none
    from nibabel.arrayproxy import ArrayProxy
    from nibabel.filebasedimages import ImageFileError
    from nibabel.spatialimages import HeaderDataError

    try:
        image = nibabel.load(path)
        assert isinstance(image, nibabel.Nifti1Image)  # NIfTI-2 is one, too
        assert isinstance(image.dataobj, ArrayProxy)
        header = image.header
        forms = [header.get_qform(coded=True), header.get_sform(coded=True)]
        unit = _MILLIMETRES.get(header.get_xyzt_units()[0], 1.0)
    except (ImageFileError, HeaderDataError, ValueError, AssertionError) as error:
        raise _unreadable_header(str(error)[:200]) from error
    stated = [matrix[:3] * unit for matrix, code in forms if code]
    if not stated:
        raise refusal("""does not say where it stands in the patient: qform_code and sform_code are 0
            expected: a NIfTI header with a qform or an sform
            fix: convert the scan from its DICOM series again""")
    steps = np.linalg.norm(stated[-1][:, :3], axis=0)
    if not np.allclose(steps, grid.spacing, rtol=AXES_COSINE_TOLERANCE, atol=0.0):
        raise refusal(f"""has two spacings: {grid.spacing.tolist()} mm by pixdim, {steps.round(6).tolist()} mm
                by its sform
            expected: the same spacing in both
            fix: convert the scan from its DICOM series again""")
    corners = np.array(list(product(*[(0, n - 1) for n in grid.size], (1,))))
    apart = float(np.linalg.norm((stated[0] - stated[-1]) @ corners.T, axis=0).max())
    if apart > grid.spacing.max():
        one, other = (matrix[:, :3] / np.linalg.norm(matrix[:, :3], axis=0) for matrix in stated)
        angle = np.degrees(np.arccos(np.clip((np.trace(one.T @ other) - 1) / 2, -1, 1)))
        raise refusal(f"""its sform and its qform place the voxels up to {apart:.1f} mm apart, turned by
                {angle:.1f} degrees
            expected: one place of the scan in the patient
            fix: convert the scan from its DICOM series again, or set the code of the wrong one to 0""")
    needed = image.dataobj.offset + image.dataobj.dtype.itemsize * math.prod(grid.size)
    try:
        found = _unpacked_size(path, needed) if path.suffix.lower() == ".gz" else path.stat().st_size
    except (EOFError, OSError, zlib.error) as error:
        raise _missing_voxels() from error
    if found < needed:
        raise _missing_voxels()


def _unpacked_size(path: Path, enough: int) -> int:
    """Return how many bytes a gzip file unpacks to; counting stops beyond `enough`."""
    total = 0
    with gzip.open(path) as file:  # its end is read, too: there stands the checksum
        while total <= enough and (block := file.read(_BLOCK_BYTES)):
            total += len(block)
    return total


def _last_line(error: Exception) -> str:
    """Return the last line of an error of SimpleITK, which names the cause, without addresses of memory."""
    return re.sub(r"\w+\(0x[0-9a-f]+\): ", "", str(error).strip().splitlines()[-1])[:200]


def _unreadable_header(reason: str) -> DataError:
    return refusal(f"""cannot be read as a volume: {reason}
        expected: {READABLE_VOLUMES}
        fix: check that the file is whole and its name ends as its format wants; export it again""")


def _missing_voxels(reason: str = "") -> DataError:
    return refusal(f"""its header is sound, but its voxels are damaged or not all there{reason}
        expected: all voxels that the header promises, in this file or the one that it names
        fix: the file is cut short or damaged: copy it or export it again""")
