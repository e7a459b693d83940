"""Measured curves: arc lengths along noisy points, as those of the curve smoothed to their noise.

Chords between noisy points are longer than the needle: points ds apart, with noise sigma across, add about
sigma^2 / ds each. So the points are smoothed (`penalized_spline`), each counts where its foot lies on the
smooth curve, and points that are evenly spaced but for their noise are taken as evenly spaced.
"""

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from needlefit.arrays import Floats
from needlefit.geometry.curves import arc_length
from needlefit.geometry.frames import Frame
from needlefit.geometry.penalized_spline import PenalizedSpline, fit_penalized_spline

MIN_SMOOTHED_POINTS = 5  # smallest number of points that show their noise; fewer are joined by chords
MAX_FITS = 8  # largest number of fits of the curve while the feet of its points move
MAX_FOOT_SHIFT = 1e-4  # largest movement of a foot, as a fraction of the length, at which fitting ends
SAMPLES_PER_POINT = 4  # number of places per point at which a smooth curve is integrated
MIN_SAMPLES = 200  # smallest number of places at which a whole curve is integrated
# largest difference of a step from the usual one, in deviations of its noise, at which it counts as usual
EQUAL_STEP_SD = 4.0
# deviations of noise by which the foot of an end may lie off the even spacing; beyond, the foot is its place:
# many tables end with the tip, at less than a whole step
END_STEP_SD = 3.0
MIN_EQUAL_STEPS = 0.9  # smallest fraction of usual steps at which points count as evenly spaced
# largest noise along the needle over that across it at which points count as evenly spaced
MAX_NOISE_RATIO = 1.5


@dataclass(frozen=True)
class MeasuredCurve:
    """A measured curve smoothed to its noise."""

    s: Floats  # (N,); arc length of each point from the first, mm, increasing
    smoothed: Floats  # (N, d); the places of the smooth curve at these, mm
    residuals: Floats  # (N, d); points minus their feet on the smooth curve, across it, mm
    noise_sd: float  # standard deviation of the points across the curve, per axis, mm; 0 of too few points
    length_sd: float  # standard deviation of the length by the noise of the points, mm

    @property
    def length(self) -> float:
        """The length from the first point to the last, mm."""
        return float(self.s[-1])

    def interpolate(self, s: ArrayLike) -> Floats:
        """Return the places (K, d) of the smooth curve at arc lengths (K,), mm; the ends beyond them."""
        stations = np.asarray(s, dtype=np.float64)
        return np.column_stack([np.interp(stations, self.s, axis) for axis in self.smoothed.T])

    def to_local(self, frame: Frame) -> Self:
        """Return the curve of points in the world (d = 3) in a frame."""
        return replace(
            self, smoothed=frame.to_local(self.smoothed), residuals=self.residuals @ frame.rotation
        )


def measure_curve(points: ArrayLike, sd: float = 0.0) -> MeasuredCurve:
    """Smooth points (N, 2) or (N, 3), in order along a needle, to the noise that they show.

    Fewer than 5 points, and those that follow no curve, are joined by chords.

    `sd`: their standard deviation per axis where it is stated, mm. It counts as two residuals more, and the
    deviation of the length is at least that by it.
    """
    array = np.asarray(points, dtype=np.float64)
    new = np.append(True, np.any(np.diff(array, axis=0) != 0, axis=1))
    if not new.all():
        return _repeat_points(measure_curve(array[new], sd), new)
    chords = arc_length(array)
    smooth = None
    if len(array) >= MIN_SMOOTHED_POINTS and np.isfinite(chords[-1]):
        smooth = _smooth_points(array, chords, sd)
    return smooth or MeasuredCurve(chords, array, np.zeros_like(array), 0.0, math.sqrt(2) * sd)


def _smooth_points(points: Floats, chords: Floats, sd: float) -> MeasuredCurve | None:
    """Return the smooth curve; None where points, as unsorted ones, follow none."""
    feet = chords
    try:
        for _ in range(MAX_FITS):
            curve = _SmoothCurve(points, feet, sd)
            moved, feet = feet, curve.find_feet(points)
            if np.abs(np.diff(feet - moved)).max() < MAX_FOOT_SHIFT * chords[-1]:
                break
        noise_sd = curve.spline.noise_sd
        s, weights, along_sd = _settle_places(feet, noise_sd)
    except np.linalg.LinAlgError:
        return None
    if not s[-1] > s[0]:
        return None
    tangents = curve.tangents_at(feet)
    by_points = _remove_along(curve.differentiate_length(s[0], s[-1]), tangents)
    length_sd = math.hypot(
        max(along_sd, sd) * np.linalg.norm(weights), max(noise_sd, sd) * np.linalg.norm(by_points)
    )
    residuals = _remove_along(points - curve.points_at(feet), tangents)
    return MeasuredCurve(s - s[0], curve.points_at(s), residuals, noise_sd, length_sd)


def _remove_along(vectors: Floats, tangents: Floats) -> Floats:
    """Return what of vectors (N, d) lies across unit tangents (N, d)."""
    return vectors - np.sum(vectors * tangents, axis=1, keepdims=True) * tangents


