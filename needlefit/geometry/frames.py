"""Rigid frames: entry frames of needles, alignment of planar curves, patient coordinates (LPS inside)."""

from dataclasses import dataclass
from typing import Literal, Self

import numpy as np
from numpy.typing import ArrayLike

from needlefit.arrays import Floats, pad_axis
from needlefit.errors import DataError
from needlefit.schemas.scene import PlacementRecord

UNIT_VECTOR_TOLERANCE = 1e-3  # largest deviation of a direction's length, or of axes from right angles
PARALLEL_SINE = 1e-6  # sine of the angle below which two directions count as parallel


@dataclass(frozen=True)
class Frame:
    """A right-handed coordinate frame, given by its origin and axes in the world."""

    origin: Floats  # (3,); world position, mm
    rotation: Floats  # (3, 3); its columns are the frame's x, y and z axes in the world

    @classmethod
    def from_rows(cls, rows: ArrayLike) -> Self:
        """Return the frame whose transform to the world is `rows` (3, 4): rotation, and shift in mm."""
        motion = np.asarray(rows, dtype=np.float64)
        return cls(motion[:, 3], motion[:, :3])

    @property
    def rows(self) -> Floats:
        """The frame's transform to the world (3, 4), as `from_rows` takes it."""
        return np.column_stack([self.rotation, self.origin])

    def to_local(self, points: ArrayLike) -> Floats:
        """Return world `points` (N, 3) in coordinates of this frame."""
        return (np.asarray(points, dtype=np.float64) - self.origin) @ self.rotation

    def to_world(self, points: ArrayLike) -> Floats:
        """Return `points` (N, 3), given in this frame, in world coordinates."""
        return np.asarray(points, dtype=np.float64) @ self.rotation.T + self.origin


def normalize(vector: ArrayLike, name: str = "direction") -> Floats:
    """Return `vector` (3,) scaled to length 1; DataError, with `name` in it, if it is zero or not finite."""
    array = np.asarray(vector, dtype=np.float64)
    length = float(np.linalg.norm(array))
    if array.shape != (3,) or not np.isfinite(length) or length == 0.0:
        raise DataError(f"{name} is {array.tolist()}", expected="three finite numbers, not all zero")
    return array / length


