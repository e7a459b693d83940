"""Define a CT volume: its voxel grid in patient coordinates (LPS, mm) and its values, both checked."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import map_coordinates

from needlefit.arrays import Floats, Ints, are_bounded
from needlefit.errors import DataError, NeedlefitError
from needlefit.geometry.frames import UNIT_VECTOR_TOLERANCE
from needlefit.imaging.bright_voxels import BrightVoxels, list_bright_voxels
from needlefit.imaging.constants import HU, PART
from needlefit.project.reader_process import MEMORY_VARIABLE, stated_memory_bytes

# largest memory (bytes) of a volume that is read, as float32, unless the user states another: 1024^3 voxels
DEFAULT_VOLUME_BYTES = 2**32
# spacings of real scans (mm), from the finest micro-CT to the thickest slices; outside, the unit of the file
# is not mm
SPACINGS_MM = (1e-3, 50.0)
MAX_EQUAL = 3  # largest number of voxels around an object that have its largest value by chance
# largest tilt (degrees): a gantry tilts by 30 at most; its slices then lean over one another by as much
MAX_TILT_DEG = 35.0


@dataclass(frozen=True)
class VoxelGrid:
    """The position of voxels in patient coordinates."""

    size: tuple[int, ...]  # voxels along i (columns), j (rows), k (slices)
    origin: Floats  # (3,); centre of voxel (0, 0, 0), LPS, mm
    spacing: Floats  # (3,); distance of centres along i, j, k, mm
    # (3, 3); its columns are the LPS unit vectors of i, j, k, of either handedness. i and j are
    # perpendicular; k stands on both, or leans where the gantry was tilted.
    direction: Floats

    @property
    def normal(self) -> Floats:
        """The unit normal (3,) of the slices, on the side to which k grows."""
        across = np.cross(self.direction[:, 0], self.direction[:, 1])
        return across * np.sign(across @ self.direction[:, 2])

    @property
    def slice_distance(self) -> float:
        """The distance of the slices' planes, mm."""
        return float(self.spacing[2] * (self.normal @ self.direction[:, 2]))


def check_grid(grid: VoxelGrid) -> None:
    """Raise DataError if a grid is impossible, before any voxel of it is read.

    It is if the size is absurd, the spacing is not that of a scan in mm, a number is not finite, or the axes
    are not those of slices: rows and columns at right angles, slices one above the other or leaning as those
    of a tilted gantry do.
    """
    check_size(grid.size)
    if not are_bounded(np.vstack([grid.origin, grid.spacing, grid.direction])):
        raise DataError(
            "its origin, spacing or axes are not finite, or too large",
            expected="positions of voxels in mm",
            fix="export the volume again",
        )
    if grid.spacing.min() < SPACINGS_MM[0] or grid.spacing.max() > SPACINGS_MM[1]:
        raise DataError(
            f"the spacing of the voxels is {' x '.join(f'{step:g}' for step in grid.spacing)} mm",
            expected="{:g} to {:g} mm".format(*SPACINGS_MM),
            fix="check in which unit the spacing was written; it must be mm",
        )
    flat, upright = grid.direction[:, :2], grid.direction[:, 2]
    skew, lean = np.abs(flat.T @ flat - np.eye(2)).max(), np.hypot(*(upright @ flat))
    if skew > UNIT_VECTOR_TOLERANCE or lean > np.sin(np.radians(MAX_TILT_DEG)):
        raise DataError(
            "the axes of the voxels are not perpendicular unit vectors: "
            f"{grid.direction.T.round(4).tolist()}",
            expected=(
                f"rows and columns at right angles, slices that lean by at most {MAX_TILT_DEG:g} degrees"
            ),
            fix="resample the volume onto a straight grid and export it again",
        )


def fill_unknown(values: NDArray[Any]) -> list[str]:
    """Replace NaN by the value of air, in label volumes by 0; return a note of how many, and where.

    DataError if all values are NaN, or one is infinite.
    """
    if np.isfinite([values.min(), values.max()]).all():
        return []
    low, high = (float(end.reduce(values, axis=None)) for end in (np.fmin, np.fmax))
    if not np.isfinite([low, high]).all():
        raise DataError(
            f"its values are {low:g} to {high:g}",
            expected="a number in every voxel",
            fix="give voxels outside the scan the value of air, e.g. -1000",
        )
    unknown = np.isnan(values)
    first, count = np.unravel_index(int(unknown.argmax()), values.shape)[::-1], int(np.count_nonzero(unknown))
    filled = min(HU.AIR, low) if low < 0 else 0.0  # labels are nowhere below 0
    values[unknown] = filled
    return [
        f"{count} of {values.size} voxels ({100 * count / values.size:.2g} %) have no value (NaN), the first "
        f"at i, j, k = {', '.join(map(str, first))}: {filled:g} was taken, "
        f"{'air' if low < 0 else 'no label'}"
    ]


