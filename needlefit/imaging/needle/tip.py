"""Find the needle's tip: fit the image of a bevelled rod to the voxels around the end, and check it.

A scanner shows the rod times its modulation transfer (`point_spread`). Coordinates are the needle's: s along
it from the tip, u and v across.

Blur, overshoot, the slices' blur and the metal's height are fitted with the tip, held by what balls in the
scan show of them and by what metal and scanners can have. So is the dark streak that rays along the shaft
leave beyond its end.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfftn, next_fast_len, rfftn
from scipy.ndimage import map_coordinates
from scipy.optimize import OptimizeResult, least_squares
from scipy.spatial import cKDTree
from scipy.special import erf

from needlefit.arrays import Floats, Ints
from needlefit.imaging.constants import HU, MM, PART, SD
from needlefit.imaging.needle.axis_spline import AxisSpline, axis_frames, axis_sd
from needlefit.imaging.point_spread import (
    HIGHEST,
    LOWEST,
    MAX_FITTED_VOXELS,
    PointSpread,
    expected_spread,
    read_spread,
)
from needlefit.imaging.volume import Volume, list_voxels_near, to_patient
from needlefit.schemas.reconstruction import ScannedNeedleRecord

Singles = NDArray[np.float32]

GRID_STEP_MM = 0.25  # spacing of the points on which the rod is modelled, mm
FIBRES = 6  # fibres along the needle into which a grid's step is parted, in each direction across


@dataclass(frozen=True)
class RodModel:
    """Images of a rod of `radius`, from `back` behind to `ahead` of its tip and out to `aside`, mm.

    `normal` (3,) is the slices' normal along s, u and v.
    """

    radius: float
    back: float
    ahead: float
    aside: float
    normal: tuple[float, float, float]

    @cached_property
    def _axes(self) -> tuple[Floats, Floats]:
        """Points along s, and along u and v: the transform repeats, and the blur must not reach round."""
        count = next_fast_len(int((self.back + self.ahead + 2 * MM.BLUR_REACH) / GRID_STEP_MM) + 1, real=True)
        half = next_fast_len(int(2 * (self.aside + MM.BLUR_REACH) / GRID_STEP_MM) + 1, real=True)
        along: Floats = -self.back - MM.BLUR_REACH + np.arange(count, dtype=np.float64) * GRID_STEP_MM
        across: Floats = (np.arange(half, dtype=np.float64) - half // 2) * GRID_STEP_MM
        return along, across

    @cached_property
    def _squares(self) -> tuple[Singles, Singles, Singles]:
        """Squared angular frequencies in the slices, those across, 1/mm, and the filter of cubic splines."""
        along, across = self._axes
        turns = [2 * np.pi * np.fft.fftfreq(len(a), GRID_STEP_MM) for a in (along, across)]
        last = 2 * np.pi * np.fft.rfftfreq(len(across), GRID_STEP_MM)
        k = np.meshgrid(turns[0], turns[1], last, indexing="ij", sparse=True)
        normal = sum(a * n for a, n in zip(k, self.normal, strict=True))
        total = sum(a**2 for a in k)
        spline = 1.0
        for a in k:
            spline = spline * 3 / (2 + np.cos(a * GRID_STEP_MM))
        return (
            np.asarray(total - normal**2, dtype=np.float32),
            np.asarray(normal, dtype=np.float32),
            np.asarray(spline, dtype=np.float32),
        )

    def _transform(self, roll: float, cotangent: float) -> NDArray[np.complex64]:
        """Return the Fourier transform of the rod, its bevel's point at the angle `roll` from u."""
        along, across = self._axes
        (rows, columns), fibres, weights = self._fibres
        u, v = fibres
        cut = (self.radius - (u * np.cos(roll) + v * np.sin(roll))) * cotangent
        ends = np.clip((-cut[None] - along[:, None, None]) / GRID_STEP_MM + 0.5, 0, 1)
        solid = np.zeros((len(along), len(across), len(across)), dtype=np.float32)
        solid[:, rows, columns] = np.mean(ends * weights, axis=2)
        solid[along < along[0] + MM.BLUR_REACH / 2] = 0
        return rfftn(solid)

    @cached_property
    def _fibres(self) -> tuple[tuple[Ints, Ints], Floats, Floats]:
        """Points across (C,) with metal, u and v (2, C, F) of the fibres around each, and their part."""
        _, across = self._axes
        fine = (np.arange(FIBRES) + 0.5) / FIBRES - 0.5
        part = np.stack(np.meshgrid(fine, fine, indexing="ij")).reshape(2, -1) * GRID_STEP_MM
        near = np.hypot(across[:, None], across) < self.radius + GRID_STEP_MM
        rows, columns = np.nonzero(near)
        fibres = np.stack([across[rows], across[columns]])[..., None] + part[:, None]
        inside = (self.radius - np.hypot(*fibres)) / (GRID_STEP_MM / FIBRES) + 0.5
        return (rows, columns), fibres, np.clip(inside, 0, 1)

    @cached_property
    def _splines(self) -> Callable[[float, float, PointSpread], Singles]:
        """Spline coefficients of the blurred rod of height 1; of a step's derivatives most are of one rod."""
        in_slice, normal, spline = self._squares
        transform = lru_cache(maxsize=4)(self._transform)
        along, across = self._axes
        shape = (len(along), len(across), len(across))

        @lru_cache(maxsize=8)
        def blur(roll: float, cotangent: float, spread: PointSpread) -> Singles:
            passed = spread.pass_in_slices(in_slice) * spread.pass_across(normal) * spline
            return irfftn(transform(roll, cotangent) * passed, shape)

        return blur

    def image(self, roll: float, cotangent: float, spread: PointSpread, places: Floats) -> Floats:
        """Return the image (N,) of a rod of height 1 at places s, u, v (3, N) from its tip."""
        along, across = self._axes
        at = (places - np.array([along[0], across[0], across[0]])[:, None]) / GRID_STEP_MM
        splines = self._splines(roll, cotangent, spread)
        return np.asarray(map_coordinates(splines, at, order=3, mode="nearest", prefilter=False), float)


