"""Fit a needle that runs in or near thick slices to their voxels, as a whole.

A thick slice shows such a needle at its own middle: centroids of slices follow a staircase. Every slice is
read on its own instead, along lines across the needle. How bright the needle is in a slice depends on its
distance from the slice alone, the same way on both sides and everywhere along the needle; so does the image
across it. Both profiles and a smooth axis are fitted together, so that partial volume, overlapping slices,
blur and hardening need not be known; what exceeds the scanner's numbers is cut in the model too.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.ndimage import map_coordinates

from needlefit.arrays import Bools, Floats
from needlefit.geometry.smoothing_spline import DEGREE, design_matrix, make_knots
from needlefit.imaging.needle.axis_spline import AxisFrames, AxisSpline, correlation_factor
from needlefit.imaging.volume import Volume, to_index

MIN_SLICE_MM = 0.6 + 1e-9  # slices up to this thickness show the needle in several at once
MAX_STEEPNESS = 0.5  # sine of the angle to the slices up to which a needle runs near them
SLICES_AROUND = 2  # slices looked at on either side of the one that holds the axis
REACH_SLICES = 2.0  # distance, in slices beyond the radius, out to which a slice may show the needle
# The line across the needle on which a slice is sampled, and the distance of such lines, mm.
LINE_REACH_MM, LINE_STEP_MM, STATION_MM = 2.4, 0.4, 1.0
CORE_MARGIN_MM, RIM_MM = 0.35, 1.7  # the needle shows up to the radius plus this, its surroundings from here
PROFILE_PIECES = 8  # pieces of the splines by which the profiles depart from a rod's
# A needle between supports is a beam: the third derivative of its axis is the shear force over its stiffness.
SHEAR_SD_N, STEEL_MPA = 5.0, 200e3
END_MOMENT_MM = 5.0  # lever of that force at the end of what is fitted: the tip itself carries no moment, mm
# Deviations: of the logarithms of the slices' thickness over their distance, of the profile's exponent, of
# the brightness, of its change along the needle; and of the departures of both profiles.
SHAPE_SD, CHANGE_SD, DEPARTURE_SD, ACROSS_SD = np.array([0.25, 0.3, 1.0]), 0.15, 0.05, 0.2
SHAPE_MEANS = np.array([0.1, np.log(1.3), 0.1])  # rays average before the logarithm: the exponent exceeds 1
MEAN_BLUR_MM = 0.45  # blur in the slices from which the profile across the needle departs, mm
CHANGE_LENGTH_MM = 20.0  # length over which brightness may change, mm
STRONG_SMOOTHING = 2.5  # deviation of a slice's number over that of the first, smooth course
BRIGHT = 0.3  # what counts as bright, in parts of the needle's
STEP = 1e-4  # step of derivatives, mm
ROUNDS, STEPS, CONVERGED = 3, 10, 0.01  # fits, each with the scatter the one before left; steps; change
ROBUST_SD = 2.0  # residuals beyond so many deviations count less: rays along the needle hide stretches of it
# What no residual shows, in slices, of a needle that stays in one; it falls with the slices that the needle
# crosses between two knots. Set on volumes of `benchmarks/real_scanners.py --seeds` below 2000.
SLICE_ERROR, CROSSED_SLICES = 0.15, 0.35


@dataclass(frozen=True)
class SliceFit:
    """Shift of the axis along the direction `v` of its frames, and its deviation, as functions of s, mm."""

    shift: BSpline
    covariance: Floats  # (C, C) of the shift's coefficients
    systematic: float  # deviation that no residual shows, mm

    def sd(self, s: Floats) -> Floats:
        """Return the standard deviation (N,) along the slices' normal at `s` (N,), mm."""
        matrix = design_matrix(s, self.shift.t)
        own = np.einsum("nc,cd,nd->n", matrix, self.covariance, matrix)
        return np.asarray(np.sqrt(own + self.systematic**2))


def runs_in_slices(volume: Volume, axis: AxisSpline) -> bool:
    """Return whether slices are thick and the needle, on the whole, runs near them."""
    return float(volume.spacing[2]) > MIN_SLICE_MM and _steepness(volume, axis) < MAX_STEEPNESS


def _steepness(volume: Volume, axis: AxisSpline) -> float:
    first, last = axis.spline(np.array([0.0, axis.length]))
    return abs(float((last - first) @ volume.direction[:, 2])) / float(np.linalg.norm(last - first))


