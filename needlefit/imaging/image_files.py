"""Read and write NRRD, NIfTI and MetaImage files by SimpleITK, which converts their coordinates to LPS."""

import gzip
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import SimpleITK as sitk
from numpy.typing import NDArray

from needlefit.arrays import Floats
from needlefit.errors import DataError
from needlefit.imaging.image_headers import truncated_voxels_error, unreadable_image_error
from needlefit.imaging.volume import (
    AXES_COSINE_TOLERANCE,
    EXPECTED_AXES,
    SHEARED_AXES_FAULT,
    SHEARED_AXES_FIX,
    Volume,
    VoxelGrid,
    check_grid,
    grid_to_json,
    orthogonalize,
)
from needlefit.project.atomic_write import replace_file
from needlefit.project.sandbox import SandboxArrays

IMAGE_IOS = {".nrrd": "NrrdImageIO", ".nhdr": "NrrdImageIO", ".mha": "MetaImageIO", ".mhd": "MetaImageIO"}
_COMPLEX = (sitk.sitkComplexFloat32, sitk.sitkComplexFloat64)
# One unit of a NIfTI header by its code (metre, millimetre, micrometre) in mm.
_MILLIMETRES = {1: 1e3, 2: 1.0, 3: 1e-3}
_BLOCK_BYTES = 2**20
# zlib's fastest level: on noise, higher ones cost ten times the time for a few per cent.
_COMPRESSION_LEVEL = 1

sitk.ProcessObject.SetGlobalWarningDisplay(False)  # what is wrong is said once, in our own words


def read_image(results: SandboxArrays, path: str, layers: bool = False, header: str = "") -> dict[str, Any]:
    """Read an image file whose header was checked: the array "values", and its grid.

    `layers`: whether a voxel may have several numbers; the values then have a fourth axis for them.
    `header`: a detached NRRD header that is read in place of the file's own.

    DataError if the file is none, is cut short, has not three dimensions, does not say in which coordinate
    system it stands, or claims an absurd size.
    """
    file = Path(path)
    with _open_readable(file, header) as named:
        reader = sitk.ImageFileReader()
        reader.SetImageIO(IMAGE_IOS.get(file.suffix.lower(), "NiftiImageIO"))
        reader.SetFileName(str(named))
        grid, parts = _read_grid(reader, file, layers)
        check_grid(grid, path)
        if reader.GetImageIO() == "NiftiImageIO":
            _check_length(reader, file, grid)  # its reader takes what is missing for zeros
        shape = (*grid.size[::-1], parts) if layers else grid.size[::-1]
        values = results.new("values", shape, "float32")
        try:
            image = reader.Execute()
        except RuntimeError as error:
            raise truncated_voxels_error(file) from error
    # SimpleITK's arrays are indexed k, j, i: the reverse of its sizes
    values[...] = sitk.GetArrayViewFromImage(image).reshape(shape)
    _check_finite(values, file)
    return grid_to_json(replace(grid, direction=orthogonalize(grid.direction)))


@contextmanager
def _open_readable(file: Path, header: str) -> Iterator[Path]:
    """Yield what SimpleITK is to read: the file, or another header of it."""
    if not header:
        yield file
        return
    with TemporaryDirectory() as folder:
        named = Path(folder) / "volume.nhdr"
        named.write_text(header, encoding="utf-8")
        yield named


def write_image(volume: Volume, path: Path, description: str) -> None:
    """Write a volume as NRRD, NIfTI or MetaImage, compressed unless it is .nii."""
    key = "ITK_FileNotes" if ".nii" in path.name.lower() else "description"
    _write(to_int16_if_exact(volume.values), volume.grid, {key: description} if description else {}, path)


def write_labels(values: NDArray[np.uint8], grid: VoxelGrid, entries: Mapping[str, str], path: Path) -> None:
    """Write labels (K, J, I) as a compressed NRRD file, with entries in its header."""
    _write(values, grid, entries, path)


def _write(values: NDArray[Any], grid: VoxelGrid, entries: Mapping[str, str], path: Path) -> None:
    image = sitk.GetImageFromArray(values)
    image.SetOrigin(grid.origin.tolist())
    image.SetSpacing(grid.spacing.tolist())
    image.SetDirection(grid.direction.ravel().tolist())
    for key, text in entries.items():
        image.SetMetaData(key, text)
    with replace_file(path) as fresh:
        sitk.WriteImage(image, str(fresh), useCompression=True, compressionLevel=_COMPRESSION_LEVEL)


def to_int16_if_exact(values: NDArray[np.float32]) -> NDArray[np.float32] | NDArray[np.int16]:
    """Return `values` as int16 if that is exact, which halves the file."""
    with np.errstate(invalid="ignore"):  # what does not fit is seen by the comparison
        whole = values.astype(np.int16)
    return whole if np.array_equal(whole, values) else values