# What the 11 parameters are: end along the axis, roll of the bevel, swing across, mm, rad; logarithm of the
# metal's height, and the background, HU; cotangent of the bevel; logarithms of the blurs in and across
# slices, mm, and between them the kernel's boost; the streak beyond the end, HU.
TIP, ROLL, U, V, HEIGHT, LEVEL, COT, BLUR, _, SLICE, STREAK = range(11)
SPREAD = slice(7, 10)
# How far the fit reaches back from the bevel's heel, mm.
REACH_BEFORE_MM = 3.0  # mm
CORE_REACH_MM = 0.9  # radius from which on voxels count less, mm: streaks
START_OFFSETS_MM = np.arange(
    -0.8, 0.9, 0.4
)  # around the first guess, at which the side of the bevel is tried
ROUGH_STEPS = 8  # of a first fit
STEPS = 30  # of a last fit
DERIVATIVE_STEP = np.array(1e-3)  # relative step of the derivatives
MAX_BEVEL_DEG = 85.0  # a bevel steeper than this has no side
ROLL_FACTOR = 3.0  # of the roll's deviation: artefacts near the tip
ROLL_SD = 0.15  # of the roll, rad, that no residual shows
HEIGHT_SD = 0.7  # deviation of the logarithm of the metal's brightness
LOWER_BOUNDS = np.array([*4 * [-np.inf], np.log(4e3), -1100, 0, *LOWEST, -3000])
UPPER_BOUNDS = np.array([*4 * [np.inf], np.log(5e4), 1000, 6, *HIGHEST, 3000])
# Bounds and typical changes of the parameters. No metal of needles exceeds 50 000 HU.
PARAMETER_SCALES = np.array([0.2, 0.3, 0.1, 0.1, 0.1, 50, 0.3, 0.1, 0.3, 0.2, 100])
HELD = [U, V, HEIGHT, COT, *range(7, 10), STREAK]  # parameters of which something is known before
# Deviations of the stated angle from which on the image contradicts it: right ones at most 1.0, bevels of 20
# and 60 degrees for 30 have 3.0.
MAX_BEVEL_PULL_SD = 2.5


@dataclass(frozen=True)
class AxisVoxels:
    """Voxels near the axis: position along, `s` (N,), across, `u`, `v` (N,), mm; their `values` (N,), HU."""

    s: Floats
    u: Floats
    v: Floats
    values: Floats


def side_probability(roll_sd: float) -> float:
    """Return the probability that a bevel's point lies within 90 degrees of a roll of deviation `roll_sd`."""
    return float(erf(np.pi / 2 / np.sqrt(2) / roll_sd))


