"""The problem of a needle's tip: the voxels around its end, the model of them, and what is known before.

Blur, overshoot, the slices' blur and the metal's height are fitted with the tip, held by what balls in the
scan show of them and by what metal and scanners can have: of a needle that is cut low its image alone leaves
them open. Where rays run along the shaft, the hardened beam sees it darker than its end, and a dark streak
beyond: both are fitted.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares
from scipy.spatial import cKDTree

from needlefit.arrays import Floats
from needlefit.imaging.needle.axis_spline import (
    AxisSpline,
    axis_frames,
    axis_sd,
    disc_points,
    sample_planes,
)
from needlefit.imaging.needle.tip_model import CachedRod, RodModel
from needlefit.imaging.sphere_profile import PointSpread, expected_slice_blur
from needlefit.imaging.volume import Volume, to_index, to_patient
from needlefit.schemas.reconstruction import ScannedNeedleRecord

TIP, ROLL, U, V, HEIGHT, LEVEL, COT, BLUR, BOOST, SLICE, DARK, STREAK = range(12)
"""What the 12 parameters are: end along the axis, roll of the bevel, swing across, mm, rad; logarithm of the
metal's height at the tip, and the background, HU; cotangent of the bevel; logarithms of the blurs in and
across slices, mm, and between them the kernel's boost; by which factor's logarithm the shaft is darker than
its end; the streak beyond it, HU."""

REACH_BEFORE_MM, REACH_AFTER_MM = 3.0, 4.0
"""How far the fit reaches back from the bevel's heel, and on from the first guess of the tip, mm."""

RADIAL_REACH_MM, CORE_REACH_MM = 2.4, 0.9
"""Radius around the axis that the fit uses, mm, and that from which on voxels count less: streaks."""

DARKENING_LENGTH_MM = 1.5
"""Length over which the end of a shaft is brighter than the rest, mm: about a needle's width."""

STREAK_LENGTH_MM, STREAK_RADIUS_MM = 2.0, 0.8
"""Length over which a streak beyond the tip fades, and its deviation across, mm."""

START_OFFSETS_MM = np.arange(-3.0, 3.1, 0.75)
"""Starting points of the search around the first guess, mm."""

FINE_OFFSETS_MM = np.arange(-0.8, 0.9, 0.4)
"""Positions around the best of these at which the side of the bevel is tried, mm."""

SOFT_LOSS_SD = 3.0
"""Residuals beyond so many deviations of the noise count less."""

SIGNAL_ERROR = 0.04
"""Deviation of what a voxel shows of metal, in parts of that: the model's own error."""

MAX_VOXELS = 4000
"""Of more voxels, every second, third ... is taken: neighbours in fine voxels say the same."""

ROUGH_STEPS, STEPS = 8, 30
"""Evaluations of the derivatives of a first and of a last fit."""

BLOCK_LENGTH_MM = 2.0
"""Length of the blocks of voxels whose residuals go together, mm."""

EDGE_SD_MM = 0.03
"""What no voxel determines of the place along, mm: a scanner's edge is not the model's."""

BLUNT_COTANGENT_SD = 1e-3
"""Deviation of the cotangent of a blunt end's angle."""

DERIVATIVE_STEP = np.array(1e-3)
"""Relative step of the derivatives."""

MAX_BEVEL_DEG = 85.0
"""A bevel steeper than this has no side."""

ARTEFACT_FACTOR = 30.0
"""By which artefacts near the tip weaken what its image shows of the bevel, beyond the blocks' errors. Set on
the part `tuning` of `benchmarks/real_scanners.py`: with it none of the sides stated there is wrong."""

ROLL_STEPS = 24
"""Angles of the bevel, all round, at which its likelihood is evaluated."""

MEAN_HEIGHT_HU, HEIGHT_SD = 20_000.0, 0.7
"""Metal, HU, and the deviation of its logarithm: titanium has 8 000, steel 30 000, hardened 15 000."""

MEAN_BLUR_MM, BLUR_SD, MEAN_BOOST, BOOST_SD, SLICE_BLUR_SD = 0.45, 0.3, 0.5, 1.0, 0.5
"""Scanners' blur and boost and their deviations (of logarithms for blurs)."""

