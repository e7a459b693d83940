"""Find the needle's tip: fit a blurred, saturated, bevelled rod to the voxels around the end."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates, spline_filter
from scipy.optimize import OptimizeResult, least_squares
from scipy.spatial import cKDTree

from needlefit.arrays import Floats
from needlefit.imaging.needle.axis_spline import AxisSpline, axis_frames, axis_sd
from needlefit.imaging.volume import Volume, to_index, to_patient
from needlefit.schemas.reconstruction import ScannedNeedleRecord

Residuals = Callable[[Floats], Floats]

ROD_STEP_MM = 0.25
"""Spacing of the points on which the rod is modelled, mm."""

REACH_BEFORE_MM, REACH_AFTER_MM = 6.0, 5.0
"""How far the fit reaches back from the bevel's heel, and on from the first guess of the tip, mm."""

RADIAL_REACH_MM = 2.4
"""Radius around the axis that the fit uses, mm."""

SHAFT_LENGTH_MM = 15.0
"""Length of the shaft from which its look is taken, mm."""

START_OFFSETS_MM = np.arange(-3.0, 3.1, 0.75)
"""Starting points of the search around the first guess, mm."""

FINE_OFFSETS_MM = np.arange(-0.8, 0.9, 0.4)
"""Positions around the best of these at which the side of the bevel is tried, mm."""

SOFT_LOSS_SD = 3.0
"""Residuals beyond so many deviations of the noise count less."""

BLOCK_LENGTH_MM = 2.0
"""Length of the blocks of voxels whose residuals go together, mm."""

SD_CORRECTION = np.array([2.1, 1.3])
"""By what the blocks' deviations along and across are still too small: the shaft's look is taken as known,
and errors reach beyond a block. Set on the scans of `benchmarks/reconstruction.py --seed 100000`, others than
its own."""

EDGE_SD_MM = 0.03
"""What no voxel tells of the place along, mm: a scanner's edge is not the model's. Set as `SD_CORRECTION`
is."""

BLUNT_COTANGENT_SD = 1e-3
"""Deviation of the cotangent of a blunt end's angle."""

DERIVATIVE_STEP = np.array(1e-3)
"""Relative step of the derivatives."""

MAX_BEVEL_DEG = 85.0
"""A bevel steeper than this has no side."""


@dataclass(frozen=True)
class ShaftAppearance:
    """The appearance of the needle's shaft in the scan.

    Attributes
    ----------
    height, background : float
        HU of the metal over the background, and of that.
    blur : float
        Deviation of the Gaussian that spreads it, mm.
    ceiling : float
        Where the scanner's numbers end, HU; inf if they do not.
    """

    height: float
    background: float
    blur: float
    ceiling: float


@dataclass(frozen=True)
class TipFit:
    """The fitted tip.

    Attributes
    ----------
    at : float
        Along the spine, mm.
    point : (3,) array
        In the patient, mm; beside the spine, if the rod swung.
    sd : (2,) array
        Deviations along the needle, and across it in either direction, mm.
    bevel : (3,) array
        Unit vector across the needle to the side of the bevel's point; nan for a blunt end.
    """

    at: float
    point: Floats
    sd: Floats
    bevel: Floats


@dataclass(frozen=True)
class AxisVoxels:
    """Voxels near the axis: position along, `s` (N,), across, `u`, `v` (N,), mm; their `values` (N,), HU."""

    s: Floats
    u: Floats
    v: Floats
    values: Floats


def bevel_length(needle: ScannedNeedleRecord) -> float:
    """Return the length of the bevel: how far behind the point the tip is cut, mm."""
    return needle.diameter_mm / float(np.tan(np.deg2rad(needle.bevel_deg)))


