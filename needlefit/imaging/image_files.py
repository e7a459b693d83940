"""Read and write NRRD, NIfTI and MetaImage files by SimpleITK, which converts their coordinates to LPS."""

import gzip
import zlib
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import SimpleITK as sitk
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from needlefit.arrays import Floats, Ints
from needlefit.errors import DataError
from needlefit.imaging.image_headers import missing_voxels, unreadable_image
from needlefit.imaging.refusals import located, refusal
from needlefit.imaging.volume import (
    AXES_COSINE_TOLERANCE,
    Volume,
    VoxelGrid,
    check_grid,
    grid_to_json,
    orthogonalize,
    sheared_axes,
)
from needlefit.project.folders import replace_file
from needlefit.project.sandbox import SandboxArrays

IMAGE_IOS = {".nrrd": "NrrdImageIO", ".nhdr": "NrrdImageIO", ".mha": "MetaImageIO", ".mhd": "MetaImageIO"}
_COMPLEX = (sitk.sitkComplexFloat32, sitk.sitkComplexFloat64)
# One unit of a NIfTI header by its code (metre, millimetre, micrometre) in mm.
_MILLIMETRES = {1: 1e3, 2: 1.0, 3: 1e-3}
_BLOCK_BYTES = 2**20
# zlib's fastest level: on noise, higher ones cost ten times the time for a few per cent.
_COMPRESSION_LEVEL = 1

sitk.ProcessObject.SetGlobalWarningDisplay(False)  # errors are reported once, by our own messages


def read_image(results: SandboxArrays, path: str, layers: bool = False, header: str = "") -> dict[str, Any]:
    """Read an image file whose header was checked: the array "values", and its grid.

    `layers`: whether a voxel may have several numbers; the values then have a fourth axis for them.
    `header`: a detached NRRD header that is read in place of the file's own.

    DataError if the file is none, is cut short, has not three dimensions, does not say in which coordinate
    system it stands, or claims an absurd size.
    """
    file = Path(path)
    with ExitStack() as stack:
        stack.enter_context(located(path))
        named = file
        if header:
            named = Path(stack.enter_context(TemporaryDirectory())) / "volume.nhdr"
            named.write_text(header, encoding="utf-8")
        reader = sitk.ImageFileReader()
        reader.SetImageIO(IMAGE_IOS.get(file.suffix.lower(), "NiftiImageIO"))
        reader.SetFileName(str(named))
        grid, parts = _read_grid(reader, layers)
        check_grid(grid)
        if reader.GetImageIO() == "NiftiImageIO":
            _check_length(reader, file, grid)  # its reader takes what is missing for zeros
        shape = (*grid.size[::-1], parts) if layers else grid.size[::-1]
        values = results.new("values", shape, "float32")
        try:
            image = reader.Execute()
        except RuntimeError as error:
            raise missing_voxels() from error
        # SimpleITK's arrays are indexed k, j, i: the reverse of its sizes
        values[...] = sitk.GetArrayViewFromImage(image).reshape(shape)
        if not np.isfinite([values.min(), values.max()]).all():
            raise refusal(f"""holds {np.count_nonzero(~np.isfinite(values))} voxels that are no finite number
                expected: a number in every voxel
                fix: give voxels outside the scan the value of air, e.g. -1000""")
    return grid_to_json(replace(grid, direction=orthogonalize(grid.direction)))


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


def _read_grid(reader: sitk.ImageFileReader, layers: bool) -> tuple[VoxelGrid, int]:
    """Return what the header says of the voxels, and how many numbers each has, one unless `layers`.

    No voxel is read, nothing of their size allocated.
    """
    try:
        reader.ReadImageInformation()
    except RuntimeError as error:
        raise _unreadable_header(str(error)) from error
    parts = 2 if reader.GetPixelID() in _COMPLEX else reader.GetNumberOfComponents()
    if reader.GetDimension() != 3 or (parts != 1 and not layers):
        size = " x ".join(map(str, reader.GetSize()))
        raise _not_one_volume(f"{size} voxels of {parts} number{'s' * (parts > 1)}")
    _check_space(reader)
    columns, rows, slices = reader.GetSize()
    origin, spacing, direction = map(
        np.array, (reader.GetOrigin(), reader.GetSpacing(), reader.GetDirection())
    )
    return VoxelGrid((columns, rows, slices), origin, spacing, direction.reshape(3, 3)), parts


