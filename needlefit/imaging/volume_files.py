"""Read and write CT volumes: DICOM series, NRRD, NIfTI and MetaImage files."""

import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needlefit.errors import ConfigError, DataError
from needlefit.imaging.volume import (
    IMAGE_SUFFIXES,
    READABLE_VOLUMES,
    Volume,
    max_voxels,
)
from needlefit.project.input_files import open_regular, path_exists, unreadable_error
from needlefit.project.sandbox import limits_for, read_in_sandbox

Floats = NDArray[np.float64]

CT_PACKAGES = ("SimpleITK", "pydicom")
READ_BYTES_PER_SECOND = 8 * 2**20
"""A volume that is read more slowly, in processor time, is taken for one that never ends."""

SECONDS_PER_DICOM_HEADER = 0.1
UNPACKED_BYTES_PER_SECOND = 2**20
"""The same for a DICOM header, and for compressed slices."""


def read_volume(path: Path, series: str | None = None) -> Volume:
    """Read the volume in a file or folder; its geometry is checked first.

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
    if not path_exists(path):
        raise DataError(
            "there is no such file or folder",
            where=str(path),
            expected=READABLE_VOLUMES,
            fix="check the path",
        )
    if any("\ud800" <= letter <= "\udfff" for letter in str(path)):  # SimpleITK takes names in UTF-8 only
        raise DataError(
            "its name is not valid UTF-8", where=str(path), expected="a name in UTF-8", fix="rename it"
        )
    with explain_missing_packages():
        _require_packages()
        if not path.is_dir() and path.name.lower().endswith(IMAGE_SUFFIXES):
            return _read_image(path)
        return _read_series(path, series)


def read_planes(path: Path) -> tuple[Volume, ...]:
    """Read an image file with several numbers per voxel: one volume for each; see `read_volume`."""
    with explain_missing_packages():
        _require_packages()
        parts, arrays = _read_arrays(path, layers=True)
    values = arrays["values"]
    return tuple(_build_volume(parts, {"values": values[..., n]}, path) for n in range(values.shape[-1]))


def _read_image(path: Path) -> Volume:
    return _build_volume(*_read_arrays(path, layers=False), path)


def _read_arrays(path: Path, layers: bool) -> tuple[Any, dict[str, NDArray[Any]]]:
    """Return the grid of an image file, and its voxels as "values"."""
    from needlefit.imaging.image_headers import check_image_header, single_volume_header

    header = check_image_header(path)
    native = (
        2 * header.content_bytes + header.float_bytes + header.packed_bytes
    )  # a buffer, one to convert into
    seconds = (header.content_bytes + header.packed_bytes) / READ_BYTES_PER_SECOND
    allowed = limits_for(native, header.float_bytes, seconds)
    one_volume = len(header.size) > 3 and path.name.lower().endswith((".nrrd", ".nhdr"))
    instead = single_volume_header(path) if one_volume else ""
    arguments = {"path": str(path), "layers": layers, "header": instead}
    return read_in_sandbox("needlefit.imaging.image_files:read_image", path, allowed, arguments)


def _read_series(path: Path, series: str | None) -> Volume:
    folder = path
    if not path.is_dir():
        folder = path.parent
        with open_regular(path, sys.maxsize):  # a regular file
            pass
    try:
        sizes = [entry.stat().st_size for entry in os.scandir(folder) if entry.is_file()]
    except OSError as fault:
        raise unreadable_error(fault, DataError, str(folder)) from None
    seconds = len(sizes) * SECONDS_PER_DICOM_HEADER + sum(sizes) / UNPACKED_BYTES_PER_SECOND
    allowed = limits_for(max(sizes, default=0), 4 * max_voxels(), seconds)
    arguments = {"path": str(path), "series": series}
    return _build_volume(
        *read_in_sandbox("needlefit.imaging.dicom.series:read_series", path, allowed, arguments), path
    )


def _build_volume(parts: Any, arrays: Mapping[str, NDArray[Any]], path: Path) -> Volume:  # noqa: ANN401 - JSON
    """Return the volume that a reader described and filled; DataError if the two do not agree."""
    try:
        origin, spacing, direction = (
            np.array(parts[name], np.float64) for name in ("origin", "spacing", "direction")
        )
        values, warnings = arrays["values"], tuple(map(str, parts.get("warnings", ())))
        if values.shape != tuple(parts["size"])[::-1] or direction.shape != (3, 3):
            raise ValueError
    except (AttributeError, KeyError, TypeError, ValueError):
        raise DataError(
            "the process that read it gave no volume",
            where=str(path),
            expected=READABLE_VOLUMES,
            fix="read it again",
        ) from None
    return Volume(values, origin, spacing, direction, warnings)


def _require_packages() -> None:
    """See that what reads scans is there, before a process is started for it."""
    for name in CT_PACKAGES:
        if find_spec(name) is None:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def write_volume(volume: Volume, path: Path, description: str = "") -> None:
    """Write a volume, whole or not at all; the same volume gives the same bytes.

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
    with explain_missing_packages():
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
            from needlefit.imaging.dicom.series import write_series

            write_series(volume, path, description)


def ct_packages_installed() -> bool:
    """Return whether the packages that read scans are installed."""
    return all(find_spec(name) is not None for name in CT_PACKAGES)


@contextmanager
def explain_missing_packages() -> Iterator[None]:
    """Replace the error of a missing package by one that says how to install it."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"scans need the package {error.name}, which is not installed",
            expected="the packages of the extra `ct`",
            fix="pip install 'needlefit[ct]'",
        ) from None