BALL_BLUR_SD, BALL_BOOST_SD, BALL_SLICE_BLUR_SD = 0.04, 0.15, 0.08
"""Deviations of these where balls in the same scan show them."""

SWING_SD_MM = 0.1
"""Deviation by which a needle leaves, within the length of its bevel, the course of its shaft, mm."""

STREAK_SD_HU, DARK_SD_PER_MM, MIN_DARK_SD, MAX_DARK_SD = 2000.0, 0.02, 0.05, 0.5
"""Deviations of the streak, and of the darkening: by the length of the needle that rays pass."""

BEVEL_RAY_MM = 6.0
"""From so much of the needle on that rays pass, its image shows them rather than the bevel's angle, mm.
Set, as those of the darkening, on the part `tuning` of `benchmarks/real_scanners.py`, on further volumes of
its renderer with needles in the slices, and on clean scans of `benchmarks/reconstruction.py --seed 5001`."""

END_LENGTH_MM = 15.0
"""Length of a needle's end, mm, along which rays hide its tip."""

MAX_RAY_MM = 30.0
"""Rays pass more of a needle in the slices than counts: it is bent, mm."""

FLOOR_HU = -1024.0
"""Where scanners' numbers begin, HU."""

LOWER_BOUNDS = np.array(
    [*4 * [-np.inf], np.log(4e3), -1100, 0, np.log(0.15), -0.2, np.log(0.08), -0.3, -3000]
)
UPPER_BOUNDS = np.array([*4 * [np.inf], np.log(5e4), 1000, 6, np.log(1.2), 5, np.log(2), 2, 3000])
PARAMETER_SCALES = np.array([0.2, 0.3, 0.1, 0.1, 0.1, 50, 0.3, 0.1, 0.3, 0.2, 0.1, 100])
"""Bounds and typical changes of the parameters. No metal of needles exceeds 50 000 HU."""

HELD = [U, V, HEIGHT, COT, BLUR, BOOST, SLICE, DARK, STREAK]
"""Parameters of which something is known before."""


MAX_PRIOR_SD = 3.0
"""What is known before is not left by more deviations: artefacts would be taken for the needle's image."""


@dataclass(frozen=True)
class AxisVoxels:
    """Voxels near the axis: position along, `s` (N,), across, `u`, `v` (N,), mm; their `values` (N,), HU."""

    s: Floats
    u: Floats
    v: Floats
    values: Floats


