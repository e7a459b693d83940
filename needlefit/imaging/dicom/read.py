"""The voxels of a DICOM series, once its headers passed."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import SimpleITK as sitk
from numpy.typing import NDArray

from needlefit.errors import DataError
from needlefit.imaging.dicom.header import Slice
from needlefit.imaging.dicom.series import find_series
from needlefit.imaging.dicom.stack import stack, tilt_remarks
from needlefit.imaging.grid import described
from needlefit.project.caged import Results, allow_memory

SLICE_BYTES_PER_PIXEL = 32
"""A slice stands in memory packed, unpacked, and in double precision."""

sitk.ProcessObject.SetGlobalWarningDisplay(False)  # what is wrong is said once, in our own words


def read_series(results: Results, path: str, series: str | None) -> dict[str, Any]:
    """Read the one series that `path` means: the array "values", its grid, and remarks.

    Values are rescaled slice by slice; voxels that were not measured (padding) get the least value that
    was, so that no threshold and no edge finds them.

    Raises
    ------
    DataError
        If the series is not one sound stack, or a voxel cannot be read.
    """
    slices, grid = stack(find_series(Path(path), series))
    _allow(slices)
    columns, rows, count = grid.size
    values = results.new("values", (count, rows, columns), "float32")
    reader = sitk.ImageFileReader()
    reader.SetImageIO("GDCMImageIO")
    for item, plane in zip(slices, values, strict=True):
        plane[...] = _voxels(reader, item)
    _fill_padding(values, slices)
    return {**described(grid), "remarks": tilt_remarks(slices)}


def _allow(slices: Sequence[Slice]) -> None:
    """Grant the memory of one slice, unpacked, to the readers that turn it over."""
    allow_memory(max(item.rows * item.columns for item in slices) * SLICE_BYTES_PER_PIXEL)


def _voxels(reader: sitk.ImageFileReader, item: Slice) -> NDArray[np.float64]:
    """Return the rescaled values (rows, columns) of a slice; padding is NaN."""
    reader.SetFileName(str(item.file))
    try:
        image = reader.Execute()
    except RuntimeError as error:
        packed = f"; it is compressed as {item.syntax.name}" if item.syntax.is_compressed else ""
        raise DataError(
            f"its voxels cannot be read{packed}",
            where=str(item.file),
            expected="a whole DICOM file",
            mend="it is cut short or damaged: copy it again, or export the series again"
            + (", uncompressed" if packed else ""),
        ) from error
    voxels = np.array(sitk.GetArrayViewFromImage(image), dtype=np.float64).reshape(item.rows, item.columns)
    if item.padding is not None:
        assert item.rescale is not None  # the stack was checked
        slope, intercept = item.rescale
        kept = (voxels - intercept) / slope
        voxels[(kept > item.padding[0] - 0.5) & (kept < item.padding[1] + 0.5)] = np.nan
    return voxels


def _fill_padding(values: NDArray[np.float32], slices: Sequence[Slice]) -> None:
    """Give padding the least measured value of the volume."""
    if all(item.padding is None for item in slices):
        return
    least = np.fmin.reduce(values, axis=None)
    if np.isnan(least):
        raise DataError(
            "holds nothing but padding",
            where=str(slices[0].file.parent),
            expected="measured values; padding is what PixelPaddingValue says",
            mend="check PixelPaddingValue, or export the series again",
        )
    for plane in values:
        plane[np.isnan(plane)] = least