def bevel_length(needle: ScannedNeedleRecord) -> float:
    """Return the length of the bevel: how far behind the point the tip is cut, mm."""
    return needle.diameter_mm / float(np.tan(np.deg2rad(needle.bevel_deg)))


class TipProblem:
    """The voxels around a tip, the model and what is known before."""

    def __init__(
        self,
        volume: Volume,
        axis: AxisSpline,
        needle: ScannedNeedleRecord,
        guess: float,
        spread: PointSpread | None,
    ) -> None:
        heel = bevel_length(needle)
        near = select_axis_voxels(volume, axis, guess - heel - REACH_BEFORE_MM, guess + MM.BEYOND_END)
        every = int(np.ceil(len(near.s) / MAX_FITTED_VOXELS))
        self.near = AxisVoxels(*(x[::every] for x in (near.s, near.u, near.v, near.values)))
        self.volume, self.axis, self.guess, self.radius = volume, axis, guess, needle.diameter_mm / 2
        self.rolled = needle.bevel_deg < MAX_BEVEL_DEG
        frame, normal = axis_frames(axis, np.array([guess])), volume.grid.normal
        # the tip may be found 4 mm from where it is looked for
        back, ahead = heel + REACH_BEFORE_MM + MM.BEYOND_END, 2 * MM.BEYOND_END
        slices = (float(frame.tangents[0] @ normal), float(frame.u[0] @ normal), float(frame.v[0] @ normal))
        self.rod = RodModel(needle.diameter_mm / 2, back, ahead, MM.PATCH + 0.5, slices)
        top = float(near.values.max())  # where several voxels share it the scanner's numbers end
        self.ceiling = top if np.count_nonzero(near.values == top) > 3 else volume.resampled_top or np.inf
        self.level = float(np.median(near.values[np.hypot(near.u, near.v) > 0.8 * MM.PATCH]))
        self.swing = np.clip((self.near.s - axis.length) / max(guess - axis.length, 0.25), 0, None)
        swing_sd = float(np.hypot(MM.SWING_SD, axis_sd(axis, np.array([axis.length]))[0]))
        # the longer the rays within one slice that run along its end, where it lies flattest, the less of the
        # image is the bevel's
        end = axis_frames(axis, np.linspace(max(0.0, axis.length - MM.HIDDEN), axis.length, 16))
        steep = max(float(np.abs(end.tangents @ normal).min()), 1e-6)
        ray = min(2 * MM.HIDDEN, (needle.diameter_mm + volume.grid.slice_distance) / steep)
        cot = heel / needle.diameter_mm
        cot_sd = np.deg2rad(needle.bevel_sd_deg) * (1 + cot**2) / np.hypot(1.0, ray / MM.BEVEL_RAY)
        known = spread or expected_spread(volume.grid.slice_distance)
        # means and deviations of the parameters `HELD`
        self.means = np.array([0.0, 0.0, np.log(HU.NEEDLE), cot, *known.parameters, 0.0])
        sds = (swing_sd, swing_sd, HEIGHT_SD, cot_sd, *known.sds, HU.STREAK_SD)
        self.sds = np.array(sds)
        low, high = LOWER_BOUNDS.copy(), UPPER_BOUNDS.copy()
        # beyond what is known before artefacts would be taken for the needle's image
        low[HELD] = np.maximum(low[HELD], self.means - SD.DISAGREEMENT * self.sds)
        high[HELD] = np.minimum(high[HELD], self.means + SD.DISAGREEMENT * self.sds)
        self.bounds = low, high
        core = np.sqrt(1 + (np.hypot(self.near.u, self.near.v) / CORE_REACH_MM) ** 4)
        metal = np.clip(self.near.values - self.level, 0, None)
        beyond, noise = near.values[near.s > guess + 0.5 * MM.BEYOND_END], 50.0
        if beyond.size >= 20:
            noise = max(10.0, 1.48 * float(np.median(np.abs(beyond - np.median(beyond)))))
        self.sigma = core * np.hypot(noise, PART.SIGNAL_ERROR * metal)

    def show(self, theta: Floats, s: Floats, u: Floats, v: Floats) -> Floats:
        """Return what the scanner shows (N,), HU, at places from the tip."""
        spread = read_spread(theta[SPREAD])
        streak = np.exp(-np.maximum(s, 0) / MM.STREAK_LENGTH - (u**2 + v**2) / (2 * MM.STREAK_RADIUS**2))
        image = self.rod.image(float(theta[ROLL]), float(theta[COT]), spread, np.stack([s, u, v]))
        shown = theta[LEVEL] + np.exp(theta[HEIGHT]) * image + theta[STREAK] * streak
        return np.clip(shown, HU.FLOOR, self.ceiling)

    def residuals(self, theta: Floats) -> Floats:
        """Return voxels and what is known, both in their deviations."""
        near = self.near
        u, v = near.u - theta[U] * self.swing, near.v - theta[V] * self.swing
        left = (self.show(theta, near.s - theta[TIP], u, v) - near.values) / self.sigma
        return np.append(left, (theta[HELD] - self.means) / self.sds)

    def search(self) -> OptimizeResult:
        """Return a few steps of the least squares from the best of several ends and sides of the bevel."""
        first = np.zeros(11)
        first[TIP], first[LEVEL] = self.guess, self.level
        first[HELD] = self.means

        def misfit(start: Floats) -> float:
            return float(np.sum(np.minimum(np.abs(self.residuals(start)), 20)))

        unit, rolls = np.eye(11), np.arange(6) * np.pi / 3 if self.rolled else [0.0]
        starts = [
            first + shift * unit[TIP] + roll * unit[ROLL] for roll in rolls for shift in START_OFFSETS_MM
        ]
        return self._minimize(min(starts, key=misfit), ROUGH_STEPS)

    def fit(self, start: Floats) -> OptimizeResult:
        """Return the least squares near `start` (11,), with the deviations that it leaves.

        Voxels in one blur count as one.
        """
        left = 1.48 * float(np.median(np.abs(self.residuals(start)[: len(self.near.s)])))
        blurs = 8 * float(np.exp(2 * start[BLUR] + start[SLICE])) / float(np.prod(self.volume.spacing))
        self.sigma = self.sigma * max(1.0, left) * np.sqrt(max(1.0, blurs))
        return self._minimize(start, STEPS)

    def free_bevel(self, best: OptimizeResult) -> tuple[OptimizeResult, float]:
        """Return the fit, and, degrees, the angle of the bevel where the image contradicts the stated one.

        There it is fitted freely, and the fit kept if the image is clearly nearer; else the angle is nan.
        """
        known = HELD.index(COT)
        if abs(best.x[COT] - self.means[known]) <= MAX_BEVEL_PULL_SD * self.sds[known]:
            return best, np.nan
        stated, self.sds[known] = self.sds[known], np.inf
        self.bounds[0][COT], self.bounds[1][COT] = LOWER_BOUNDS[COT], UPPER_BOUNDS[COT]
        starts = (best.x, best.x + np.pi * np.eye(11)[ROLL])
        free = min((self._minimize(start, STEPS) for start in starts), key=lambda fitted: fitted.cost)
        if self.misfit(free.x) < PART.BEVEL_MISFIT * self.misfit(best.x):
            contradicted = abs(free.x[COT] - self.means[known]) > MAX_BEVEL_PULL_SD * stated
            return free, float(np.degrees(np.arctan2(1.0, free.x[COT]))) if contradicted else np.nan
        self.sds[known] = stated
        return best, np.nan

    def _minimize(self, start: Floats, steps: int) -> OptimizeResult:
        return least_squares(
            self.residuals,
            np.clip(start, self.bounds[0] + 1e-6, self.bounds[1] - 1e-6),
            bounds=self.bounds,
            loss="soft_l1",
            f_scale=SD.DISAGREEMENT,
            x_scale=PARAMETER_SCALES,
            diff_step=DERIVATIVE_STEP,
            ftol=PART.TOLERANCE,
            xtol=PART.TOLERANCE,
            gtol=PART.TOLERANCE,
            max_nfev=steps,
        )

    def misfit(self, theta: Floats) -> float:
        """Return how far the image around the end is from the model, in parts of its brightness."""
        near = self.near
        u, v = near.u - theta[U] * self.swing, near.v - theta[V] * self.swing
        shown, inner = self.show(theta, near.s - theta[TIP], u, v), np.hypot(u, v) < 2 * self.radius
        left, over = (shown - near.values)[inner], (shown - theta[LEVEL])[inner]
        return float(np.linalg.norm(left) / np.linalg.norm(over))


