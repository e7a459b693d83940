"""Rigid frames of the world, and the rigid motion that lays one planar curve on another."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from needlefit.errors import DataError

Floats = NDArray[np.float64]

PARALLEL = 1e-6
"""Sine of the angle under which two directions count as parallel."""


@dataclass(frozen=True)
class Frame:
    """A right-handed frame in the world.

    Attributes
    ----------
    origin : (3,) array
        World position, mm.
    rotation : (3, 3) array
        Its columns are the frame's x, y and z axes in the world.
    """

    origin: Floats
    rotation: Floats

    @classmethod
    def from_rows(cls, rows: ArrayLike) -> Self:
        """Return the frame whose motion to the world is `rows` (3, 4): rotation, and shift in mm."""
        motion = np.asarray(rows, dtype=np.float64)
        return cls(motion[:, 3], motion[:, :3])

    @property
    def rows(self) -> Floats:
        """Its motion to the world (3, 4), as `from_rows` takes it."""
        return np.column_stack([self.rotation, self.origin])

    def to_local(self, points: ArrayLike) -> Floats:
        """Return world `points` (N, 3) in this frame."""
        local: Floats = (np.asarray(points, dtype=np.float64) - self.origin) @ self.rotation
        return local

    def to_world(self, points: ArrayLike) -> Floats:
        """Return `points` (N, 3) of this frame in the world."""
        world: Floats = np.asarray(points, dtype=np.float64) @ self.rotation.T + self.origin
        return world


def unit(vector: ArrayLike, name: str = "direction") -> Floats:
    """Return `vector` (3,) at length 1; DataError, which calls it `name`, if it is zero or not finite."""
    array = np.asarray(vector, dtype=np.float64)
    length = float(np.linalg.norm(array))
    if array.shape != (3,) or not np.isfinite(length) or length == 0.0:
        raise DataError(f"{name} is {array.tolist()}", expected="three finite numbers, not all zero")
    scaled: Floats = array / length
    return scaled


def entry_frame(origin: ArrayLike, direction: ArrayLike, toward: ArrayLike) -> Frame:
    """Return C: x along `direction`, y the part of `toward` normal to it, z = x cross y; all (3,), world.

    Raises
    ------
    DataError
        If a direction is zero or the two are parallel.
    """
    x, wanted = unit(direction), unit(toward, "bending direction")
    normal = wanted - (wanted @ x) * x
    if np.linalg.norm(normal) < PARALLEL:
        raise DataError(
            "the bending direction is parallel to the entry direction",
            expected="a direction across the needle",
        )
    y = unit(normal)
    return Frame(np.asarray(origin, dtype=np.float64), np.column_stack([x, y, np.cross(x, y)]))


def align_rigid(moving: ArrayLike, fixed: ArrayLike) -> Floats:
    """Return `moving` (..., N, 2) after the motions of SE(2) that bring it closest to `fixed` (N, 2).

    Least squares over all points; rotation and shift only, never scale or reflection. In the plane the
    best angle has a closed form: the phase of sum conj(m_j) f_j, with centred points as complex numbers.
    """
    m, f = np.asarray(moving, dtype=np.float64), np.asarray(fixed, dtype=np.float64)
    centre_m, centre_f = m.mean(axis=-2, keepdims=True), f.mean(axis=0)
    a, b = m - centre_m, f - centre_f
    across = np.sum(a[..., 0] * b[:, 1] - a[..., 1] * b[:, 0], axis=-1)
    angle = np.arctan2(across, np.sum(a * b, axis=(-2, -1)))
    c, s = np.cos(angle), np.sin(angle)
    aligned: Floats = a @ np.moveaxis(np.array([[c, s], [-s, c]]), (0, 1), (-2, -1)) + centre_f
    return aligned


def align_rigid_slopes(moving: ArrayLike, fixed: ArrayLike, slopes: Floats) -> Floats:
    """Return the derivatives (N, 2, P) of `align_rigid(moving, fixed)`, given those of `moving`."""
    m, f = np.asarray(moving, dtype=np.float64), np.asarray(fixed, dtype=np.float64)
    a, b, da = m - m.mean(axis=0), f - f.mean(axis=0), slopes - slopes.mean(axis=0)
    across, along = np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b)
    turned = np.einsum("np,n->p", da[:, 0], b[:, 1]) - np.einsum("np,n->p", da[:, 1], b[:, 0])
    size = np.hypot(across, along)
    turn = (along * turned - across * np.einsum("nip,ni->p", da, b)) / size**2  # (P,), of the angle
    c, s = along / size, across / size
    rotation, quarter = np.array([[c, s], [-s, c]]), np.array([[-s, c], [-c, -s]])
    moved: Floats = np.einsum("nip,ij->njp", da, rotation) + (a @ quarter)[:, :, None] * turn
    return moved
