"""Directions of needles and bevels: sides, turns, world axes, and how options state them."""

from collections.abc import Sequence

import numpy as np

from needlefit.arrays import Floats

MIN_SAME_SIDE = 0.9  # smallest length of the mean of unit deflections that have one direction
SAME_AXIS_DEG = 10.0  # largest angle (degrees) to a world axis at which that axis is proposed


def to_sides(angles: Sequence[float]) -> tuple[list[int], list[float]]:
    """Return the sides of bevels, and by how much each is turned about its needle, rad.

    Bevels that differ by half turns are 1 and -1, all turned alike; others are sides 1, turned.
    """
    if len({angle % 180.0 for angle in angles}) == 1:
        turn = float(np.radians(angles[0] % 180.0))
        return [1 if angle % 360.0 < 180.0 else -1 for angle in angles], [turn for _ in angles]
    return [1 for _ in angles], [float(np.radians(angle % 360.0)) for angle in angles]


def snap_to_axis(direction: Floats) -> Floats:
    """Return a unit direction, or the world axis that is near."""
    axis, nearest = np.zeros(3), int(np.argmax(np.abs(direction)))
    axis[nearest] = np.sign(direction[nearest])
    return axis if axis @ direction >= np.cos(np.radians(SAME_AXIS_DEG)) else direction


def format_direction(direction: Floats) -> str:
    """Return a direction as options state it."""
    return ",".join(f"{value:z.3g}" for value in direction.round(3))