def select_axis_voxels(volume: Volume, axis: AxisSpline, start: float, stop: float) -> AxisVoxels:
    """Return the voxels within `MM.PATCH` of the axis between `start` and `stop` (mm along it)."""
    fine = np.arange(start - 1, stop + 1, 0.1)
    where = axis_frames(axis, fine)
    ijk, values = list_voxels_near(volume, where.origins, MM.PATCH)
    points = to_patient(volume, ijk)
    distance, nearest = cKDTree(where.origins).query(points, distance_upper_bound=MM.PATCH + 0.1)
    close = np.isfinite(distance)
    at = np.asarray(nearest)[close]
    d = points[close] - where.origins[at]
    along = np.einsum("ni,ni->n", d, where.tangents[at])
    s = fine[at] + along
    u, v = np.einsum("ni,ni->n", d, where.u[at]), np.einsum("ni,ni->n", d, where.v[at])
    inside = (s >= start) & (s <= stop) & (np.abs(along) < 0.2)
    return AxisVoxels(s[inside], u[inside], v[inside], values[close][inside])


MIN_BEVEL_PROBABILITY = 0.95  # probability from which on the side of the bevel is stated


@dataclass(frozen=True)
class TipFit:
    """The fitted tip."""

    at: float  # along the spine, mm
    point: Floats  # (3,); in the patient, mm; beside the spine, if the rod swung
    sd: Floats  # (2,); deviations along the needle, and across it in either direction, mm
    # (3,); unit vector across the needle to the side of the bevel's point; nan for a blunt end, or if its
    # probability is below `MIN_BEVEL_PROBABILITY`.
    bevel: Floats
    bevel_probability: float  # that the likeliest side is right, within 90 degrees; nan for a blunt end
    misfit: float = 0.0  # how far the image is from the model, in parts of its brightness
    bevel_deg: float = np.nan  # angle of the bevel as the image shows it, where it contradicts the stated one