def max_volume_bytes() -> int:
    """Return the largest memory of a volume that is read, as float32."""
    return stated_memory_bytes() or DEFAULT_VOLUME_BYTES


def check_size(size: tuple[int, ...]) -> None:
    """Refuse an empty volume, or one with more voxels than are read. Raises DataError."""
    shown, memory = " x ".join(map(str, size)), 4 * math.prod(size)
    if min(size) < 2:
        raise DataError(
            f"holds {shown} voxels, no volume",
            expected="at least two voxels along each axis",
            fix="export the whole volume, not one image of it",
        )
    if memory > max_volume_bytes():
        raise DataError(
            f"its header claims {shown} voxels, {memory / 1e9:.3g} GB in memory",
            expected=f"at most {max_volume_bytes() / 4:.3g} voxels",
            fix=(
                "crop the volume to the needle and its markers, or check where the file "
                f"comes from; if it is right and memory allows, set {MEMORY_VARIABLE} to the "
                "GiB that it may take"
            ),
        )


IMAGE_SUFFIXES = (".nrrd", ".nhdr", ".nii", ".nii.gz", ".mha", ".mhd")
ARCHIVE_SUFFIX = ".zip"
READABLE_VOLUMES = (
    "a folder with a DICOM series, one file of it, NRRD (.nrrd), NIfTI (.nii, .nii.gz) or MetaImage (.mha), "
    "or a .zip of these"
)


@dataclass(frozen=True)
class Volume:
    """A CT volume; patient coordinates are LPS, mm, whatever its file used."""

    # (K, J, I); attenuation [slice, row, column], rescaled as the file says (HU where the scanner gave HU).
    values: NDArray[np.float32]
    origin: Floats  # (3,); centre of voxel (0, 0, 0), mm
    spacing: Floats  # (3,); distance of centres along i, j, k, mm
    direction: Floats  # (3, 3); as that of a grid
    warnings: tuple[str, ...] = ()  # what a person should know of its files

    @property
    def grid(self) -> VoxelGrid:
        """The grid of the voxels."""
        return VoxelGrid(self.values.shape[::-1], self.origin, self.spacing, self.direction)

    @cached_property
    def tissue(self) -> float:
        """The median of all voxels that are not air, HU, from every third voxel along each axis."""
        some = self.values[::3, ::3, ::3]
        dense = some[some > HU.LIGHT]
        return float(np.median(dense if dense.size > some.size / 100 else some))

    @cached_property
    def ends(self) -> tuple[float, float]:
        """The least and the largest value, HU."""
        return float(self.values.min()), float(self.values.max())

    @cached_property
    def _bright(self) -> BrightVoxels:
        return list_bright_voxels(self.values, self.tissue + min(PART.THRESHOLDS) * HU.CLIPPED)

    def list_bright(self, level: float) -> BrightVoxels:
        """Return the voxels above a level, HU; others, too, where a list down to a lower level is at hand."""
        return self._bright if self._bright.level <= level else list_bright_voxels(self.values, level)

    @cached_property
    def resampled_top(self) -> float | None:
        """The value at which a scan was cut before it was resampled, HU; None if either was not done.

        Few interpolated values equal this limit. Without it metal would be fitted as less bright, and longer.
        """
        top = self.ends[1]
        if not PART.BRIGHTEST <= top / HU.CLIPPED <= 1 / PART.BRIGHTEST:
            return None
        bright = self._bright.values[self._bright.values > PART.BRIGHTEST * top]
        shared = np.count_nonzero(bright == top)  # most of them, where the scanner has cut them
        return top if len(bright) > MAX_EQUAL and 2 * shared < len(bright) else None


def turn_slices(volume: Volume) -> Volume:
    """Return the volume with its axes reordered so that the largest spacing, as of slices, is that of k.

    The same volume if k has it already, or leans on i and j.
    """
    longest = volume.spacing.argmax()
    lean = np.abs(volume.direction[:, :2].T @ volume.direction[:, 2]).max()
    if volume.spacing[longest] < PART.FLATNESS * volume.spacing[2] or lean > UNIT_VECTOR_TOLERANCE:
        return volume
    order = [*np.delete(range(3), longest), longest]
    values = np.ascontiguousarray(volume.values.T.transpose(order).T)
    return replace(volume, values=values, spacing=volume.spacing[order], direction=volume.direction[:, order])


def to_patient(volume: Volume | VoxelGrid, ijk: ArrayLike) -> Floats:
    """Return the LPS points (N, 3), mm, of fractional voxel indices i, j, k (N, 3)."""
    return np.multiply(ijk, volume.spacing) @ volume.direction.T + volume.origin


def to_index(volume: Volume | VoxelGrid, points: ArrayLike) -> Floats:
    """Return the fractional indices i, j, k (N, 3) of LPS points (N, 3), mm; whole at voxel centres."""
    return np.subtract(points, volume.origin) @ np.linalg.inv(volume.direction * volume.spacing).T


