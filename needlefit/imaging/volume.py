"""A CT volume in the patient's coordinates: the noun, its coordinates, and the files it comes from."""

import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from needlefit.errors import ConfigError, DataError
from needlefit.imaging.grid import Grid, check_grid, max_voxels
from needlefit.project.caged import limits, read_caged
from needlefit.project.reading import is_there, opened, unreadable

Floats = NDArray[np.float64]

IMAGE_SUFFIXES = (".nrrd", ".nhdr", ".nii", ".nii.gz", ".mha", ".mhd")
PACKAGES = ("SimpleITK", "pydicom")
READ_BYTES_PER_SECOND = 8 * 2**20
"""A volume that is read more slowly, in processor time, is taken for one that never ends."""

HEADER_SECONDS = 0.1
UNPACKED_BYTES_PER_SECOND = 2**20
"""The same for a DICOM header, and for compressed slices."""

READABLE = (
    "a folder with a DICOM series, one file of it, NRRD (.nrrd), NIfTI (.nii, .nii.gz) or MetaImage (.mha)"
)


@dataclass(frozen=True)
class Volume:
    """A scan; patient coordinates are LPS, mm, whatever its file had.

    Attributes
    ----------
    values : (K, J, I) array of float32
        Attenuation [slice, row, column], rescaled as the file says (HU where the scanner gave HU).
    origin : (3,) array
        Centre of voxel (0, 0, 0), mm.
    spacing : (3,) array
        Distance of centres along i, j, k, mm.
    direction : (3, 3) array
        Its columns are the LPS unit vectors of i, j, k; either handedness.
    remarks : tuple of str
        What a person should know of its files.

    Raises
    ------
    DataError
        If the values are no volume, or the axes are not perpendicular unit vectors.
    """

    values: NDArray[np.float32]
    origin: Floats
    spacing: Floats
    direction: Floats
    remarks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuse what no file could hold."""
        if self.values.ndim != 3:
            raise DataError(
                f"the values of a volume have {self.values.ndim} axes", expected="slices, rows, columns"
            )
        check_grid(self.grid)

    @property
    def grid(self) -> Grid:
        """Where the voxels stand."""
        slices, rows, columns = self.values.shape
        return Grid((columns, rows, slices), self.origin, self.spacing, self.direction)


def to_patient(volume: Volume, ijk: ArrayLike) -> Floats:
    """Return the LPS points (N, 3), mm, of fractional voxel indices i, j, k (N, 3)."""
    steps = np.asarray(ijk, dtype=np.float64) * volume.spacing
    points: Floats = steps @ volume.direction.T + volume.origin
    return points


def to_index(volume: Volume, points: ArrayLike) -> Floats:
    """Return the fractional indices i, j, k (N, 3) of LPS points (N, 3), mm; whole at voxel centres."""
    steps = (np.asarray(points, dtype=np.float64) - volume.origin) @ volume.direction
    index: Floats = steps / volume.spacing
    return index


def read(path: Path, series: str | None = None) -> Volume:
    """Return the volume in a file or folder, after its geometry was checked.

    Parameters
    ----------
    path : Path
        A folder with a DICOM series, one file of the series, or an NRRD, NIfTI or MetaImage file.
    series : str, optional
        Number or UID of the DICOM series, where a folder holds several.

    Raises
    ------
    DataError
        If there is no such volume, or its geometry cannot be trusted; nothing is guessed.
    ConfigError
        If the packages that read scans are not installed.
    """
    path = Path(path)
    if not is_there(path):
        raise DataError(
            "there is no such file or folder", where=str(path), expected=READABLE, mend="check the path"
        )
    if any("\ud800" <= letter <= "\udfff" for letter in str(path)):  # SimpleITK takes names in UTF-8 only
        raise DataError(
            "its name is not valid UTF-8", where=str(path), expected="a name in UTF-8", mend="rename it"
        )
    with packages():
        _require_packages()
        if not path.is_dir() and path.name.lower().endswith(IMAGE_SUFFIXES):
            return _read_image(path)
        return _read_series(path, series)


def read_planes(path: Path) -> tuple[Volume, ...]:
    """Read an image file whose voxels may have several numbers: a volume for each; else as `read`."""
    with packages():
        _require_packages()
        parts, arrays = _read_arrays(path, layers=True)
    values = arrays["values"]
    return tuple(_volume(parts, {"values": values[..., n]}, path) for n in range(values.shape[-1]))


def _read_image(path: Path) -> Volume:
    return _volume(*_read_arrays(path, layers=False), path)


def _read_arrays(path: Path, layers: bool) -> tuple[Any, dict[str, NDArray[Any]]]:
    """Return the grid of an image file, and its voxels as "values"."""
    from needlefit.imaging.headers.check import check_image_header
    from needlefit.imaging.headers.nrrd_single import single_volume_header

    header = check_image_header(path)
    native = (
        2 * header.content_bytes + header.float_bytes + header.packed_bytes
    )  # a buffer, one to convert into
    seconds = (header.content_bytes + header.packed_bytes) / READ_BYTES_PER_SECOND
    allowed = limits(native, header.float_bytes, seconds)
    one_volume = len(header.size) > 3 and path.name.lower().endswith((".nrrd", ".nhdr"))
    instead = single_volume_header(path) if one_volume else ""
    arguments = {"path": str(path), "layers": layers, "header": instead}
    return read_caged("needlefit.imaging.image_files:read_image", path, allowed, arguments)


def _read_series(path: Path, series: str | None) -> Volume:
    folder = path
    if not path.is_dir():
        folder = path.parent
        with opened(path, sys.maxsize):  # a regular file
            pass
    try:
        sizes = [entry.stat().st_size for entry in os.scandir(folder) if entry.is_file()]
    except OSError as fault:
        raise unreadable(fault, DataError, str(folder)) from None
    seconds = len(sizes) * HEADER_SECONDS + sum(sizes) / UNPACKED_BYTES_PER_SECOND
    allowed = limits(max(sizes, default=0), 4 * max_voxels(), seconds)
    arguments = {"path": str(path), "series": series}
    return _volume(*read_caged("needlefit.imaging.dicom.read:read_series", path, allowed, arguments), path)


def _volume(parts: Any, arrays: Mapping[str, NDArray[Any]], path: Path) -> Volume:  # noqa: ANN401 - JSON
    """Return the volume that a reader described and filled; DataError if the two do not agree."""
    try:
        origin, spacing, direction = (
            np.array(parts[name], np.float64) for name in ("origin", "spacing", "direction")
        )
        values, remarks = arrays["values"], tuple(map(str, parts.get("remarks", ())))
        if values.shape != tuple(parts["size"])[::-1] or direction.shape != (3, 3):
            raise ValueError
    except (AttributeError, KeyError, TypeError, ValueError):
        raise DataError(
            "the process that read it gave no volume",
            where=str(path),
            expected=READABLE,
            mend="read it again",
        ) from None
    return Volume(values, origin, spacing, direction, remarks)


def _require_packages() -> None:
    """See that what reads scans is there, before a process is started for it."""
    for name in PACKAGES:
        if find_spec(name) is None:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def write(volume: Volume, path: Path, description: str = "") -> None:
    """Write a volume whole or not at all; the same volume gives the same bytes.

    Parameters
    ----------
    path : Path
        A .nrrd, .nii, .nii.gz or .mha file, which is replaced, or a new folder (no suffix): a DICOM series.
    description : str
        What the volume is, e.g. that it is synthetic; stands in the file's header.

    Notes
    -----
    NRRD, NIfTI and MetaImage keep values to the bit. DICOM holds 16 bits: whole numbers in their range
    are kept, others rounded to 1/65535 of the range of the values. NIfTI stores its geometry in single
    precision (1e-5 mm), the others in double.

    Raises
    ------
    DataError
        If the suffix is unknown, or a value is not finite.
    ConfigError
        If nothing can be written there, or the packages that write scans are not installed.
    """
    path = Path(path)
    if not np.isfinite(volume.values.min() + volume.values.max()):
        raise DataError("the volume holds values that are not finite", expected="numbers everywhere")
    with packages():
        if path.name.lower().endswith((".nrrd", ".nii", ".nii.gz", ".mha")):
            from needlefit.imaging.image_files import write_image

            write_image(volume, path, description)
        elif path.suffix:
            raise DataError(
                f"{path.suffix} is no kind of volume that is written",
                where=str(path),
                expected=".nrrd, .nii, .nii.gz, .mha, or a folder for a DICOM series",
            )
        else:
            from needlefit.imaging.dicom.write import write_series

            write_series(volume, path, description)


def installed() -> bool:
    """Return whether the packages that read scans are there."""
    return all(find_spec(name) is not None for name in PACKAGES)


@contextmanager
def packages() -> Iterator[None]:
    """Turn a missing package into the line that installs it."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"scans need the package {error.name}, which is not installed",
            expected="the packages of the extra `ct`",
            mend="pip install 'needlefit[ct]'",
        ) from None