def search_tip(
    volume: Volume, axis: AxisSpline, needle: ScannedNeedleRecord, guess: float, spread: PointSpread | None
) -> Floats:
    """Return about where the tip lies, and how the scan shows it: parameters (11,) to begin a fit with."""
    return np.asarray(TipProblem(volume, axis, needle, guess, spread).search().x, float)


def fit_tip(
    volume: Volume, axis: AxisSpline, needle: ScannedNeedleRecord, start: Floats, spread: PointSpread | None
) -> TipFit:
    """Fit the tip near `start` (11,) of `search_tip` by least squares over the voxels around it.

    The tip is where the axis ends that reaches as far as the bevel's point does. The rod is moved along the
    axis, rolled about it, and swung across it from the last cross-section on; the bevel's angle is the
    recipe's within its deviation.

    `spread` is the scanner's, as balls in the same volume show it.
    """
    problem = TipProblem(volume, axis, needle, float(start[TIP]), spread)
    best, bevel_deg = problem.free_bevel(problem.fit(start))
    normal = best.jac.T @ best.jac
    variance = np.diag(np.linalg.inv(normal + 1e-9 * np.diag(np.maximum(np.diag(normal), 1e-9))))
    at = float(best.x[TIP])
    there = axis_frames(axis, np.array([at]))
    spacing = float(np.linalg.norm(volume.direction.T @ there.tangents[0] * volume.spacing))
    along = float(np.linalg.norm([np.sqrt(variance[TIP]), MM.TIP_SD, PART.TIP_SD * spacing]))
    heel = float(axis_sd(axis, np.array([axis.length]))[0])  # from where the rod swings
    across = float(np.linalg.norm([np.sqrt(variance[[U, V]].mean()), heel, MM.TIP_ACROSS_SD]))
    u, v, roll = there.u[0], there.v[0], best.x[ROLL]
    roll_sd = float(np.hypot(ROLL_FACTOR * np.sqrt(variance[ROLL]), ROLL_SD))
    probability = side_probability(roll_sd) if problem.rolled else np.nan
    sided = probability >= MIN_BEVEL_PROBABILITY
    bevel = np.cos(roll) * u + np.sin(roll) * v if sided else np.full(3, np.nan)
    point = there.origins[0] + best.x[U] * u + best.x[V] * v
    sd = np.array([along, across])
    return TipFit(at, point, sd, bevel, float(probability), problem.misfit(best.x), bevel_deg)
