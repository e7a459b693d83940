"""Where the voxels of a volume stand, and what a header can have wrong about that."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needlefit.errors import DataError
from needlefit.project.caged import MEMORY_VARIABLE, stated_memory_bytes

Floats = NDArray[np.float64]

MOST_VOXELS = 2**30
"""Largest volume that is read, 1024^3: 4 GB in memory, unless the user states another size."""

SMALLEST_SPACING, GREATEST_SPACING = 1e-3, 50.0
"""Spacings of real scans, mm; outside, the unit of the file is not mm."""

SQUARE = 2e-4
"""Axes may miss right angles and unit length by this much, as cosines printed with four decimals do."""

SHEARED = "the axes of the voxels are not perpendicular unit vectors"
STRAIGHT = "three directions at right angles, without shear"
STRAIGHTEN = "a tilted gantry shears a volume: resample it onto a straight grid and export it again"


@dataclass(frozen=True)
class Grid:
    """Where voxels stand in the patient, as a header says.

    Attributes
    ----------
    size : tuple of int
        Voxels along i (columns), j (rows), k (slices).
    origin : (3,) array
        Centre of voxel (0, 0, 0), LPS, mm.
    spacing : (3,) array
        Distance of centres along i, j, k, mm.
    direction : (3, 3) array
        Its columns are the LPS unit vectors of i, j, k; either handedness.
    """

    size: tuple[int, int, int]
    origin: Floats
    spacing: Floats
    direction: Floats


def check_grid(grid: Grid, where: str = "") -> None:
    """Say what is wrong with a grid, before any voxel of it is read.

    Raises
    ------
    DataError
        If the size is absurd, the spacing is not that of a scan in mm, a number is not finite, or the
        axes are not perpendicular.
    """
    check_size(grid.size, where)
    _check_numbers(grid, where)
    if not (np.abs(grid.direction.T @ grid.direction - np.eye(3)) <= SQUARE).all():
        raise DataError(
            f"{SHEARED}: {_rounded(grid.direction.T)}", where=where, expected=STRAIGHT, mend=STRAIGHTEN
        )


def described(grid: Grid) -> dict[str, list[Any]]:
    """Return a grid as JSON; `Grid` of its parts as arrays gives it back to the bit."""
    parts = {"origin": grid.origin, "spacing": grid.spacing, "direction": grid.direction}
    return {"size": list(grid.size), **{name: array.tolist() for name, array in parts.items()}}


def squared(direction: Floats) -> Floats:
    """Return the axes (3, 3) that are perpendicular to the last digit and nearest to `direction` (3, 3)."""
    u, _, vt = np.linalg.svd(direction)
    nearest: Floats = u @ vt
    return nearest


def max_voxels() -> int:
    """Return the number of voxels of the largest volume that is read, as float32."""
    stated = stated_memory_bytes()
    return MOST_VOXELS if stated is None else stated // 4


def check_size(size: tuple[int, int, int], where: str) -> None:
    """See that there is a volume, and not more than is read.

    Raises
    ------
    DataError
    """
    shown, count = " x ".join(map(str, size)), math.prod(size)
    if min(size) < 2:
        raise DataError(
            f"holds {shown} voxels, no volume",
            where=where,
            expected="at least two voxels along each axis",
            mend="export the whole volume, not one image of it",
        )
    if count > max_voxels():
        raise DataError(
            f"its header claims {shown} voxels, {4 * count / 1e9:.3g} GB in memory",
            where=where,
            expected=f"at most {max_voxels():.3g} voxels",
            mend="crop the volume to the needle and its markers, or check where the file comes from; if it "
            f"is right and memory allows, set {MEMORY_VARIABLE} to the GiB that it may take",
        )


def _check_numbers(grid: Grid, where: str) -> None:
    if not all(np.isfinite(array).all() for array in (grid.origin, grid.spacing, grid.direction)):
        raise DataError(
            "its origin, spacing or axes are not finite numbers",
            where=where,
            expected="positions of voxels in mm",
            mend="export the volume again",
        )
    if grid.spacing.min() < SMALLEST_SPACING or grid.spacing.max() > GREATEST_SPACING:
        raise DataError(
            f"the spacing of the voxels is {' x '.join(f'{step:g}' for step in grid.spacing)} mm",
            where=where,
            expected=f"{SMALLEST_SPACING:g} to {GREATEST_SPACING:g} mm",
            mend="check in which unit the spacing was written; it must be mm",
        )


def _rounded(rows: Floats) -> list[list[float]]:
    return [[round(float(value), 4) + 0.0 for value in row] for row in rows]
