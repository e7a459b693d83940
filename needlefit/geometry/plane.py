"""The plane in which a curve bends."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from needlefit.geometry.frames import Frame, entry_frame, unit

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


def free_frame(centerline: ArrayLike) -> Frame:
    """Return a constraint frame for a curve (N, 3) that is known only up to a rigid motion.

    Its xy plane is the plane closest to the points. There the parabola that fits them best gives x, its
    tangent at the first point, and y, the side to which it bends. The origin is the first point there.
    """
    points = np.asarray(centerline, dtype=np.float64)
    centre = points.mean(axis=0)
    _, _, (along, across, normal) = np.linalg.svd(points - centre, full_matrices=False)
    along = along if along @ (points[-1] - points[0]) >= 0 else -along
    a, b = (points - points[0]) @ along, (points - points[0]) @ across
    curvature, slope, _ = np.polyfit(a, b, 2)
    side = 1.0 if curvature >= 0 else -1.0
    origin = points[0] - ((points[0] - centre) @ normal) * normal
    return entry_frame(origin, along + slope * across, side * across)