def measure_ray(volume: Volume, axis: AxisSpline, needle: ScannedNeedleRecord) -> float:
    """Return the length of the needle that rays within one slice pass along its end, mm.

    Where the needle lies flattest: its direction right at a hidden end is what is least known.
    """
    s = np.linspace(max(0.0, axis.length - END_LENGTH_MM), axis.length, 16)
    steep = float(np.abs(axis_frames(axis, s).tangents @ volume.direction[:, 2]).min())
    thick = needle.diameter_mm + float(volume.spacing[2])
    return min(MAX_RAY_MM, thick / max(steep, 1e-6))


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
        near = select_axis_voxels(volume, axis, guess - heel - REACH_BEFORE_MM, guess + REACH_AFTER_MM)
        every = int(np.ceil(len(near.s) / MAX_VOXELS))
        self.near = AxisVoxels(*(x[::every] for x in (near.s, near.u, near.v, near.values)))
        self.volume, self.axis, self.guess, self.radius = volume, axis, guess, needle.diameter_mm / 2
        self.rolled = needle.bevel_deg < MAX_BEVEL_DEG
        self.rod = CachedRod(_make_model(volume, axis, needle, guess))
        self.ceiling = _find_ceiling(near.values)
        self.level = float(np.median(near.values[np.hypot(near.u, near.v) > 0.8 * RADIAL_REACH_MM]))
        self.swing = np.clip((self.near.s - axis.length) / max(guess - axis.length, 0.25), 0, None)
        swing_sd = float(np.hypot(SWING_SD_MM, axis_sd(axis, np.array([axis.length]))[0]))
        self.ray = measure_ray(volume, axis, needle)
        self.means, self.sds = _prior(volume, needle, spread, (swing_sd, self.ray))
        low, high = LOWER_BOUNDS.copy(), UPPER_BOUNDS.copy()
        low[HELD] = np.maximum(low[HELD], self.means - MAX_PRIOR_SD * self.sds)
        high[HELD] = np.minimum(high[HELD], self.means + MAX_PRIOR_SD * self.sds)
        self.bounds = low, high
        core = np.sqrt(1 + (np.hypot(self.near.u, self.near.v) / CORE_REACH_MM) ** 4)
        metal = np.clip(self.near.values - self.level, 0, None)
        self.sigma = core * np.hypot(_estimate_noise(near, guess), SIGNAL_ERROR * metal)

    def show(self, theta: Floats, s: Floats, u: Floats, v: Floats) -> Floats:
        """Return what the scanner shows (N,), HU, at places from the tip."""
        spread = PointSpread(float(np.exp(theta[BLUR])), float(theta[BOOST]), float(np.exp(theta[SLICE])))
        image = self.rod.image((float(theta[ROLL]), float(theta[COT])), spread, (s, u, v))
        darker = theta[DARK] * (1 - np.exp(np.minimum(s, 0) / DARKENING_LENGTH_MM))
        streak = np.exp(-np.maximum(s, 0) / STREAK_LENGTH_MM - (u**2 + v**2) / (2 * STREAK_RADIUS_MM**2))
        shown = theta[LEVEL] + np.exp(theta[HEIGHT] - darker) * image + theta[STREAK] * streak
        return np.asarray(np.clip(shown, FLOOR_HU, self.ceiling))

    def residuals(self, theta: Floats) -> Floats:
        """Return voxels and what is known, both in their deviations."""
        near = self.near
        u, v = near.u - theta[U] * self.swing, near.v - theta[V] * self.swing
        left = (self.show(theta, near.s - theta[TIP], u, v) - near.values) / self.sigma
        return np.append(left, (theta[HELD] - self.means) / self.sds)

    def fit(self, *, rough: bool) -> OptimizeResult:
        """Return the least squares, of the better side of the bevel."""
        first = np.zeros(12)
        first[TIP], first[LEVEL] = self.guess, self.level
        first[HELD] = self.means
        best = self._minimize(self._find_start(first), ROUGH_STEPS)
        if rough:
            return best
        self._calibrate(best)
        turned = best.x + np.pi * np.eye(12)[ROLL]
        starts = [best.x, turned] if self.rolled else [best.x]
        return min((self._minimize(start, STEPS) for start in starts), key=lambda one: one.cost)

    def _find_start(self, first: Floats) -> Floats:
        """Return where to begin: as near as the eye can tell along the axis, and the likeliest roll."""

        def misfit(start: Floats) -> float:
            return float(np.sum(np.minimum(np.abs(self.residuals(start)), 20)))

        one = np.eye(12)
        begin = min((first + g * one[TIP] for g in START_OFFSETS_MM), key=misfit)
        rolls = np.arange(6) * np.pi / 3 if self.rolled else [0.0]
        return min(
            (begin + g * one[TIP] + roll * one[ROLL] for roll in rolls for g in FINE_OFFSETS_MM), key=misfit
        )

    def _calibrate(self, best: OptimizeResult) -> None:
        """Widen the voxels' deviations to what a fit leaves, and so that voxels in one blur count as one."""
        left = 1.48 * float(np.median(np.abs(best.fun[: len(self.near.s)])))
        blurs = 8 * float(np.exp(2 * best.x[BLUR] + best.x[SLICE])) / float(np.prod(self.volume.spacing))
        self.sigma = self.sigma * max(1.0, left) * np.sqrt(max(1.0, blurs))

    def _minimize(self, start: Floats, steps: int) -> OptimizeResult:
        return least_squares(
            self.residuals,
            np.clip(start, self.bounds[0] + 1e-6, self.bounds[1] - 1e-6),
            bounds=self.bounds,
            loss="soft_l1",
            f_scale=SOFT_LOSS_SD,
            x_scale=PARAMETER_SCALES,
            diff_step=DERIVATIVE_STEP,
            max_nfev=steps,
        )

    def covariance(self, best: OptimizeResult) -> Floats:
        """Return the covariance (12, 12) of the parameters.

        The residuals of a block of voxels may go together in any way, as they do along a ray; what a block
        pulls at the parameters in all is one observation, blocks are independent. What was known before pulls
        with the deviation that is stated there, however well it fits.
        """
        jacobian = np.asarray(best.jac, dtype=np.float64)  # scaled by the loss, (1 + (f / SOFT)^2)^(-3/4)
        count = len(self.near.s)
        pulls = jacobian * (best.fun * (1 + (best.fun / SOFT_LOSS_SD) ** 2) ** 0.25)[:, None]
        block = _assign_blocks(self.near)
        total = np.zeros((block.max() + 1, 12))
        np.add.at(total, block, pulls[:count])
        total = np.vstack([total, jacobian[count:]])
        normal = jacobian.T @ jacobian
        inverse = np.linalg.inv(normal + 1e-9 * np.diag(np.maximum(np.diag(normal), 1e-9)))
        covariance: Floats = inverse @ (total.T @ total) @ inverse
        return covariance

    def bevel_probability(self, best: OptimizeResult, covariance: Floats) -> float:
        """Return the probability that the bevel's point lies on the fitted side, within 90 degrees.

        The likelihood over all rolls, the other parameters following to first order, of residuals that go
        together in blocks.
        """
        jacobian = np.asarray(best.jac, dtype=np.float64)
        others = np.delete(jacobian, ROLL, axis=1)
        basis = np.linalg.qr(others)[0]
        naive = 1 / max(
            float(np.sum((jacobian[:, ROLL] - basis @ (basis.T @ jacobian[:, ROLL])) ** 2)), 1e-12
        )
        temper = ARTEFACT_FACTOR * max(1.0, float(covariance[ROLL, ROLL]) / naive)
        turns = np.arange(ROLL_STEPS) * 2 * np.pi / ROLL_STEPS
        costs = []
        for turn in turns:
            left = self.residuals(best.x + turn * np.eye(12)[ROLL])
            change = left - best.fun
            change -= basis @ (basis.T @ change)
            moved = best.fun + change
            costs.append(SOFT_LOSS_SD**2 * np.sum(np.sqrt(1 + (moved / SOFT_LOSS_SD) ** 2) - 1) / temper)
        likelihood = np.exp(min(costs) - np.array(costs))
        near = np.cos(turns) > 1e-9
        return float(likelihood[near].sum() / likelihood.sum())

    def threshold_disagreement(self, theta: Floats) -> float:
        """Return by how much a threshold sees the needle end later than it sees the fitted model end, mm.

        The threshold lies half way up to what is shown of the shaft; where a section exceeds it anywhere in
        the needle's width, there is needle.
        """
        s = np.arange(-6.0, 4.0, END_STEP_MM) + theta[TIP]
        where = axis_frames(self.axis, np.clip(s, 0, None))
        plane = disc_points(self.radius)
        swing = np.clip((s - self.axis.length) / max(self.guess - self.axis.length, 0.25), 0, None)
        u, v = (plane[None, :, n] + 0 * s[:, None] for n in (0, 1))
        model = self.show(
            theta,
            np.repeat(s - theta[TIP], len(plane)),
            (u - theta[U] * swing[:, None]).ravel(),
            (v - theta[V] * swing[:, None]).ravel(),
        ).reshape(len(s), -1)
        seen = np.nan_to_num(sample_planes(self.volume, where, plane), nan=FLOOR_HU)
        shaft = s < theta[TIP] - 4.0
        half = (self.level + float(np.median(seen[shaft].max(axis=1)))) / 2
        ends = [s[np.flatnonzero(one.max(axis=1) > half)] for one in (seen, model)]
        return float(ends[0][-1] - ends[1][-1]) if all(len(end) for end in ends) else np.inf