def to_unit(vectors: Floats) -> Floats:
    """Return a vector (3,), or vectors (N, 3), with length 1; one of length 0 stays."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(lengths > 0, lengths, 1.0)


def make_entry_frame(origin: ArrayLike, direction: ArrayLike, toward: ArrayLike) -> Frame:
    """Return the constraint frame C: x along `direction`, y the part of `toward` normal to it, z = x cross y;
    all (3,), world.

    DataError if a direction is zero or the two are parallel.
    """
    x, wanted = normalize(direction), normalize(toward, "bending direction")
    normal = wanted - (wanted @ x) * x
    if np.linalg.norm(normal) < PARALLEL_SINE:
        raise DataError(
            "the bending direction is parallel to the entry direction",
            expected="a direction across the needle",
            fix="point the bevel (bevel_x, bevel_y, bevel_z) there, or do not state it",
        )
    y = normalize(normal)
    return Frame(np.asarray(origin, dtype=np.float64), np.column_stack([x, y, np.cross(x, y)]))


def align_rigid(moving: ArrayLike, fixed: ArrayLike) -> Floats:
    """Return `moving` (..., N, 2) after the rigid planar motions that bring it closest to `fixed` (N, 2).

    Least squares over all points; rotation and shift only, never scale or reflection. In the plane the
    best angle has a closed form: the phase of sum conj(m_j) f_j, with centred points as complex numbers.
    """
    m, f = np.asarray(moving, dtype=np.float64), np.asarray(fixed, dtype=np.float64)
    centre_m, centre_f = m.mean(axis=-2, keepdims=True), f.mean(axis=0)
    a, b = m - centre_m, f - centre_f
    across = np.sum(a[..., 0] * b[:, 1] - a[..., 1] * b[:, 0], axis=-1)
    angle = np.arctan2(across, np.sum(a * b, axis=(-2, -1)))
    c, s = np.cos(angle), np.sin(angle)
    return a @ np.moveaxis(np.array([[c, s], [-s, c]]), (0, 1), (-2, -1)) + centre_f


def differentiate_align_rigid(moving: ArrayLike, fixed: ArrayLike, slopes: Floats) -> Floats:
    """Return the derivatives (..., N, 2, P) of `align_rigid(moving, fixed)`, given those of `moving`."""
    m, f = np.asarray(moving, dtype=np.float64), np.asarray(fixed, dtype=np.float64)
    a, b = m - m.mean(axis=-2, keepdims=True), f - f.mean(axis=0)
    da = slopes - slopes.mean(axis=-3, keepdims=True)
    dx, dy = da[..., 0, :], da[..., 1, :]  # (..., N, P)
    across = np.sum(a[..., 0] * b[:, 1] - a[..., 1] * b[:, 0], axis=-1)
    along = np.sum(a * b, axis=(-2, -1))
    by_across, by_along = b[:, 1] @ dx - b[:, 0] @ dy, b[:, 0] @ dx + b[:, 1] @ dy  # (..., P)
    # across and along are the sine and cosine of the best angle, times `size`.
    size = np.hypot(across, along)
    turn = (along[..., None] * by_across - across[..., None] * by_along) / size[
        ..., None
    ] ** 2  # of the angle
    c, s = (part[..., None] for part in (along / size, across / size))
    x, y = -s * a[..., 0] - c * a[..., 1], c * a[..., 0] - s * a[..., 1]  # (..., N) turned by a quarter
    c, s, turn = c[..., None], s[..., None], turn[..., None, :]
    return np.stack((c * dx - s * dy + x[..., None] * turn, s * dx + c * dy + y[..., None] * turn), axis=-2)


def make_tracker_columns(depth: Floats) -> Floats:
    """Return the change (N, 2) of lateral places at `depth` (N,) by a unit shift (mm) and a unit slope."""
    return np.column_stack([np.ones(len(depth)), depth])


def align_lateral(moving: Floats, fixed: Floats, terms: Literal[1, 2] = 2) -> Floats:
    """Return `moving` (..., N, D) after the shifts and slopes across that bring it closest to `fixed`.

    So are two tip tracks compared, whose tracker's frame is not known; x, the depth, is the same in both.
    With one of the two `terms` it is shifted alone.
    """
    columns = np.linalg.qr(make_tracker_columns(fixed[:, 0])[:, :terms])[0]
    aligned = moving.copy()
    for axis in range(1, moving.shape[-1]):
        aligned[..., axis] += (fixed[:, axis] - moving[..., axis]) @ columns @ columns.T
    return aligned


def differentiate_align_lateral(fixed: Floats, slopes: Floats, terms: Literal[1, 2] = 2) -> Floats:
    """Return the derivatives (..., N, D, P) of `align_lateral(moving, fixed)`, given those of `moving`."""
    columns = np.linalg.qr(make_tracker_columns(fixed[:, 0])[:, :terms])[0]
    derivatives = slopes.copy()
    for axis in range(1, slopes.shape[-2]):
        derivatives[..., axis, :] -= columns @ (columns.T @ slopes[..., axis, :])
    return derivatives


PatientSystem = Literal["LPS", "RAS"]

# Factors that convert coordinates of a system to LPS: z points to the head in both, x and y are opposite.
AXIS_SIGNS = {"LPS": (1.0, 1.0, 1.0), "RAS": (-1.0, -1.0, 1.0)}
# The patient's frame where world coordinates are patient coordinates.
IDENTITY_FRAME = Frame(np.zeros(3), np.eye(3))
# frame that converts RAS to LPS, and back: x and y change their signs
RAS_TO_LPS = Frame(np.zeros(3), np.diag([-1.0, -1.0, 1.0]))


def to_lps(points: ArrayLike, system: PatientSystem) -> Floats:
    """Convert `points` (..., 3) from a patient coordinate system to LPS; the same call converts back."""
    return np.asarray(points, dtype=np.float64) * AXIS_SIGNS[system] + 0.0  # no "-0.0"


@dataclass(frozen=True)
class Placement:
    """The poses of the constraint frame C and of the scan's patient coordinates, each in the world."""

    frame: Frame  # C; the needle lies in its xy plane
    patient: Frame = IDENTITY_FRAME  # LPS

    @classmethod
    def from_record(cls, record: PlacementRecord) -> Self:
        """Return the placement that a validated record describes."""
        return cls(Frame.from_rows(record.entry_to_world), Frame.from_rows(record.lps_to_world))

    def to_record(self) -> PlacementRecord:
        """Return the placement as a record for files; reading it returns the same bits."""
        return PlacementRecord(
            entry_to_world=self.frame.rows.tolist(), lps_to_world=self.patient.rows.tolist()
        )

    def to_world(self, points: ArrayLike) -> Floats:
        """Return points (K, 2), in C's plane, or (K, 3), in C, in world coordinates, (K, 3) mm."""
        return self.frame.to_world(pad_axis(np.asarray(points, dtype=np.float64), 3))

    def to_patient(self, points: ArrayLike) -> Floats:
        """Return points (K, 2) or (K, 3), given in C, in patient coordinates, (K, 3) LPS, mm."""
        return self.patient.to_local(self.to_world(points))


def move_frame(frame: Frame, points: Floats, to: Floats) -> Frame:
    """Return the frame in which `points` (K, 3) have the world positions that `to` (K, 3) have in `frame`.

    Both are the same points, turned in the plane and moved.
    """
    start, end = (complex(*(curve[-1] - curve[0])[:2]) for curve in (points, to))
    # Planar vectors as complex numbers: their quotient, scaled to length 1, is the rotation.
    turn = end / start / abs(end / start)
    rotation = np.array([[turn.real, -turn.imag, 0.0], [turn.imag, turn.real, 0.0], [0.0, 0.0, 1.0]])
    return Frame(frame.to_world([to[0] - rotation @ points[0]])[0], frame.rotation @ rotation)
