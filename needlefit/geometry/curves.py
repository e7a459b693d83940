"""Curves: polylines by arc length, their bending plane, and curves of given curvature (baselines)."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.polynomial.polynomial import polyval
from numpy.typing import ArrayLike

from needlefit.arrays import Floats
from needlefit.geometry.frames import Frame, make_entry_frame, normalize
from needlefit.schemas.base import DIRECTIONS, Compared


def arc_length(points: ArrayLike) -> Floats:
    """Return the length along the polyline `points` (N, d) up to each point, 0 at the first: (N,), mm."""
    steps = np.linalg.norm(np.diff(np.asarray(points, dtype=np.float64), axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def interpolate_at_arc(points: ArrayLike, s: ArrayLike) -> Floats:
    """Return the points (K, d) at arc lengths `s` (K,) along `points` (N, d); the end point beyond an end."""
    array = np.asarray(points, dtype=np.float64)
    along = arc_length(array)
    return np.column_stack([np.interp(np.asarray(s, dtype=np.float64), along, axis) for axis in array.T])


STRAIGHT_TOLERANCE_MM = 1e-9  # largest distance from the entry line (mm) of a curve that counts as straight


def find_bending_direction(centerline: ArrayLike, direction: ArrayLike) -> Floats:
    """Return the unit vector (3,) normal to `direction` along which `centerline` (N, 3) deflects.

    The plane holds the line through the first point along `direction` and lies closest, in least squares,
    to all points; the vector points to the side of the tip. A straight curve bends nowhere: any normal.
    """
    x = normalize(direction)
    points = np.asarray(centerline, dtype=np.float64)
    across = points - points[0]
    across = across - np.outer(across @ x, x)  # (N, 3), normal to x
    if np.abs(across).max() < STRAIGHT_TOLERANCE_MM:
        return make_normal(x)
    _, _, axes = np.linalg.svd(across, full_matrices=False)
    # The sign of a singular vector is arbitrary: the side of the tip decides it.
    toward: Floats = axes[0] if axes[0] @ across[-1] >= 0 else -axes[0]
    return normalize(toward - (toward @ x) * x)


def make_normal(direction: ArrayLike) -> Floats:
    """Return a unit vector (3,) normal to `direction`; equal directions give the same vector."""
    x = normalize(direction)
    axis = np.eye(3)[int(np.argmin(np.abs(x)))]  # the world axis that is least parallel
    return normalize(axis - (axis @ x) * x)


def fit_free_frame(centerline: ArrayLike) -> Frame:
    """Return a constraint frame for a curve (N, 3) that is known only up to a rigid motion.

    Its xy plane is the plane closest to the points. There the parabola that fits them best gives x, its
    tangent at the first point, and y, the side to which it bends. The origin is the first point there.
    """
    points = np.asarray(centerline, dtype=np.float64)
    centre = points.mean(axis=0)
    _, _, (along, across, normal) = np.linalg.svd(points - centre, full_matrices=False)
    # As above: the direction from the first point to the last decides the sign.
    along = along if along @ (points[-1] - points[0]) >= 0 else -along
    a, b = (points - points[0]) @ along, (points - points[0]) @ across
    curvature, slope, _ = np.polyfit(a, b, 2)
    side = 1.0 if curvature >= 0 else -1.0
    origin = points[0] - ((points[0] - centre) @ normal) * normal
    return make_entry_frame(origin, along + slope * across, side * across)


# nodes and weights of Gauss-Legendre quadrature on [-1, 1]
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)


def integrate_curvature(depth: float, coefficients: Sequence[ArrayLike], s: ArrayLike) -> Floats:
    """Return the points (..., K, 2) of curves whose curvature is a polynomial in the distance d from the tip.

    kappa(d) = c_0 + c_1 d + ..., d = depth - s. The curve starts at the entry (0, 0) along x, so with P(d)
    the integral of kappa from 0 to d

        theta(s) = P(depth) - P(depth - s),    (x, y)(s) = integral_0^s (cos theta, sin theta).

    `depth`: inserted arc length, mm.
    `coefficients`: c_k (...) in mm^-(k + 1), a number each for one curve; none: a straight line.
    `s`: (K,); arc lengths from the entry, mm; before it (s < 0) the curve is straight.
    """
    along = np.asarray(s, dtype=np.float64)
    parts = [np.divide(c, k + 1) for k, c in enumerate(coefficients)]
    integral = np.array([np.zeros(np.shape(parts[0]) if parts else ()), *parts])  # (P + 1, ...)
    inside = np.maximum(along, 0.0)
    # Gauss points of the interval from 0 to s, for every s.
    stations = 0.5 * inside[:, None] * (1 + _NODES)  # (K, Q)
    turned = polyval(np.float64(depth), integral)  # (...)
    heading = turned[..., None, None] - polyval(depth - stations, integral)  # (..., K, Q)
    half = 0.5 * inside
    x, y = half * (np.cos(heading) @ _WEIGHTS), half * (np.sin(heading) @ _WEIGHTS)
    return np.stack([x + np.minimum(along, 0.0), y], axis=-1)


def select_compared(points: Floats, compared: Compared, axis: int = -1) -> Floats:
    """Return the coordinates of points that are compared: x and y of those in the plane, in space z too."""
    return np.take(points, range(points.shape[axis])[: 1 + DIRECTIONS[compared]], axis)


#: what is compared of two needles: places along them, the tip at each reading of a track, curvatures at
#: sensors, or the tip that these lead to; "noise" is of errors that are divided by it
Quantity = Literal["places", "readings", "curvatures", "integrated", "noise"]
# number of points of a curve of which only the tip was measured: the stated entry, and the tip
TIP_POINTS = 2
# number of points at which two curves are compared, from entry (j = 1) to tip (j = K)
COMPARISON_POINTS = 101


@dataclass(frozen=True)
class ComparedCurves:
    """Two curves of one insertion at the same stations, from the entry to the tip."""

    # `simulated`, `measured`: the coordinates that are compared of points in C, (K, 2) or (K, 3) mm; of
    # "curvatures" the place of a sensor, mm, and its readings, 1/m
    simulated: Floats
    measured: Floats
    quantity: Quantity = "places"

    @cached_property
    def distances(self) -> Floats:
        """Distance (K,) at each station, |r_sim - r_measured|, mm."""
        return np.linalg.norm(self.simulated - self.measured, axis=1)

    @property
    def is_curve(self) -> bool:
        """Whether there are stations between entry and tip."""
        return len(self.measured) > TIP_POINTS

    @property
    def tip_error(self) -> float:
        """The distance at the last station, mm."""
        return float(self.distances[-1])

    @property
    def deflection(self) -> float:
        """Measured displacement of the tip across x, mm."""
        return float(np.linalg.norm((self.measured[-1] - self.measured[0])[1:]))


def compare_curves(
    simulated: ArrayLike,
    measured: ArrayLike,
    compared: Compared = "space",
    quantity: Quantity = "places",
) -> ComparedCurves:
    """Return two curves (K, 2) or (K, 3), both in C, as compared station by station.

    ValueError if their shapes differ.
    """
    sim, meas = np.asarray(simulated, dtype=np.float64), np.asarray(measured, dtype=np.float64)
    if sim.shape != meas.shape or sim.ndim != 2 or sim.shape[1] not in (2, 3):
        raise ValueError(
            f"curves of shape {sim.shape} and {meas.shape} cannot be compared; need (K, 2) or (K, 3) twice"
        )
    return ComparedCurves(select_compared(sim, compared), select_compared(meas, compared), quantity)