def _make_model(volume: Volume, axis: AxisSpline, needle: ScannedNeedleRecord, guess: float) -> RodModel:
    frame, normal = axis_frames(axis, np.array([guess])), volume.direction[:, 2]
    # the tip may be found 4 mm from where it is looked for
    back, ahead = bevel_length(needle) + REACH_BEFORE_MM + 4.0, REACH_AFTER_MM + 4.0
    slices = (float(frame.tangents[0] @ normal), float(frame.u[0] @ normal), float(frame.v[0] @ normal))
    return RodModel(needle.diameter_mm / 2, back, ahead, RADIAL_REACH_MM + 0.5, slices)


END_STEP_MM = 0.05
"""Spacing of the sections in which a threshold looks for the end, mm."""


def _prior(
    volume: Volume, needle: ScannedNeedleRecord, spread: PointSpread | None, course: tuple[float, float]
) -> tuple[Floats, Floats]:
    """Return means and deviations of the parameters `HELD`.

    `course`: deviation of the swing, and the length of the needle that rays pass, mm.
    """
    swing_sd, ray = course
    cot = bevel_length(needle) / needle.diameter_mm
    rolled = needle.bevel_deg < MAX_BEVEL_DEG
    cot_sd = np.deg2rad(needle.bevel_sd_deg) * (1 + cot**2) if rolled else BLUNT_COTANGENT_SD
    cot_sd /= np.hypot(1.0, ray / BEVEL_RAY_MM)
    dark_sd = np.clip(DARK_SD_PER_MM * ray, MIN_DARK_SD, MAX_DARK_SD)
    if spread is None:
        slice_blur = np.log(expected_slice_blur(float(volume.spacing[2])))
        seen = [np.log(MEAN_BLUR_MM), MEAN_BOOST, slice_blur]
        seen_sd = [BLUR_SD, BOOST_SD, SLICE_BLUR_SD]
    else:
        seen = [np.log(spread.blur), spread.boost, np.log(spread.slice_blur)]
        seen_sd = [BALL_BLUR_SD, BALL_BOOST_SD, BALL_SLICE_BLUR_SD]
    means = np.array([0.0, 0.0, np.log(MEAN_HEIGHT_HU), cot, *seen, 0.0, 0.0])
    return means, np.array([swing_sd, swing_sd, HEIGHT_SD, cot_sd, *seen_sd, dark_sd, STREAK_SD_HU])


