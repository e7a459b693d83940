"""Find where along the slices' normal a needle lies that runs in or near the slices.

A thick slice shows such a needle at its own middle: centroids of slices follow a staircase. Every slice is
read on its own instead. How bright the needle is in a slice depends on its distance from the slice alone, the
same way on both sides and everywhere along the needle. That profile and a smooth axis are fitted together, so
that partial volume, overlapping slices, saturation and hardening need not be known.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.ndimage import map_coordinates
from scipy.optimize import least_squares

from needlefit.arrays import Bools, Floats
from needlefit.geometry.smoothing_spline import DEGREE, design_matrix, make_knots
from needlefit.imaging.needle.axis_spline import AxisFrames, AxisSpline, correlation_factor
from needlefit.imaging.volume import Volume, to_index

MIN_SLICE_MM = 0.6 + 1e-9  # slices up to this thickness show the needle in several at once
MAX_STEEPNESS = 0.5  # sine of the angle to the slices up to which a needle runs near them
SLICES_AROUND = 3  # slices looked at on either side of the one that holds the axis
REACH_SLICES = 2.0  # distance, in slices beyond the radius, out to which a slice may show the needle
LINE_REACH_MM, LINE_STEP_MM = 2.4, 0.3  # the line across the needle on which a slice is sampled, mm
CORE_MARGIN_MM, RIM_MM = 0.35, 1.7  # the needle shows up to the radius plus this, its surroundings from here
MIN_BRIGHTNESS = 0.3  # stations whose brightest slice shows less of the usual brightness are left out
PROFILE_PIECES = 8  # pieces of the spline by which the profile departs from a rod's in a slice
# Deviations: of the third derivative of a needle's axis over a piece between knots, 1/mm^2; of the logarithms
# of the slices' thickness over their distance, of the profile's exponent, of the brightness, of its change
# along the needle; and of the profile's departure.
JERK_SD, SHAPE_SD, CHANGE_SD, DEPARTURE_SD = 5e-4, np.array([0.25, 0.3, 1.0]), 0.15, 0.05
SHAPE_MEANS = np.array([0.1, np.log(1.3), 0.1])  # rays average before the logarithm: the exponent exceeds 1
CHANGE_LENGTH_MM = 20.0  # length over which brightness may change, mm
STRONG_SMOOTHING = 2.5  # deviation of a slice's number over that of the first, smooth course
FIRST_SD, BRIGHT = (
    0.05,
    0.3,
)  # of the first fit; and what counts as bright: in parts of the needle's
STEP, MAX_STEPS = 1e-4, 15  # step of derivatives, mm, and evaluations of a fit
ROUNDS = 3  # fits, each with the deviations of what the one before left
SOFT_LOSS_SD = 2.0  # residuals beyond so many deviations count less
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


def fit_slices(
    volume: Volume, axis: AxisSpline, diameter: float, knot: float, step: float
) -> SliceFit | None:
    """Fit where along the slices' normal the needle of `diameter` lies, with knots every `knot` mm.

    Brightness is taken every `step` mm. None where too little of the needle shows.
    """
    s = np.arange(0.0, axis.length, step)
    where = slice_frames(volume, axis, s)
    thick, radius = float(volume.spacing[2]), diameter / 2
    away, shown, seen = _read_slices(volume, where, radius)
    knots = make_knots(0.0, axis.length, knot)
    matrix = design_matrix(s, knots)
    count = matrix.shape[1]
    if np.count_nonzero(seen.any(axis=1)) < 2 * count:
        return None
    shown = shown / np.median(np.where(seen, shown, -np.inf).max(axis=1))
    seen &= np.where(seen, shown, 0.0).max(axis=1, keepdims=True) > MIN_BRIGHTNESS
    unique = np.unique(knots)
    jerk = BSpline(knots, np.eye(count), DEGREE).derivative(3)((unique[1:] + unique[:-1]) / 2) / JERK_SD
    # what the axis has to be smooth: its shift alone would keep the staircase that it follows now
    course = np.linalg.lstsq(matrix, (where.origins - where.origins[0]) @ where.v.mean(axis=0))[0]
    bright = np.where(seen, np.clip(shown - 0.1, 0, None), 0.0)
    some = bright.sum(axis=1) > 0
    centroid = (bright * away).sum(axis=1)[some] / bright.sum(axis=1)[some] + (matrix @ course)[some]
    smooth = jerk.T @ jerk * (STRONG_SMOOTHING * thick) ** 2
    start = np.linalg.solve(matrix[some].T @ matrix[some] + smooth, matrix[some].T @ centroid) - course
    nodes = np.linspace(0.0, axis.length, max(2, round(axis.length / CHANGE_LENGTH_MM) + 1))
    change = np.stack([np.interp(s, nodes, one) for one in np.eye(len(nodes))], axis=1)
    problem = _SliceProblem(away, shown, seen, matrix, change, jerk, jerk @ course, thick, radius)
    shift, covariance = problem.fit(start)
    crossed = knot * _steepness(volume, axis) / thick
    systematic = SLICE_ERROR * thick / (1 + (crossed / CROSSED_SLICES) ** 2)
    return SliceFit(BSpline(knots, shift, DEGREE), covariance, systematic)


def _read_slices(volume: Volume, where: AxisFrames, radius: float) -> tuple[Floats, Floats, Bools]:
    """Return how far slices (S, K) lie from the axis along v, mm; the needle in each, HU; and which count."""
    thick = float(volume.spacing[2])
    height = to_index(volume, where.origins)[:, 2]
    slices = np.rint(height)[:, None] + np.arange(-SLICES_AROUND, SLICES_AROUND + 1)
    away = (slices - height[:, None]) * thick / (where.v @ volume.direction[:, 2])[:, None]
    line = np.arange(-LINE_REACH_MM, LINE_REACH_MM + 1e-6, LINE_STEP_MM)
    points = (
        where.origins[:, None, None]
        + away[..., None, None] * where.v[:, None, None]
        + line[:, None] * where.u[:, None, None]
    )
    index = to_index(volume, points.reshape(-1, 3))[:, ::-1].T
    index[0] = np.rint(index[0])  # each slice on its own
    values = map_coordinates(volume.values, index, order=1, cval=np.nan, output=np.float64)
    values = values.reshape(*away.shape, len(line))
    core = values[..., np.abs(line) < radius + CORE_MARGIN_MM].mean(axis=-1)
    shown = core - np.median(values[..., np.abs(line) > RIM_MM], axis=-1)
    seen = np.isfinite(values).all(axis=-1) & (np.abs(away) < REACH_SLICES * thick + radius)
    return away, np.where(seen, shown, 0.0), seen


@dataclass(frozen=True)
class _SliceProblem:
    """How bright slices (S, K) show the needle over their distance `away` from the axis, mm.

    Parameters are the shift's coefficients, the profile's shape (3,), changes of the brightness along the
    needle, and the profile's departure from a rod's in a slice.
    """

    away: Floats
    shown: Floats
    seen: Bools
    matrix: Floats  # (S, C) from the shift's coefficients to the shift
    change: Floats  # (S, H) from changes of the logarithm of the brightness to that
    jerk: Floats  # (J, C) from coefficients to third derivatives, in deviations
    bent: Floats  # (J,); third derivatives of the axis as it is
    thick: float
    radius: float

    @property
    def counts(self) -> list[int]:
        """How many parameters of each kind there are."""
        departures = even_basis(np.zeros(1), self.reach).shape[-1]
        return [self.matrix.shape[1], len(SHAPE_SD), self.change.shape[1], departures]

    @property
    def reach(self) -> float:
        """Distance beyond which a slice does not show the needle, mm."""
        return (REACH_SLICES + 0.5) * self.thick + self.radius

    def split(self, theta: Floats) -> list[Floats]:
        """Return the parameters of each kind."""
        return np.split(theta, np.cumsum(self.counts)[:-1])

    def known(self, theta: Floats) -> Floats:
        """Return what is known before, in its deviations; linear in the parameters."""
        shift, shape, change, departure = self.split(theta)
        return np.concatenate(
            [
                self.jerk @ shift + self.bent,
                (shape - SHAPE_MEANS) / SHAPE_SD,
                change / CHANGE_SD,
                departure / DEPARTURE_SD,
                np.diff(departure) / DEPARTURE_SD,
            ]
        )

    def profile(self, distance: Floats, shape: Floats) -> Floats:
        """Return the part of a rod's section in a slice at a distance, to a power, times the height."""
        width, exponent, height = np.exp(shape)
        half = width * self.thick / 2
        inside = _disc_part((distance + half) / self.radius) - _disc_part((distance - half) / self.radius)
        whole = 2 * _disc_part(np.array(half / self.radius)) - 1
        return np.asarray(height * np.clip(inside / whole, 1e-9, None) ** exponent)

    def show(self, theta: Floats) -> tuple[Floats, Floats]:
        """Return what the slices show (S, K), and its derivatives (S, K, P)."""
        shift, shape, change, departure = self.split(theta)
        distance = self.away - (self.matrix @ shift)[:, None]
        factor = np.exp(self.change @ change)[:, None]

        def whole(distance: Floats, shape: Floats) -> Floats:
            return factor * (self.profile(distance, shape) + even_basis(distance, self.reach) @ departure)

        here = whole(distance, shape)
        slope = (whole(distance + STEP, shape) - whole(distance - STEP, shape)) / (2 * STEP)
        shaped = [(whole(distance, shape + STEP * one) - here) / STEP for one in np.eye(len(shape))]
        parts = [
            -slope[..., None] * self.matrix[:, None],
            np.stack(shaped, axis=-1),
            here[..., None] * self.change[:, None],
            factor[..., None] * even_basis(distance, self.reach),
        ]
        return here, np.concatenate(parts, axis=-1)

    def fit(self, shift: Floats) -> tuple[Floats, Floats]:
        """Return the shift's coefficients (C,) and their covariance (C, C), from a first `shift` (C,) on."""
        rest = sum(self.counts) - len(shift) - len(SHAPE_MEANS)
        theta = np.concatenate([shift, SHAPE_MEANS, np.zeros(rest)])
        known = np.stack([self.known(one) - self.known(0 * one) for one in np.eye(len(theta))], axis=1)
        scale = np.full(self.shown.shape, FIRST_SD)
        for round_ in range(ROUNDS):
            part = scale[self.seen]

            def residuals(theta: Floats, part: Floats = part) -> Floats:
                left = (self.show(theta)[0] - self.shown)[self.seen] / part
                return np.concatenate([left, self.known(theta)])

            def slopes(theta: Floats, part: Floats = part) -> Floats:
                return np.vstack([self.show(theta)[1][self.seen] / part[:, None], known])

            best = least_squares(
                residuals,
                theta,
                slopes,
                loss="soft_l1" if round_ else "linear",
                f_scale=SOFT_LOSS_SD,
                max_nfev=MAX_STEPS,
            )
            theta = best.x
            image = self.show(theta)[0]
            left, bright = np.where(self.seen, image - self.shown, 0.0), image > BRIGHT
            dim, metal = self.seen & ~bright, self.seen & bright
            noise = 1.48 * float(np.median(np.abs(left[dim])))
            error = 1.48 * float(np.median(np.abs(left[metal]) / image[metal]))
            scale = np.hypot(max(noise, 0.005), np.clip(error, 0.01, 0.5) * np.clip(image, 0, None))
            scale *= np.sqrt(correlation_factor(left / scale, len(shift) + self.counts[3]))
        jacobian = np.asarray(best.jac, dtype=np.float64)
        covariance = np.linalg.inv(jacobian.T @ jacobian)[: len(shift), : len(shift)]
        return theta[: len(shift)], np.asarray(covariance)


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
