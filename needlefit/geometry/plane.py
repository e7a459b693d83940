"""The plane in which a curve bends."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from needlefit.geometry.frames import unit

Floats = NDArray[np.float64]

STRAIGHT = 1e-9
"""Greatest distance from the entry line, mm, of a curve that counts as straight."""


def bending_plane(centerline: ArrayLike, direction: ArrayLike) -> Floats:
    """Return the unit vector (3,) normal to `direction` in which `centerline` (N, 3) leaves it.

    The plane holds the line through the first point along `direction` and lies closest, in least squares,
    to all points; the vector points to the side of the tip. A straight curve bends nowhere: any normal.
    """
    x = unit(direction)
    points = np.asarray(centerline, dtype=np.float64)
    across = points - points[0]
    across = across - np.outer(across @ x, x)  # (N, 3), normal to x
    if np.abs(across).max() < STRAIGHT:
        return any_normal(x)
    _, _, axes = np.linalg.svd(across, full_matrices=False)
    toward: Floats = axes[0] if axes[0] @ across[-1] >= 0 else -axes[0]
    return unit(toward - (toward @ x) * x)


def any_normal(direction: ArrayLike) -> Floats:
    """Return a unit vector (3,) normal to `direction`: the same one for the same direction."""
    x = unit(direction)
    axis = np.eye(3)[int(np.argmin(np.abs(x)))]  # the world axis that is least parallel
    return unit(axis - (axis @ x) * x)
