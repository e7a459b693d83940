"""Read a segmentation of the needle made elsewhere, resampled to the voxels of the scan."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from needlefit.arrays import Ints
from needlefit.errors import DataError
from needlefit.imaging.needle.segmentation import MIN_COMPONENT_VOXELS, Component, measure_component
from needlefit.imaging.volume import Volume, require_same_frame, to_index, to_patient
from needlefit.imaging.volume_files import read_mask
from needlefit.schemas.reconstruction import ReconstructionRecord

Mask = NDArray[np.bool_]

MAX_OUTSIDE_FRACTION = 0.02
"""Part of a mask that may lie beyond the scan, as that of a needle does that leaves it."""

MARGIN_VOXELS = 2
"""Width in voxels of the gap between a mask and its surroundings, and of these."""

MIN_CONTRAST_RATIO = 2.0
"""Metal stands out from the median of its surroundings so many times as far as their 95th percentile does."""

MASK_FIX = "segment the needle in this scan, and save the segmentation as NRRD or NIfTI"


def read_mask_component(volume: Volume, path: Path, recipe: ReconstructionRecord) -> Component:
    """Read the needle's voxels from a mask: a volume that is above 0 in the needle, or a DICOM segmentation.

    It may stand on other voxels than the scan's, in any order; each voxel of the scan then asks the nearest
    of the mask.

    Raises
    ------
    DataError
        If the mask marks nothing, lies elsewhere than the scan's needle, or cannot be a needle.
    """
    mask = read_mask(path)
    require_same_frame(mask, volume.frame_of_reference, str(path))
    _require_marked(int(np.count_nonzero(mask.values > 0)), path)
    marked = _resample_mask(volume, mask, path)
    _require_marked(int(np.count_nonzero(marked)), path)
    _require_metal(volume, marked, path)
    part = measure_component(volume, np.argwhere(marked)[:, ::-1])
    if part.length < recipe.segmentation.min_length_mm:
        raise DataError(
            f"the mask is {part.length:.1f} mm long",
            where=str(path),
            expected=f"at least segmentation.min_length_mm = {recipe.segmentation.min_length_mm:g}",
            fix="give the mask of the whole needle, or lower min_length_mm",
        )
    return part


def _require_marked(count: int, path: Path) -> None:
    if count < MIN_COMPONENT_VOXELS:
        raise DataError(
            f"the mask marks {count} voxels",
            where=str(path),
            expected="the needle's voxels above 0, all others 0",
            fix=MASK_FIX,
        )


def _resample_mask(volume: Volume, mask: Volume, path: Path) -> Mask:
    """Return the voxels of `volume` (K, J, I) whose centres lie in marked voxels of `mask`."""
    marked = to_patient(mask, np.argwhere(mask.values > 0)[:, ::-1])
    size = np.array(volume.grid.size)
    index = to_index(volume, marked)
    outside = ((index < -0.5) | (index > size - 0.5)).any(axis=1)
    if outside.mean() > MAX_OUTSIDE_FRACTION:
        raise _misplaced_mask_error(
            f"{100 * outside.mean():.0f} % of what it marks lies outside the scan", path
        )
    reach = np.ceil(mask.spacing.max() / volume.spacing).astype(np.int64)
    low = np.clip(np.floor(index.min(axis=0)).astype(np.int64) - reach, 0, size - 1)
    high = np.clip(np.ceil(index.max(axis=0)).astype(np.int64) + reach, 0, size - 1)
    found = np.zeros(volume.values.shape, dtype=np.bool_)
    for k in range(low[2], high[2] + 1):  # a slice at a time: the box of an oblique needle is most of a scan
        found[k, low[1] : high[1] + 1, low[0] : high[0] + 1] = _resample_slice(volume, mask, (low, high), k)
    return found


def _resample_slice(volume: Volume, mask: Volume, box: tuple[Ints, Ints], k: int) -> Mask:
    """Return which voxels (J, I) of a slice of the box, first and last i, j, k, lie in marked voxels."""
    low, high = box
    j, i = np.mgrid[low[1] : high[1] + 1, low[0] : high[0] + 1]
    ijk = np.stack([i, j, np.full_like(i, k)], axis=-1).reshape(-1, 3)
    near = np.rint(to_index(mask, to_patient(volume, ijk))).astype(np.int64)
    within = ((near >= 0) & (near < mask.grid.size)).all(axis=1)
    marked = np.zeros(len(ijk), dtype=np.bool_)
    marked[within] = mask.values[tuple(near[within, ::-1].T)] > 0
    return marked.reshape(i.shape)


def _require_metal(volume: Volume, marked: Mask, path: Path) -> None:
    """Raise DataError unless what is marked stands out from what is around it, as metal does in any unit."""
    where = np.argwhere(marked)
    low, high = where.min(axis=0), where.max(axis=0) + 1
    box = tuple(
        slice(max(0, a - 2 * MARGIN_VOXELS), b + 2 * MARGIN_VOXELS)
        for a, b in zip(low.tolist(), high.tolist(), strict=True)
    )
    inside, values = marked[box], volume.values[box]
    near = binary_dilation(inside, iterations=MARGIN_VOXELS)
    around = values[binary_dilation(near, iterations=MARGIN_VOXELS) & ~near]
    if not len(around):
        raise _misplaced_mask_error("it marks the whole scan", path)
    middle, bright = np.percentile(around, [50, 95])
    metal = float(np.percentile(values[inside], 95))
    if metal - middle <= MIN_CONTRAST_RATIO * (bright - middle):
        raise _misplaced_mask_error(
            f"what it marks is no brighter ({metal:.0f}) than what lies around it ({middle:.0f})", path
        )


def _misplaced_mask_error(why: str, path: Path) -> DataError:
    return DataError(
        f"the mask does not lie on the needle of this scan: {why}",
        where=str(path),
        expected="a mask that stands where the scan does: its origin, spacing and axes count",
        fix="see whether it belongs to this scan, and whether its header was lost on the way (LPS, mm); "
        "show both in 3D Slicer",
    )