def sample(volume: Volume, points: Floats) -> Floats:
    """Return the values (...) at LPS points (..., 3), mm; nan outside the volume.

    Trilinear: it keeps centroids; cubic interpolation of a saturated needle, with its ringing, need not.
    """
    index = to_index(volume, points.reshape(-1, 3))[:, ::-1].T  # i, j, k; the array is indexed k, j, i
    values: Floats = map_coordinates(volume.values, index, order=1, cval=np.nan, output=np.float64)
    return values.reshape(points.shape[:-1])


def list_voxels_near(volume: Volume, points: ArrayLike, reach: float) -> tuple[Ints, Floats]:
    """Return the voxels (N, 3), i, j, k, of a box within `reach` mm of LPS points, and their values (N,)."""
    index, margin = to_index(volume, points), reach / volume.spacing
    ends = np.array([np.floor(index.min(axis=0) - margin), np.ceil(index.max(axis=0) + margin) + 1])
    low, high = ends.clip(0, volume.grid.size).astype(int)
    ijk = np.argwhere(np.ones(high - low)) + low
    return ijk, volume.values[tuple(ijk.T[::-1])].astype(np.float64)


def find_cuts(values: Floats) -> tuple[float, float]:
    """Return the limits between which a scanner has cut values (N,), HU; infinite where it has not.

    It has if several voxels have exactly the least, or the largest value.
    """
    low, high = float(values.min()), float(values.max())
    cut = [np.count_nonzero(values == end) > MAX_EQUAL for end in (low, high)]
    return low if cut[0] else -np.inf, high if cut[1] else np.inf


def measure_face_distance(volume: Volume, points: Floats) -> Floats:
    """Return how far inside the nearest face of the volume LPS points (N, 3) lie, mm; (N,)."""
    index, last = to_index(volume, points), np.array(volume.grid.size) - 1
    return (np.minimum(index, last - index) * volume.spacing).min(axis=1)


def require_inside(volume: Volume, points: Floats, kind: str) -> None:
    """Raise DataError if one of LPS points (N, 3), mm, lies more than a voxel outside the volume.

    The error names the points by their `kind`.
    """
    outside = points[measure_face_distance(volume, points) < -volume.spacing.max()]
    if len(outside):
        place = ", ".join(f"{x:.1f}" for x in outside[0])
        raise DataError(
            f"{len(outside)} of {len(points)} {kind} lie outside the volume, one at L, P, S = {place} mm",
            expected="places in the scan, LPS, mm",
            fix="take those of this scan; check that the file states its coordinate system (RAS or LPS)",
        )


def explain_refusal(error: NeedlefitError, volume: Volume) -> NeedlefitError:
    """Return the error of a scan with the size, the spacing and the values of its volume added.

    A doubt about the unit of the values is put first: it may be the cause.
    """
    size, steps = (
        " x ".join(f"{length:.3g}" for length in lengths)
        for lengths in (volume.grid.size * volume.spacing, volume.spacing)
    )
    what = ". With these values: ".join([*doubt_air(volume), error.what])
    holds = "the scan is {} mm large, its voxels {} mm; its values are {:.5g} to {:.5g}"
    return error.replace(what=f"{what}; {holds.format(size, steps, *volume.ends)}")


def doubt_air(volume: Volume) -> Iterator[str]:
    """Yield a warning if air has another value than in HU, as in the grey values of cone-beam scanners.

    Air is taken to be all that is darker than soft material, except voxels of the lowest value: these lie
    outside the scanner's field, or were cut. If there are no other dark voxels, the lowest value is that of
    air.
    """
    some = volume.values[::3, ::3, ::3]
    dark = some[(some > some.min()) & (some < HU.GAP)]
    level = float(np.median(dark) if dark.size else some.min())
    seldom = 0 < dark.size <= PART.AIR_VOXELS * some.size
    if not (seldom or HU.AIR_RANGE[0] <= level <= HU.AIR_RANGE[1]):
        yield (
            f"the values may be no Hounsfield units: the darkest material, unless it is lung or foam, has "
            f"{level:.0f}, and air would have -1000; export HU, or turn the values so that air has -1000 and "
            "water 0: thresholds, entry and layers depend on them"
        )


def require_hounsfield(volume: Volume) -> None:
    """Raise DataError if the values cannot be HU.

    Files that state no modality may hold MR, stored values or attenuations. In HU some values around any
    needle are below 0: those of air, or the noise of water.
    """
    low, high = volume.ends
    if low >= 0 or high - low < HU.METAL_CONTRAST:
        raise DataError(
            "its values are no Hounsfield units of a scan with a needle",
            expected="air near -1000, water near 0, metal above 1000",
            fix="export the original series in HU, e.g. as DICOM with its rescale; or subtract an offset "
            "(1024 as a rule), or convert attenuation: HU = 1000 (mu / mu of water - 1)",
        )