def _read_grid(reader: sitk.ImageFileReader, path: Path, layers: bool) -> tuple[VoxelGrid, int]:
    """Return what the header says of the voxels, and how many numbers each has, one unless `layers`.

    No voxel is read, nothing of their size allocated.
    """
    try:
        reader.ReadImageInformation()
    except RuntimeError as error:
        raise _unreadable_header_error(path, str(error)) from error
    parts = 2 if reader.GetPixelID() in _COMPLEX else reader.GetNumberOfComponents()
    if reader.GetDimension() != 3 or (parts != 1 and not layers):
        size = " x ".join(map(str, reader.GetSize()))
        raise _not_one_volume_error(path, f"{size} voxels of {parts} number{'s' * (parts > 1)}")
    _check_space(reader, path)
    columns, rows, slices = reader.GetSize()
    grid = VoxelGrid(
        (columns, rows, slices),
        np.array(reader.GetOrigin()),
        np.array(reader.GetSpacing()),
        np.array(reader.GetDirection()).reshape(3, 3),
    )
    return grid, parts


def _check_space(reader: sitk.ImageFileReader, path: Path) -> None:
    """See that the file itself says where the patient's left is (MetaImage: LPS by its definition)."""
    metadata = {key: reader.GetMetaData(key) for key in reader.GetMetaDataKeys()}
    if reader.GetImageIO() == "NiftiImageIO":
        _check_nifti(metadata, np.array(reader.GetSpacing()), path)
    elif reader.GetImageIO() == "NrrdImageIO" and metadata.get("NRRD_space") != "left-posterior-superior":
        space = metadata.get("NRRD_space")
        raise DataError(
            f"its space is {space}, which does not describe the patient"
            if space
            else "does not say its space",
            where=str(path),
            expected="`space: left-posterior-superior` or another anatomical one in the header",
            fix="export it from a program that knows the patient's axes, such as 3D Slicer",
        )


def _check_nifti(metadata: dict[str, str], spacing: Floats, path: Path) -> None:
    """See that the header has an orientation and one spacing; SimpleITK would make one up, mix the other."""
    if metadata["qform_code"] == metadata["sform_code"] == "0":
        raise DataError(
            "does not say where it stands in the patient: qform_code and sform_code are 0",
            where=str(path),
            expected="a NIfTI header with a qform or an sform",
            fix="convert the scan from its DICOM series again",
        )
    rows = np.array([metadata[f"srow_{axis}"].split()[:3] for axis in "xyz"], dtype=np.float64)
    steps = np.linalg.norm(rows, axis=0) * _MILLIMETRES.get(int(metadata["xyzt_units"]) % 8, 1.0)
    if metadata["sform_code"] != "0" and not np.allclose(
        steps, spacing, rtol=AXES_COSINE_TOLERANCE, atol=0.0
    ):
        raise DataError(
            f"has two spacings: {spacing.tolist()} mm by pixdim, {steps.round(6).tolist()} mm by its sform",
            where=str(path),
            expected="the same spacing in both",
            fix="convert the scan from its DICOM series again",
        )


def _check_length(reader: sitk.ImageFileReader, path: Path, grid: VoxelGrid) -> None:
    """Count the bytes of a NIfTI file, unpacked, against what its header promises."""
    start, bits = (int(float(reader.GetMetaData(key))) for key in ("vox_offset", "bitpix"))
    needed = start + bits // 8 * int(np.prod(grid.size, dtype=np.int64))
    try:
        found = _unpacked_size(path, needed) if path.suffix.lower() == ".gz" else path.stat().st_size
    except (EOFError, OSError, zlib.error) as error:
        raise truncated_voxels_error(path) from error
    if found < needed:
        raise truncated_voxels_error(path)


def _unpacked_size(path: Path, enough: int) -> int:
    """Return how many bytes a gzip file unpacks to; counting stops beyond `enough`."""
    total = 0
    with gzip.open(path) as file:
        while total <= enough and (
            block := file.read(_BLOCK_BYTES)
        ):  # its end, too: there stands the checksum
            total += len(block)
    return total


def _check_finite(values: NDArray[np.float32], path: Path) -> None:
    if not np.isfinite([values.min(), values.max()]).all():
        raise DataError(
            f"holds {np.count_nonzero(~np.isfinite(values))} voxels that are no finite number",
            where=str(path),
            expected="a number in every voxel",
            fix="give voxels outside the scan the value of air, e.g. -1000",
        )


def _unreadable_header_error(path: Path, reason: str) -> DataError:
    """Return the error for a header that SimpleITK cannot read."""
    if "orthonormal" in reason:
        return DataError(SHEARED_AXES_FAULT, where=str(path), expected=EXPECTED_AXES, fix=SHEARED_AXES_FIX)
    if "number of domain axes" in reason:
        return _not_one_volume_error(path, "more than three dimensions")
    return unreadable_image_error(path, "SimpleITK does not take its header")


def _not_one_volume_error(path: Path, what: str) -> DataError:
    return DataError(
        f"is no single volume: {what}",
        where=str(path),
        expected="three dimensions, one number a voxel",
        fix="export one time point, or one segment, as a volume of its own",
    )