def fit_tip(volume: Volume, axis: AxisSpline, needle: ScannedNeedleRecord, guess: float) -> TipFit:
    """Fit the tip near `guess` (mm along the axis) by least squares over the voxels around it.

    The tip is where the axis ends that reaches as far as the bevel's point does. A rod cut by the bevel,
    blurred as the shaft is and cut at the scanner's ceiling, is moved along the axis, rolled about it, and
    swung across it from the last cross-section on; the bevel's angle is the recipe's within its deviation,
    unless the voxels say otherwise. For a blunt end far below the ceiling the profile along the axis is the
    error function.
    """
    shaft = fit_shaft_appearance(volume, axis, needle, guess)
    near = select_axis_voxels(
        volume, axis, guess - bevel_length(needle) - REACH_BEFORE_MM, guess + REACH_AFTER_MM
    )
    noise = _estimate_noise(near, guess)
    rolled = needle.bevel_deg < MAX_BEVEL_DEG
    cot = bevel_length(needle) / needle.diameter_mm
    cot_sd = np.deg2rad(needle.bevel_sd_deg) * (1 + cot**2) if rolled else BLUNT_COTANGENT_SD

    swing = np.clip((near.s - axis.length) / max(guess - axis.length, ROD_STEP_MM), 0, None)

    @lru_cache(maxsize=4)  # of the seven derivatives of a step four are of the same rod
    def rod(tip: float, roll: float, cot: float) -> Floats:
        return _render_rod(_stations(near), needle.diameter_mm / 2, shaft.blur, (tip, roll, cot))

    def residuals(theta: Floats) -> Floats:
        u, v = near.u - theta[2] * swing, near.v - theta[3] * swing
        valid = _seen(rod(theta[0], theta[1], theta[6]), AxisVoxels(near.s, u, v, near.values))
        shown = np.minimum(theta[5] + theta[4] * shaft.height * valid, shaft.ceiling)
        return np.append((shown - near.values) / noise, (theta[6] - cot) / cot_sd)

    first = np.array([guess, 0, 0, 0, 1.0, shaft.background, cot])
    best = min(
        (_minimize(residuals, start) for start in _list_starting_points(residuals, first, rolled)),
        key=lambda b: b.cost,
    )
    variance = np.diag(_covariance(best, near))
    heel = float(axis_sd(axis, np.array([axis.length]))[0])  # from where the rod swings
    sd = np.hypot(SD_CORRECTION * np.sqrt([variance[0], variance[2:4].mean()]), [EDGE_SD_MM, heel])
    at, roll, du, dv = best.x[:4]
    there = axis_frames(axis, np.array([at]))
    u, v = there.u[0], there.v[0]
    bevel = np.cos(roll) * u + np.sin(roll) * v if rolled else np.full(3, np.nan)
    return TipFit(float(at), there.origins[0] + du * u + dv * v, sd, bevel)


def _list_starting_points(residuals: Residuals, first: Floats, rolled: bool) -> list[Floats]:
    """Return where to begin: as near as the eye can tell along the axis, the bevel on either of two sides."""

    def rough(start: Floats) -> float:
        return float(np.sum(np.abs(residuals(start))))

    begin = min((first + np.eye(7)[0] * g for g in START_OFFSETS_MM), key=rough)
    if not rolled:
        return [begin]
    sides = []
    for roll in np.arange(6) * np.pi / 3:
        sides.append(min((begin + np.array([g, roll, 0, 0, 0, 0, 0]) for g in FINE_OFFSETS_MM), key=rough))
    sides.sort(key=rough)
    other = next(start for start in sides if np.cos(start[1] - sides[0][1]) < 0)
    return [sides[0], other]


def _minimize(residuals: Residuals, start: Floats) -> OptimizeResult:
    """Return the least squares from `start`."""
    scale = np.array([0.2, 0.3, 0.1, 0.1, 0.1, 50.0, 0.3])
    return least_squares(
        residuals, start, loss="soft_l1", f_scale=SOFT_LOSS_SD, x_scale=scale, diff_step=DERIVATIVE_STEP
    )


def _covariance(best: OptimizeResult, near: AxisVoxels) -> Floats:
    """Return the covariance (7, 7) of what was laid over the voxels `near`.

    The residuals of a block of voxels may go together in any way, as they do along a ray; what a block pulls
    at the parameters in all is one observation, blocks are independent. The last residual is the recipe's
    bevel: what it pulls has the deviation that is stated there, however well it fits.
    """
    jacobian = np.asarray(best.jac, dtype=np.float64)  # scaled by the loss, (1 + (f / SOFT)^2)^(-3/4)
    pulls = jacobian * (best.fun * (1 + (best.fun / SOFT_LOSS_SD) ** 2) ** 0.25)[:, None]
    block = _assign_blocks(near)
    total = np.zeros((block.max() + 2, 7))
    np.add.at(total, block, pulls[:-1])
    total[-1] = jacobian[-1]
    inverse = np.linalg.inv(jacobian.T @ jacobian + 1e-9 * np.eye(7))
    covariance: Floats = inverse @ (total.T @ total) @ inverse
    return covariance