def _assign_blocks(near: AxisVoxels) -> NDArray[np.int64]:
    """Return the block (N,) of each voxel: quadrant round the axis, inner or outer half, length along it."""
    piece = np.floor((near.s - near.s.min()) / BLOCK_LENGTH_MM).astype(np.int64)
    quadrant = 2 * (near.u > 0) + (near.v > 0)
    block: NDArray[np.int64] = 8 * piece + 2 * quadrant + (np.hypot(near.u, near.v) > RADIAL_REACH_MM / 2)
    return block


def select_axis_voxels(volume: Volume, axis: AxisSpline, start: float, stop: float) -> AxisVoxels:
    """Return the voxels within `RADIAL_REACH_MM` of the axis between `start` and `stop` (mm along it)."""
    fine = np.arange(start - 1, stop + 1, 0.1)
    where = axis_frames(axis, fine)
    index = to_index(volume, where.origins)
    margin = RADIAL_REACH_MM / volume.spacing
    low = np.maximum(np.floor(index.min(axis=0) - margin), 0).astype(int)
    high = np.minimum(np.ceil(index.max(axis=0) + margin) + 1, volume.values.shape[::-1]).astype(int)
    ijk = np.stack(np.meshgrid(*map(np.arange, low, high), indexing="ij"), axis=-1).reshape(-1, 3)
    points = to_patient(volume, ijk)
    distance, nearest = cKDTree(where.origins).query(points, distance_upper_bound=RADIAL_REACH_MM + 0.1)
    close = np.isfinite(distance)
    at = np.asarray(nearest)[close]
    d = points[close] - where.origins[at]
    along = np.einsum("ni,ni->n", d, where.tangents[at])
    s = fine[at] + along
    u, v = np.einsum("ni,ni->n", d, where.u[at]), np.einsum("ni,ni->n", d, where.v[at])
    i, j, k = ijk[close].T
    inside = (s >= start) & (s <= stop) & (np.abs(along) < 0.2)
    return AxisVoxels(s[inside], u[inside], v[inside], volume.values[k, j, i][inside].astype(np.float64))


def _find_ceiling(values: Floats) -> float:
    """Return the brightest value if several voxels share it: there the scanner's numbers end."""
    top = float(values.max())
    return top if np.count_nonzero(values == top) > 3 else np.inf


def _estimate_noise(near: AxisVoxels, guess: float) -> float:
    """Return the deviation of what lies beyond the tip (HU), 10 at least."""
    beyond = near.values[near.s > guess + 0.5 * REACH_AFTER_MM]
    if beyond.size < 20:
        return 50.0
    return max(10.0, 1.48 * float(np.median(np.abs(beyond - np.median(beyond)))))