def _check_space(reader: sitk.ImageFileReader) -> None:
    """See that the file itself says where the patient's left is, and one spacing: SimpleITK makes one up.

    MetaImage is LPS by its definition.
    """
    metadata = {key: reader.GetMetaData(key) for key in reader.GetMetaDataKeys()}
    space = metadata.get("NRRD_space")
    if reader.GetImageIO() == "NrrdImageIO" and space != "left-posterior-superior":
        stated = f"its space is {space}, which does not describe the patient"
        raise refusal(f"""{stated if space else "does not say its space"}
            expected: `space: left-posterior-superior` or another anatomical one in the header
            fix: export it from a program that knows the patient's axes, such as 3D Slicer""")
    if reader.GetImageIO() != "NiftiImageIO":
        return
    if metadata["qform_code"] == metadata["sform_code"] == "0":
        raise refusal("""does not say where it stands in the patient: qform_code and sform_code are 0
            expected: a NIfTI header with a qform or an sform
            fix: convert the scan from its DICOM series again""")
    spacing = np.array(reader.GetSpacing())
    rows = np.array([metadata[f"srow_{axis}"].split()[:3] for axis in "xyz"], dtype=np.float64)
    steps = np.linalg.norm(rows, axis=0) * _MILLIMETRES.get(int(metadata["xyzt_units"]) % 8, 1.0)
    alike = np.allclose(steps, spacing, rtol=AXES_COSINE_TOLERANCE, atol=0.0)
    if metadata["sform_code"] != "0" and not alike:
        raise refusal(f"""has two spacings: {spacing.tolist()} mm by pixdim, {steps.round(6).tolist()} mm by
                its sform
            expected: the same spacing in both
            fix: convert the scan from its DICOM series again""")
    if "0" not in (metadata["qform_code"], metadata["sform_code"]):
        _check_forms(metadata, spacing, np.array(reader.GetSize()))


def _check_forms(metadata: Mapping[str, str], spacing: Floats, size: Ints) -> None:
    """See that sform and qform of a NIfTI header place the same voxels alike, within one of them."""
    unit = _MILLIMETRES.get(int(metadata["xyzt_units"]) % 8, 1.0)
    sform = np.array([metadata[f"srow_{axis}"].split() for axis in "xyz"], dtype=np.float64) * unit
    turn = np.array([float(metadata[f"quatern_{name}"]) for name in "bcd"])
    turned = Rotation.from_quat([*turn, np.sqrt(max(0.0, 1 - turn @ turn))]).as_matrix()
    hand = float(np.sign(np.linalg.det(sform[:, :3])))  # SimpleITK does not tell that of the qform
    qform = np.column_stack([turned * spacing * [1, 1, hand], [0.0, 0, 0]])
    qform[:, 3] = [unit * float(metadata[f"qoffset_{axis}"]) for axis in "xyz"]
    corners = np.array(list(product(*[(0, n - 1) for n in size.tolist()], (1,))))
    apart = float(np.linalg.norm((sform - qform) @ corners.T, axis=0).max())
    if apart > spacing.max():
        between = (sform[:, :3] / spacing).T @ (qform[:, :3] / spacing)
        angle = np.degrees(np.arccos(np.clip((np.trace(between) - 1) / 2, -1, 1)))
        raise refusal(f"""its sform and its qform place the voxels up to {apart:.1f} mm apart, turned by
                {angle:.1f} degrees
            expected: one place of the scan in the patient
            fix: convert the scan from its DICOM series again, or set the code of the wrong one to 0""")


def _check_length(reader: sitk.ImageFileReader, path: Path, grid: VoxelGrid) -> None:
    """Count the bytes of a NIfTI file, unpacked, against what its header promises."""
    start, bits = (int(float(reader.GetMetaData(key))) for key in ("vox_offset", "bitpix"))
    needed = start + bits // 8 * int(np.prod(grid.size, dtype=np.int64))
    try:
        found = _unpacked_size(path, needed) if path.suffix.lower() == ".gz" else path.stat().st_size
    except (EOFError, OSError, zlib.error) as error:
        raise missing_voxels() from error
    if found < needed:
        raise missing_voxels()


def _unpacked_size(path: Path, enough: int) -> int:
    """Return how many bytes a gzip file unpacks to; counting stops beyond `enough`."""
    total = 0
    with gzip.open(path) as file:  # its end is read, too: there stands the checksum
        while total <= enough and (block := file.read(_BLOCK_BYTES)):
            total += len(block)
    return total


def _unreadable_header(reason: str) -> DataError:
    """Return the error for a header that SimpleITK cannot read."""
    if "orthonormal" in reason:
        return sheared_axes()
    if "number of domain axes" in reason:
        return _not_one_volume("more than three dimensions")
    return unreadable_image("SimpleITK does not take its header")


def _not_one_volume(what: str) -> DataError:
    return refusal(f"""is no single volume: {what}
        expected: three dimensions, one number a voxel
        fix: export one time point, or one segment, as a volume of its own""")