def _assign_blocks(near: AxisVoxels) -> NDArray[np.int64]:
    """Return the block (N,) of each voxel: quadrant round the axis, inner or outer half, length along it."""
    piece = np.floor((near.s - near.s.min()) / BLOCK_LENGTH_MM).astype(np.int64)
    quadrant = 2 * (near.u > 0) + (near.v > 0)
    block: NDArray[np.int64] = 8 * piece + 2 * quadrant + (np.hypot(near.u, near.v) > RADIAL_REACH_MM / 2)
    return block


def fit_shaft_appearance(
    volume: Volume, axis: AxisSpline, needle: ScannedNeedleRecord, end: float
) -> ShaftAppearance:
    """Fit the appearance of the last full shaft before the bevel, by the voxels' distances from the axis."""
    stop = end - bevel_length(needle) - 1.5
    near = select_axis_voxels(volume, axis, max(stop - SHAFT_LENGTH_MM, 0.0), max(stop, 2.0))
    ceiling = _find_ceiling(near.values)
    radius = np.hypot(near.u, near.v)
    rim = float(np.median(near.values[radius > 0.8 * RADIAL_REACH_MM]))
    fine = ROD_STEP_MM / 2
    steps = np.arange(-np.ceil(2 * RADIAL_REACH_MM / fine), np.ceil(2 * RADIAL_REACH_MM / fine) + 1) * fine
    inside = np.clip((needle.diameter_mm / 2 - np.hypot(steps[:, None], steps)) / fine + 0.5, 0, 1)

    def residuals(theta: Floats) -> Floats:
        shown = gaussian_filter(inside, np.exp(theta[1]) / fine, mode="constant")
        profile = np.interp(radius, steps[len(steps) // 2 :], shown[len(steps) // 2, len(steps) // 2 :])
        model = theta[2] * 100 + np.exp(theta[0]) * profile
        return np.asarray((np.minimum(model, ceiling) - near.values) / 100, dtype=np.float64)

    top = max(float(near.values.max()) - rim, 100.0)
    begin = np.array([np.log(1.5 * top), np.log(0.45), rim / 100])
    best = least_squares(residuals, begin, loss="soft_l1", diff_step=DERIVATIVE_STEP)
    return ShaftAppearance(
        float(np.exp(best.x[0])), float(best.x[2] * 100), float(np.exp(best.x[1])), ceiling
    )


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


def _stations(near: AxisVoxels) -> Floats:
    """Return the points along the axis on which the rod is modelled, mm."""
    return np.arange(near.s.min() - 3 * ROD_STEP_MM, near.s.max() + 3 * ROD_STEP_MM, ROD_STEP_MM)


def _across() -> Floats:
    """Return the points across the axis, in either direction, on which the rod is modelled, mm."""
    return (
        np.arange(-np.ceil(RADIAL_REACH_MM / ROD_STEP_MM) - 4, np.ceil(RADIAL_REACH_MM / ROD_STEP_MM) + 5)
        * ROD_STEP_MM
    )


def _render_rod(s: Floats, radius: float, blur: float, shape: tuple[float, float, float]) -> Floats:
    """Return splines through a blurred rod of height 1; `shape` is its end, its roll and its cotangent."""
    tip, roll, cot = shape
    u, v = _across()[:, None], _across()[None, :]
    cut = (radius - (u * np.cos(roll) + v * np.sin(roll))) * cot
    edge = ROD_STEP_MM * np.hypot(1.0, cot)  # a soft face one step thick, measured along the axis
    disc = np.clip((radius - np.hypot(u, v)) / ROD_STEP_MM + 0.5, 0, 1)
    solid = np.clip((tip - cut[None] - s[:, None, None]) / edge + 0.5, 0, 1) * disc
    splines: Floats = spline_filter(gaussian_filter(solid, blur / ROD_STEP_MM, mode="nearest"))
    return splines


def _seen(rod: Floats, near: AxisVoxels) -> Floats:
    """Return the part of the rod's height that each voxel shows."""
    begin, side = _stations(near)[0], _across()[0]
    place = np.stack([near.s - begin, near.u - side, near.v - side]) / ROD_STEP_MM
    return np.asarray(map_coordinates(rod, place, order=3, mode="nearest", prefilter=False))


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