def _repeat_points(curve: MeasuredCurve, new: NDArray[np.bool_]) -> MeasuredCurve:
    """Return the curve of points (N,) of which those that are not new are at the place of the one before."""
    rows = np.cumsum(new) - 1
    smoothed, residuals = curve.smoothed[rows], curve.residuals[rows]
    return replace(curve, s=curve.s[rows], smoothed=smoothed, residuals=residuals)


class _SmoothCurve:
    """The spline through points at given places along a needle, by its own arc length."""

    def __init__(self, points: Floats, places: Floats, sd: float) -> None:
        self.start, self.extent = float(places.min()), float(np.ptp(places))
        self.u = (places - self.start) / self.extent
        # a point's own foot is its place, so that no noise shows along the curve
        self.spline: PenalizedSpline = fit_penalized_spline(self.u, points, points.shape[1] - 1, sd)
        # beyond both ends, where noise puts feet
        grid = np.linspace(-0.1, 1.1, max(MIN_SAMPLES, SAMPLES_PER_POINT * len(points)))
        speed = np.linalg.norm(self.spline.slope(grid), axis=1)
        lengths = scipy.interpolate.CubicSpline(grid, speed).antiderivative()(grid)
        self.grid, self.lengths = grid, lengths - np.interp(0.0, grid, lengths)

    def find_feet(self, points: Floats) -> Floats:
        """Return the arc lengths (N,) of the feet of the points that the spline was fitted to."""
        tangents = self._tangents(self.u)
        ahead = np.sum((points - self.spline.curve(self.u)) * tangents, axis=1)
        return np.interp(self.u, self.grid, self.lengths) + ahead

    def points_at(self, s: Floats) -> Floats:
        return np.asarray(self.spline.curve(np.interp(s, self.lengths, self.grid)))

    def tangents_at(self, s: Floats) -> Floats:
        return self._tangents(np.interp(s, self.lengths, self.grid))

    def _tangents(self, u: Floats) -> Floats:
        slopes = self.spline.slope(u)
        return slopes / np.linalg.norm(slopes, axis=1, keepdims=True)

    def differentiate_length(self, start: float, end: float) -> Floats:
        """Return the derivatives (N, d) of the length between two places by the points."""
        low, high = np.interp([start, end], self.lengths, self.grid)
        u = np.linspace(low, high, MIN_SAMPLES + 1)
        slopes, matrix = self.spline.differentiate(u)
        tangents = slopes / np.linalg.norm(slopes, axis=1, keepdims=True)
        weights = np.full(len(u), (high - low) / MIN_SAMPLES)
        weights[[0, -1]] /= 2
        return matrix.T @ (weights[:, None] * tangents)


def _settle_places(feet: Floats, noise_sd: float) -> tuple[Floats, Floats, float]:
    """Return places (N,), increasing, from feet (N,), and how the length follows from the feet.

    That is by weights (N,), and the standard deviation of a foot.
    """
    ends, moves = [0, len(feet) - 1], np.zeros((2, len(feet)))
    moves[[0, 1], ends] = 1.0
    even = _equalize_steps(np.diff(feet), noise_sd)
    fit = None if even is None else fit_penalized_spline(even, feet[:, None], 1)
    if even is None or fit is None or fit.noise_sd > MAX_NOISE_RATIO * noise_sd:
        return _make_increasing(feet), moves[1] - moves[0], noise_sd
    places = fit.curve(even)[:, 0]
    rows = np.asarray(scipy.interpolate.BSpline(fit.curve.t, fit.operator, fit.curve.k)(even[ends]))
    # Many tables end with the tip, at less than a whole step.
    share = np.sqrt(np.maximum(1 - rows[[0, 1], ends], np.finfo(np.float64).tiny))
    is_odd = np.abs(feet - places)[ends] / share > END_STEP_SD * noise_sd
    places[ends] = np.where(is_odd, feet[ends], places[ends])
    rows = np.where(is_odd[:, None], moves, rows)
    return _make_increasing(places), rows[1] - rows[0], fit.noise_sd


def _equalize_steps(steps: Floats, noise_sd: float) -> Floats | None:
    """Return places (N,) from 0 to 1 where steps (N - 1,) that differ by noise alone are equal.

    None if too few do: a table of clusters has equal steps within them, which lead to wrong ends.
    """
    usual = float(np.median(steps))
    alike = np.abs(steps - usual) <= EQUAL_STEP_SD * np.sqrt(2) * noise_sd
    if usual <= 0 or np.mean(alike) < MIN_EQUAL_STEPS:
        return None
    places = np.concatenate([[0.0], np.cumsum(np.where(alike, usual, np.abs(steps)))])
    return places / places[-1]


def _make_increasing(places: Floats) -> Floats:
    """Return places in which those that lie before an earlier one are put between their neighbours."""
    first, last = places[0], places[-1]
    before = np.maximum.accumulate(np.concatenate([[-np.inf], places[:-1]]))
    kept = (places > before) & (places < last) & (places > first)
    kept[[0, -1]] = True
    rows = np.arange(len(places))
    return np.interp(rows, rows[kept], places[kept])
