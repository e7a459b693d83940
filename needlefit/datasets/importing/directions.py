"""Directions of needles and bevels: sides, turns, world axes, and how options state them."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from needlefit.arrays import Floats
from needlefit.datasets.layers import SAME_POINT_MM
from needlefit.geometry.frames import to_unit

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


class BendsOfSides:
    """How far bevels of side 1 would have bent across their directions, mm: `toward` (N, 3).

    `bends` (N, 3): from the directions `along` (N, 3), mm. `angles`: that bevels face, degrees; None: all 0.
    """

    def __init__(self, bends: Floats, along: Floats, angles: Sequence[float] | None) -> None:
        sides, turns = to_sides(angles or [0.0] * len(bends))
        self.turned = Rotation.from_rotvec(np.array(turns)[:, None] * along)
        across = bends - np.sum(bends * along, axis=1)[:, None] * along
        self.toward: Floats = np.array(sides)[:, None] * self.turned.inv().apply(across)
        self.sizes = np.linalg.norm(self.toward, axis=1)
        self.units = self.toward / np.maximum(self.sizes, SAME_POINT_MM)[:, None]
        self.direction = to_unit(along.sum(axis=0))
        self.mean = to_unit(self.toward.sum(axis=0))  # of straight needles it is 0

    @property
    def agree(self) -> bool:
        """Whether they have one direction."""
        return bool(np.linalg.norm(self.units.sum(axis=0)) > MIN_SAME_SIDE * len(self.units))