def slice_frames(volume: Volume, axis: AxisSpline, s: Floats) -> AxisFrames:
    """Return frames (S,) whose u lies in the slices, and whose v is nearest to their normal."""
    normal = volume.direction[:, 2]
    tangents = axis.spline.derivative()(s)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    u = np.cross(normal, tangents)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    return AxisFrames(axis.spline(s), tangents, u, np.cross(tangents, u))


def fit_slices(volume: Volume, axis: AxisSpline, diameter: float, knot: float) -> SliceFit | None:
    """Fit where along the slices' normal the needle of `diameter` lies, with knots every `knot` mm.

    None where too little of the needle shows.
    """
    s = np.arange(0.0, axis.length, STATION_MM)
    where = slice_frames(volume, axis, s)
    thick, radius = float(volume.spacing[2]), diameter / 2
    line = np.arange(-LINE_REACH_MM, LINE_REACH_MM + 1e-6, LINE_STEP_MM)
    away, shown, limit, seen = _read_slices(volume, where, line)
    knots = make_knots(0.0, axis.length, knot)
    matrix = design_matrix(s, knots)
    count = matrix.shape[1]
    if np.count_nonzero(seen.any(axis=1)) < 2 * count:
        return None
    near = np.abs(line) < radius + CORE_MARGIN_MM
    core = np.where(seen, shown[..., near].mean(axis=-1), 0.0)
    height = float(np.median(core.max(axis=1)))
    core, shown, limit = core / height, shown / height, limit / height
    unique = np.unique(knots)
    stiffness = STEEL_MPA * np.pi * diameter**4 / 64
    basis = BSpline(knots, np.eye(count), DEGREE)
    third = basis.derivative(3)((unique[1:] + unique[:-1]) / 2)
    bent = np.vstack([third, basis.derivative(2)(unique[-1:]) / END_MOMENT_MM]) * stiffness / SHEAR_SD_N
    # what the axis has to be smooth: its shift alone would keep the staircase that it follows now
    course = np.linalg.lstsq(matrix, (where.origins - where.origins[0]) @ where.v.mean(axis=0))[0]
    bright = np.clip(core - 0.1, 0, None)
    some = bright.sum(axis=1) > BRIGHT
    centroid = (bright * away).sum(axis=1)[some] / bright.sum(axis=1)[some] + (matrix @ course)[some]
    smooth = bent.T @ bent * (STRONG_SMOOTHING * thick) ** 2
    start = np.linalg.solve(matrix[some].T @ matrix[some] + smooth, matrix[some].T @ centroid) - course
    nodes = np.linspace(0.0, axis.length, max(2, round(axis.length / CHANGE_LENGTH_MM) + 1))
    change = np.stack([np.interp(s, nodes, one) for one in np.eye(len(nodes))], axis=1)
    problem = _SliceProblem(
        away, line, shown, limit, seen, matrix, change, bent, bent @ course, thick, radius
    )
    shift, covariance = problem.fit(start)
    crossed = knot * _steepness(volume, axis) / thick
    systematic = SLICE_ERROR * thick / (1 + (crossed / CROSSED_SLICES) ** 2)
    return SliceFit(BSpline(knots, shift, DEGREE), covariance, systematic)


def _read_slices(volume: Volume, where: AxisFrames, line: Floats) -> tuple[Floats, Floats, Floats, Bools]:
    """Return how far slices (S, K) lie from the axis along v, mm; what they show over their surroundings on
    a `line` (U,) along u, (S, K, U), HU; where the scanner's numbers end (S, K), HU; and which count.
    """
    thick = float(volume.spacing[2])
    height = to_index(volume, where.origins)[:, 2]
    slices = np.rint(height)[:, None] + np.arange(-SLICES_AROUND, SLICES_AROUND + 1)
    away = (slices - height[:, None]) * thick / (where.v @ volume.direction[:, 2])[:, None]
    points = (
        where.origins[:, None, None]
        + away[..., None, None] * where.v[:, None, None]
        + line[:, None] * where.u[:, None, None]
    )
    index = to_index(volume, points.reshape(-1, 3))[:, ::-1].T
    index[0] = np.rint(index[0])  # each slice on its own
    values = map_coordinates(volume.values, index, order=1, cval=np.nan, output=np.float64)
    values = values.reshape(*away.shape, len(line))
    top = float(np.nanmax(values)) - 0.5
    ceiling = top if np.count_nonzero(values > top) > 3 else np.inf
    level = np.median(values[..., np.abs(line) > RIM_MM], axis=-1)
    seen = np.isfinite(values).all(axis=-1) & (np.abs(away) < (REACH_SLICES + 0.5) * thick)
    shown = np.where(seen[..., None], values - level[..., None], 0.0)
    return away, shown, np.where(seen, ceiling - level, np.inf), seen


