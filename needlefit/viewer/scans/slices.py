"""Slices of a scan: along its three axes, and along the needle."""

from dataclasses import dataclass
from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from needlefit.arrays import Floats
from needlefit.geometry.curves import arc_length, interpolate_at_arc, make_normal
from needlefit.imaging.volume import Volume, to_index

PIXEL_MM = 0.3
"""Edge of a pixel of the slice along the needle, mm."""

HALF_WIDTH_MM = 10.0
"""How far the slice along the needle reaches to both sides, mm."""

BEYOND_TIP_MM = 15.0
"""How far it reaches beyond the tip, mm."""

_LETTERS = ("RL", "AP", "IS")
"""Letters of the low and the high side of the patient's axes L, P, S."""

_VIEWS = (("axial", 2, 0, 1, 1), ("coronal", 1, 0, 2, -1), ("sagittal", 0, 1, 2, -1))
"""Name, and the patient's axes across the slice, to the right and downwards; -1: upwards is positive."""


@dataclass(frozen=True)
class SliceAxes:
    """How a slice lies in a volume.

    Attributes
    ----------
    normal, right, down : int
        Axes of the volume: i, j or k.
    right_sign, down_sign : int
        -1 where the picture runs against the index.
    letters : tuple of str
        Of the patient's sides at the left, right, top and bottom edge.
    """

    name: str
    normal: int
    right: int
    down: int
    right_sign: int
    down_sign: int
    letters: tuple[str, str, str, str]


def list_slice_axes(volume: Volume) -> tuple[SliceAxes, ...]:
    """Return the three views, each of the volume's axes taken for the patient's axis that it is nearest."""
    turned = volume.direction
    own = max(permutations(range(3)), key=lambda axes: sum(abs(turned[p, axes[p]]) for p in range(3)))
    signs = [1 if turned[p, own[p]] > 0 else -1 for p in range(3)]
    found = []
    for name, normal, right, down, way in _VIEWS:
        across, along = _LETTERS[right], _LETTERS[down][::way]
        found.append(
            SliceAxes(
                name, own[normal], own[right], own[down], signs[right], way * signs[down],
                (across[0], across[1], along[0], along[1]),
            )
        )  # fmt: skip
    return tuple(found)


def cut_slice(volume: Volume, axes: SliceAxes, index: int) -> NDArray[np.float32]:
    """Return one slice (rows, columns), top row first, HU."""
    order = {0: 2, 1: 1, 2: 0}  # values are stored [k, j, i]
    plane = np.moveaxis(volume.values, [order[axes.normal], order[axes.down], order[axes.right]], [0, 1, 2])
    index = min(max(index, 0), plane.shape[0] - 1)
    return plane[index, :: axes.down_sign, :: axes.right_sign]


@dataclass(frozen=True)
class NeedleCourse:
    """The needle drawn straight: where each column of its slice lies, and what is across it.

    Attributes
    ----------
    points, u, v : (N, 3) arrays
        LPS, mm; `u` and `v` are perpendicular unit vectors across the needle.
    """

    points: Floats
    u: Floats
    v: Floats

    @property
    def aside(self) -> Floats:
        """Distance of each row from the needle, mm, the top row first."""
        return np.arange(HALF_WIDTH_MM, -HALF_WIDTH_MM - 1e-9, -PIXEL_MM)

    def cut(self, volume: Volume, angle: float) -> NDArray[np.float32]:
        """Return the slice (rows, N) through the needle, turned about it by `angle` (rad); nan outside."""
        across = np.cos(angle) * self.u + np.sin(angle) * self.v
        places = self.points[None] + self.aside[:, None, None] * across[None]
        index = to_index(volume, places.reshape(-1, 3))[:, ::-1].T
        values: NDArray[Any] = map_coordinates(volume.values, index, order=1, cval=np.nan, output=np.float32)
        return values.reshape(len(self.aside), len(self.points))


def make_course(needle: Floats) -> NeedleCourse:
    """Return the course of a needle (N, 3), LPS, from base to tip and on beyond it."""
    ahead = needle[-1] - needle[max(0, len(needle) - 10)]
    ahead /= np.linalg.norm(ahead)
    whole = np.vstack([needle, needle[-1] + BEYOND_TIP_MM * ahead])
    points = interpolate_at_arc(whole, np.arange(0.0, arc_length(whole)[-1], PIXEL_MM))
    tangents = np.gradient(points, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    # One normal for all: a needle bends by far less than the right angle at which this would fail.
    v = np.cross(tangents, make_normal(tangents[len(points) // 2]))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    return NeedleCourse(points, np.cross(v, tangents), v)
