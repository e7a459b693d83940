"""The voxels of a DICOM series, once its headers passed."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import SimpleITK as sitk
from numpy.typing import NDArray

from needlefit.errors import DataError
from needlefit.imaging.dicom.header import Slice
from needlefit.imaging.dicom.series import find_series
from needlefit.imaging.dicom.stack import stack, tilt_remarks
from needlefit.imaging.volume import Volume

sitk.ProcessObject.SetGlobalWarningDisplay(False)  # what is wrong is said once, in our own words


def read_series(path: Path, series: str | None = None) -> Volume:
    """Return the volume of the one series that `path` means.

    Values are rescaled slice by slice; voxels that were not measured (padding) get the least value that
    was, so that no threshold and no edge finds them.

    Raises
    ------
    DataError
        If the series is not one sound stack, or a voxel cannot be read.
    """
    slices, grid = stack(find_series(path, series))
    columns, rows, count = grid.size
    values = np.empty((count, rows, columns), dtype=np.float32)
    reader = sitk.ImageFileReader()
    reader.SetImageIO("GDCMImageIO")
    for item, plane in zip(slices, values, strict=True):
        plane[...] = _voxels(reader, item)
    _fill_padding(values, slices)
    return Volume(values, grid.origin, grid.spacing, grid.direction, tilt_remarks(slices))


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