@dataclass(frozen=True)
class _SliceProblem:
    """What slices (S, K) show of the needle over their distance `away` from the axis, mm, on a `line` (U,).

    Parameters are the shift's coefficients, the profile's shape (3,), changes of the brightness along the
    needle, the profile's departure from a rod's in a slice, and the profile across the needle.
    """

    away: Floats
    line: Floats
    shown: Floats  # (S, K, U)
    limit: Floats  # (S, K); the largest that the scanner shows
    seen: Bools
    matrix: Floats  # (S, C) from the shift's coefficients to the shift
    change: Floats  # (S, H) from changes of the logarithm of the brightness to that
    bent: Floats  # (J, C) from coefficients to shear forces, in deviations
    before: Floats  # (J,); those of the axis as it is
    thick: float
    radius: float

    @property
    def counts(self) -> list[int]:
        """How many parameters of each kind there are."""
        departures = even_basis(np.zeros(1), 1.0).shape[-1]
        return [self.matrix.shape[1], len(SHAPE_SD), self.change.shape[1], departures, departures]

    @property
    def reach(self) -> float:
        """Distance beyond which a slice does not show the needle, mm."""
        return (REACH_SLICES + 0.5) * self.thick + self.radius

    def split(self, theta: Floats) -> list[Floats]:
        """Return the parameters of each kind."""
        return np.split(theta, np.cumsum(self.counts)[:-1])

    def mean_across(self) -> Floats:
        """Return the coefficients of the image of a rod across it, 1 in the middle."""
        x = np.linspace(0, LINE_REACH_MM, 60)
        image = np.exp(-(x**2) / (2 * (MEAN_BLUR_MM**2 + self.radius**2 / 4)))
        return np.asarray(np.linalg.lstsq(even_basis(x, LINE_REACH_MM), image)[0])

    def known(self, theta: Floats) -> Floats:
        """Return what is known before, in its deviations; linear in the parameters."""
        shift, shape, change, departure, across = self.split(theta)
        return np.concatenate(
            [
                self.bent @ shift + self.before,
                (shape - SHAPE_MEANS) / SHAPE_SD,
                change / CHANGE_SD,
                departure / DEPARTURE_SD,
                np.diff(departure) / DEPARTURE_SD,
                (across - self.mean_across()) / ACROSS_SD,
            ]
        )

    def profile(self, distance: Floats, shape: Floats) -> Floats:
        """Return the part of a rod's section in a slice at a distance, to a power, times the height."""
        width, exponent, height = np.exp(shape)
        half = width * self.thick / 2
        inside = _disc_part((distance + half) / self.radius) - _disc_part((distance - half) / self.radius)
        whole = 2 * _disc_part(np.array(half / self.radius)) - 1
        return np.asarray(height * np.clip(inside / whole, 1e-9, None) ** exponent)

    def whole(self, distance: Floats, theta: Floats) -> Floats:
        """Return how bright slices (S, K) at a `distance` from the axis show its middle."""
        _, shape, change, departure, _ = self.split(theta)
        bright = self.profile(distance, shape) + even_basis(distance, self.reach) @ departure
        return np.asarray(np.exp(self.change @ change)[:, None] * bright)

    def place(self, theta: Floats) -> Floats:
        """Return how far slices (S, K) lie from the shifted axis, mm."""
        return np.asarray(self.away - (self.matrix @ self.split(theta)[0])[:, None])

    def show(self, theta: Floats) -> Floats:
        """Return what the slices show (S, K, U)."""
        beside = even_basis(self.line, LINE_REACH_MM) @ self.split(theta)[-1]
        return np.minimum(self.whole(self.place(theta), theta)[..., None] * beside, self.limit[..., None])

    def slopes(self, theta: Floats) -> Floats:
        """Return the derivatives of what the slices show (S, K, U, P)."""
        shift, shape, change, _, across = self.split(theta)
        distance, factor = self.place(theta), np.exp(self.change @ change)[:, None]
        here, basis = self.whole(distance, theta), even_basis(self.line, LINE_REACH_MM)
        ahead, behind = self.whole(distance + STEP, theta), self.whole(distance - STEP, theta)
        lean = np.eye(len(theta))[len(shift) : len(shift) + len(shape)] * STEP
        parts = [
            -((ahead - behind) / (2 * STEP))[..., None] * self.matrix[:, None],
            np.stack([(self.whole(distance, theta + one) - here) / STEP for one in lean], axis=-1),
            here[..., None] * self.change[:, None],
            factor[..., None] * even_basis(distance, self.reach),
        ]
        in_slice, beside = np.concatenate(parts, axis=-1), basis @ across
        slopes = [in_slice[:, :, None] * beside[:, None], here[..., None, None] * basis]
        cut = here[..., None] * beside > self.limit[..., None]
        return np.where(cut[..., None], 0.0, np.concatenate(slopes, axis=-1))

    def fit(self, shift: Floats) -> tuple[Floats, Floats]:
        """Return the shift's coefficients (C,) and their covariance (C, C), from a first `shift` (C,) on."""
        count, *_, changes, departures, _ = self.counts
        theta = np.concatenate([shift, SHAPE_MEANS, np.zeros(changes + departures), self.mean_across()])
        known = np.stack([self.known(one) - self.known(0 * one) for one in np.eye(len(theta))], axis=1)
        scale, factor = np.full(self.shown.shape, 0.1), 1.0
        seen = np.broadcast_to(self.seen[..., None], self.shown.shape)

        def misfit(theta: Floats) -> float:
            left = ((self.show(theta) - self.shown) / scale)[seen]
            cost = ROBUST_SD**2 * np.sum(np.log1p((left / ROBUST_SD) ** 2)) / factor
            return float(cost + np.sum(self.known(theta) ** 2))

        for _ in range(ROUNDS):
            cost, damping = misfit(theta), 1e-3
            for _ in range(STEPS):
                left = np.where(seen, (self.shown - self.show(theta)) / scale, 0.0)
                weights = np.where(seen, 1 / (1 + (left / ROBUST_SD) ** 2) / factor, 0.0)
                jacobian = (self.slopes(theta) / scale[..., None]).reshape(-1, len(theta))
                weighted = jacobian * weights.reshape(-1, 1)
                normal = weighted.T @ jacobian + known.T @ known
                pull = weighted.T @ left.ravel() - known.T @ self.known(theta)
                before = cost
                while damping < 1e6:
                    step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), pull)
                    if (after := misfit(theta + step)) < cost:
                        theta, cost, damping = theta + step, after, damping / 10
                        break
                    damping *= 10
                if before - cost < CONVERGED:
                    break
            image = self.show(theta)
            left, bright = np.where(seen, image - self.shown, 0.0), seen & (image > BRIGHT)
            noise = 1.48 * float(np.median(np.abs(left[seen & ~bright])))
            error = 1.48 * float(np.median(np.abs(left[bright]) / image[bright]))
            scale = np.hypot(max(noise, 0.005), np.clip(error, 0.01, 0.5) * np.clip(image, 0, None))
            left = left / scale / np.sqrt(1 + (left / scale / ROBUST_SD) ** 2)
            factor = correlation_factor(left.reshape(len(left), -1), count + departures)
            factor *= correlation_factor(np.moveaxis(left, 2, 0).reshape(len(self.line), -1), 3)
        return theta[:count], np.linalg.inv(normal)[:count, :count]


def _disc_part(x: Floats) -> Floats:
    """Return the part of a disc's area below `x` radii."""
    x = np.clip(x, -1, 1)
    return np.asarray(0.5 + (x * np.sqrt(1 - x * x) + np.arcsin(x)) / np.pi)


def even_basis(x: Floats, reach: float) -> Floats:
    """Return even cubic splines (..., E) of `x` out to `reach`."""
    knots = make_knots(-reach, reach, reach / PROFILE_PIECES)
    places = np.clip(x, -reach, reach)
    both = design_matrix(places.ravel(), knots)
    both = (both + both[:, ::-1])[:, : (both.shape[1] + 1) // 2]
    return both.reshape(*x.shape, -1)
