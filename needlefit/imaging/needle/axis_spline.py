"""Fit the needle's axis as a spline of arc length through cross-sections of the needle."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, PchipInterpolator
from scipy.ndimage import map_coordinates

from needlefit.arrays import Floats
from needlefit.geometry.curves import make_normal
from needlefit.geometry.smoothing_spline import DEGREE, design_matrix, free_end_basis, make_knots
from needlefit.imaging.volume import Volume, to_index

AXIS_HUBER_SD = 1.5  # residuals beyond so many deviations count less
MAX_POINT_WEIGHT = 30.0  # a point counts at most for so many cross-sections
REWEIGHTING_ROUNDS = 4  # rounds of reweighting
# Sections fainter than this part of the needle's middle one show no needle.
MIN_RELATIVE_AMPLITUDE = 0.3
# A step is looked for in cross-sections at this distance, mm; at least so many on the side of the base, and
# on that of the tip.
STEP_SPACING_MM = 0.25  # mm
MIN_BASE_SECTIONS = 24  # sections
MIN_END_SECTIONS = 2  # sections


@dataclass(frozen=True)
class AxisSpline:
    """The needle's axis: a cubic spline through cross-sections."""

    # Arc length from the first cross-section (mm, to the accuracy of one iteration) -> position (3,).
    spline: BSpline
    length: float  # where the last cross-section lies, mm
    # Of a cross-section of weight 1 in one direction, its neighbours' correlation included, mm^2.
    variance: float
    covariance: Floats  # (C, C); of one coordinate's coefficients
    # (S,), (S, 3), (S,); the cross-sections it was drawn through.
    s: Floats
    points: Floats
    weights: Floats
    # (S,); `weights`, less where a cross-section lies off: what the spline was drawn with.
    final_weights: Floats
    # Deviation that all cross-sections of a stretch share, so that their scatter does not show it, mm.
    shared_sd: float = 0.0
    # (2, S); of a needle near the slices: deviations in them and along their normal at `s`, mm.
    slice_sds: Floats | None = None


@dataclass(frozen=True)
class AxisFrames:
    """Frames of cross-sections: `origins`, `tangents` and two directions across, `u`, `v`: each (S, 3)."""

    origins: Floats
    tangents: Floats
    u: Floats
    v: Floats


def fit_axis(s: Floats, points: Floats, weights: Floats, knot: float, tip: float | None = None) -> AxisSpline:
    """Fit a spline with a knot every `knot` mm to `points` (S, 3) at `s` (S,).

    Points far off, by Huber's rule, count less. The covariance holds the correlation of neighbouring
    residuals: by the sum of their autocorrelation a cross-section counts for less than one observation.
    With a `tip` (mm, from the last point on) the spline reaches to it and has no curvature there, as a free
    end has none: the last cross-sections lie some millimetres before it, and a cubic that goes on from them
    with its curvature there would bend too far.
    """
    even = make_knots(s[0], s[-1] if tip is None else tip, knot)
    kept = list(even[: DEGREE + 1])
    for one in even[DEGREE + 1 : -DEGREE - 1]:  # none ends a piece without cross-sections: nothing shapes it
        if ((s >= kept[-1]) & (s < one)).any():
            kept.append(one)
    if len(kept) > DEGREE + 1 and not (s >= kept[-1]).any():
        kept.pop()
    knots = np.array([*kept, *even[-DEGREE - 1 :]])
    basis = np.eye(len(knots) - 4) if tip is None else free_end_basis(knots)  # (C, F)
    matrix = design_matrix(s, knots) @ basis
    robust = np.ones(len(s))
    for _ in range(REWEIGHTING_ROUNDS):
        w = weights * robust
        normal = matrix.T @ (matrix * w[:, None])
        coefficients = np.linalg.solve(normal, matrix.T @ (points * w[:, None]))
        residuals = points - matrix @ coefficients
        size = np.sqrt(weights) * np.linalg.norm(residuals, axis=1)
        scale = max(float(np.median(size)) / 1.18, 1e-9)  # of a two-dimensional Gaussian
        robust = np.minimum(1.0, AXIS_HUBER_SD * 1.4 / np.maximum(size / scale, 1e-9))
    freedom = max(1.0, len(s) - matrix.shape[1])
    variance = float(np.sum(w[:, None] * residuals**2) / (2 * freedom))  # two directions are free
    variance *= correlation_factor(residuals, matrix.shape[1])
    covariance = basis @ np.linalg.inv(normal) @ basis.T * variance
    spline = BSpline(knots, basis @ coefficients, 3)
    return AxisSpline(spline, float(s[-1]), variance, covariance, s, points, weights, w)


def extend_axis(axis: AxisSpline, at: float, point: Floats, sd: float, knot: float) -> AxisSpline:
    """Fit the spline again with a further `point` (3,) of deviation `sd` (mm) at `at` (mm)."""
    weight = min(axis.variance / sd**2, MAX_POINT_WEIGHT)
    s, points = np.append(axis.s, at), np.vstack([axis.points, point])
    longer = fit_axis(s, points, np.append(axis.weights, weight), knot)
    scale = axis.variance / longer.variance  # one point more determines no scatter
    covariance = longer.covariance * scale
    return replace(
        longer,
        variance=axis.variance,
        covariance=covariance,
        shared_sd=axis.shared_sd,
        slice_sds=axis.slice_sds,
    )


def correlation_factor(residuals: Floats, parameters: int) -> float:
    """Return how many correlated cross-sections count as one: 1 + 2 sum of the autocorrelation, at least 1.

    Residuals of a fit of P parameters to S points are less correlated than the errors, by about P / S.
    """
    power = float(np.sum(residuals**2))
    total, missing = 1.0, parameters / len(residuals)
    for lag in range(1, len(residuals) // 3):
        rho = float(np.sum(residuals[lag:] * residuals[:-lag])) / max(power, 1e-30)
        rho = (rho + missing) / (1 + missing)
        if rho <= 0:
            break
        total += 2 * rho
    return total


def axis_sd(axis: AxisSpline, s: Floats) -> Floats:
    """Return the standard deviation in any one direction across (N,) at `s` (N,), mm."""
    if axis.slice_sds is not None:
        both = [np.interp(s, axis.s[: len(one)], one) for one in axis.slice_sds]
        return np.hypot(*both) / np.sqrt(2)
    matrix = design_matrix(s, axis.spline.t)
    variance = np.einsum("nc,cd,nd->n", matrix, axis.covariance, matrix) + axis.shared_sd**2
    return np.sqrt(variance)


def axis_frames(axis: AxisSpline, s: Floats) -> AxisFrames:
    """Return the frames (S,) at `s` (S,), mm; u stays as close as possible to one direction."""
    tangents = axis.spline.derivative()(s)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    ends = axis.spline(np.array([0.0, axis.length]))
    reference = make_normal((ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0]))
    u = reference - (tangents @ reference)[:, None] * tangents
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    return AxisFrames(axis.spline(s), tangents, u, np.cross(tangents, u))


def frames_along(points: Floats) -> AxisFrames:
    """Return the frames at points (S, 3) along a needle, mm."""
    tangents = np.gradient(points, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    u = np.cross(tangents, make_normal(tangents[len(tangents) // 2]))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    return AxisFrames(points, tangents, u, np.cross(tangents, u))


def find_step(
    volume: Volume, axis: AxisSpline, stop: float, diameter: float, patch: float
) -> tuple[int, float, float] | None:
    """Return the most significant step of the needle between two slices; None where none can be tested.

    Where the table moves, everything beyond is shifted, and a spline leaves the step in its residuals.
    Returned are the number of the slice before it, the shift, and its deviation, mm.

    `stop`: where the bevel begins, mm along the axis. `diameter`, `patch`: of the needle, and of what is
    looked at around it, mm.
    """
    s, plane = np.arange(0.0, stop, STEP_SPACING_MM), disc_points(patch)
    where = axis_frames(axis, s)
    values = sample_planes(volume, where, plane)
    # their centroids, and not the sections that the axis was drawn through: those beside it were left out
    found = find_centroids(values, plane, diameter)
    shown = np.isfinite(values).mean(axis=1) >= MIN_FRACTION_IN_VOLUME
    shown &= found.amplitude > MIN_RELATIVE_AMPLITUDE * np.median(found.amplitude)
    matrix = design_matrix(s[shown], axis.spline.t) @ free_end_basis(axis.spline.t)
    basis, _ = np.linalg.qr(matrix)
    left = found.shifts[shown] - basis @ (basis.T @ found.shifts[shown])
    heights = to_index(volume, where.origins[shown])[:, 2]
    freedom = 2 * max(1, len(left) - matrix.shape[1] - 1)
    steps: list[tuple[int, float, float]] = []
    for k in range(int(np.floor(heights.min())), int(np.ceil(heights.max()))):
        beyond = np.where(heights > k + 0.5, 1.0, 0.0)
        if beyond[-1] == 0.0:  # the needle goes down the slices
            beyond = 1.0 - beyond
        if not MIN_END_SECTIONS <= np.count_nonzero(beyond) <= len(beyond) - MIN_BASE_SECTIONS:
            continue
        own = beyond - basis @ (basis.T @ beyond)  # what no spline follows
        power = float(own @ own)
        step = own @ left / power
        rest = left - np.outer(own, step)
        # neighbours err alike, above all in slices that were resampled
        alike = correlation_factor(rest, matrix.shape[1] + 1)
        sd = np.sqrt(np.sum(rest**2) / freedom / power * alike)
        steps.append((k, float(np.linalg.norm(step)), float(sd)))
    return max(steps, key=lambda one: one[1] / one[2], default=None)


PLANE_SPACING_MM = 0.3  # spacing of the points in a plane, mm
RING_WIDTH_MM = 0.15  # width of the rings over which the common profile is averaged, mm
SECTION_HUBER_SD = 2.0  # points of a plane that stray by more than so many deviations count less
SHARED_ERROR_LENGTH_MM = 15.0  # length over which what the cross-sections have in common is looked for, mm
# Shift of a section for a background that slopes by the needle's brightness in 1 mm, mm: a ray that tilts
# what lies around the needle also bends it, and a bend is taken for a shift.
SHIFT_PER_TILT_MM = 5.0
MIN_FRACTION_IN_VOLUME = 0.7  # part of a plane's points that must lie in the volume


@dataclass(frozen=True)
class CrossSections:
    """Cross-sections of the needle: where the axis pierces planes across it, and how bright it is."""

    shifts: Floats  # (S, 2); where its axis pierces them, along the frames' u and v, mm
    amplitude: Floats  # (S,); brightness over the background, HU
    noise: Floats  # (S,); deviation of a plane's points from the fit, HU
    tilt: Floats  # (S, 2); slope of the background along u and v, HU/mm


def disc_points(radius: float) -> Floats:
    """Return the grid points (P, 2) in a disc, mm."""
    steps = (
        np.arange(-np.floor(radius / PLANE_SPACING_MM), np.floor(radius / PLANE_SPACING_MM) + 1)
        * PLANE_SPACING_MM
    )
    grid = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    return grid[np.hypot(*grid.T) <= radius]


def sample_planes(volume: Volume, where: AxisFrames, plane: Floats) -> Floats:
    """Return the brightness (S, P), HU, at `plane` (P, 2) in every frame; nan outside the volume.

    Trilinear: it keeps centroids; cubic interpolation of a saturated needle, with its ringing, need not.
    """
    points = (
        where.origins[:, None] + plane[None, :, :1] * where.u[:, None] + plane[None, :, 1:] * where.v[:, None]
    )
    # to_index gives i, j, k; the array is indexed k, j, i
    index = to_index(volume, points.reshape(-1, 3))[:, ::-1].T
    values = map_coordinates(volume.values, index, order=1, cval=np.nan, output=np.float64)
    return values.reshape(points.shape[:2])


def find_centroids(values: Floats, plane: Floats, reach: float) -> CrossSections:
    """Return rough cross-sections: centroids of what outshines the rim, within `reach` of the middle."""
    radius = np.hypot(*plane.T)
    rim = np.nanmedian(values[:, radius > 0.8 * radius.max()], axis=1)
    over = np.where((radius <= reach) & np.isfinite(values), values - rim[:, None], 0.0)
    over = np.clip(over - 0.3 * over.max(axis=1, keepdims=True), 0, None)
    mass = np.maximum(over.sum(axis=1), 1e-9)
    return CrossSections(
        over @ plane / mass[:, None], over.max(axis=1), np.ones(len(values)), np.zeros((len(values), 2))
    )


def fit_sections(values: Floats, plane: Floats, rough: CrossSections) -> CrossSections:
    """Return cross-sections by least squares, from `values` (S, P), HU, at `plane` (P, 2) and `rough` ones.

    Every plane shows amplitude f(|x - shift|) + background + slope . x, where f is the profile that all
    planes of this needle have in common: saturation and bloom are in it, whatever they are. Linear in
    the shift about `rough`; points that do not fit (a ray, a marker) count less.
    """
    f, slope = _common_profile(values, plane, rough)
    offset = plane[None] - rough.shifts[:, None]  # (S, P, 2)
    r = np.maximum(np.linalg.norm(offset, axis=2), 1e-6)
    pull = -slope(r)[..., None] * offset / r[..., None]
    ones = np.ones_like(r)
    flat = np.broadcast_to(plane, offset.shape)
    design = np.concatenate([f(r)[..., None], ones[..., None], flat, pull], axis=2)  # (S, P, 6)
    valid = np.isfinite(values)
    known = np.where(valid, values, 0.0)
    weights = valid.astype(np.float64)
    for _ in range(3):
        weighted = design * weights[..., None]
        # 1e-9: planes without known points would make the matrix singular
        normal = np.einsum("spa,spb->sab", weighted, design) + 1e-9 * np.eye(6)
        solved = np.linalg.solve(normal, np.einsum("spa,sp->sa", weighted, known)[..., None])[..., 0]
        residual = np.where(valid, known - np.einsum("spa,sa->sp", design, solved), 0.0)
        noise = np.maximum(1.48 * np.median(np.abs(residual), axis=1), 1e-6)
        weights = valid * np.minimum(
            1.0, SECTION_HUBER_SD * noise[:, None] / np.maximum(np.abs(residual), 1e-9)
        )
    # columns 4 and 5 are amplitude times shift: the profile's derivative is the design, column 0 the
    # amplitude
    moved = solved[:, 4:] / np.where(np.abs(solved[:, :1]) > 1e-6, solved[:, :1], 1.0)
    return CrossSections(rough.shifts + np.clip(moved, -0.5, 0.5), solved[:, 0], noise, solved[:, 2:4])


def estimate_shared_sd(
    rough: CrossSections, found: CrossSections, good: NDArray[np.bool_], station: float
) -> float:
    """Return the deviation (mm) that `good` neighbours share, so that their scatter does not show it.

    Rays along a needle pull at many sections alike: at centroids more than at fits, and at the background.
    """
    bent = SHIFT_PER_TILT_MM * found.tilt / np.median(found.amplitude[good])
    both = np.hstack([rough.shifts - found.shifts, bent])[good]  # (S, 4)
    window = np.ones(max(1, min(len(both), round(SHARED_ERROR_LENGTH_MM / station))))
    count = np.convolve(np.ones(len(both)), window, "same")
    shared = np.stack([np.convolve(side, window, "same") / count for side in both.T])
    return float(np.sqrt(np.sum(np.mean(shared**2, axis=1)) / 2))  # in one direction of two


def _common_profile(
    values: Floats, plane: Floats, rough: CrossSections
) -> tuple[PchipInterpolator, PchipInterpolator]:
    """Return the planes' common profile, 1 in the middle and 0 far out, and its slope (1/mm), over radius."""
    r = np.linalg.norm(plane[None] - rough.shifts[:, None], axis=2)
    rim = np.nanmedian(np.where(r > 0.8 * r.max(axis=1, keepdims=True), values, np.nan), axis=1)
    inner = np.nanmean(np.where(r < 2 * PLANE_SPACING_MM, values, np.nan), axis=1)
    over = inner - rim
    good = over > 0.3 * np.median(over)
    scaled = (values[good] - rim[good, None]) / over[good, None]
    ring = np.rint(r[good] / RING_WIDTH_MM).astype(int)
    last = int(ring.max())
    parts = [scaled[ring == n] for n in range(last + 1)]
    parts = [part[np.isfinite(part)] for part in parts]
    level = np.array([float(np.median(part)) if part.size else np.nan for part in parts])
    radii = np.arange(last + 1) * RING_WIDTH_MM
    known = np.isfinite(level)
    level = np.minimum.accumulate(level[known])  # brightest in the middle
    level = np.clip(level - level[-1], 0, None)
    radii = radii[known]
    mirrored = np.concatenate([-radii[:0:-1], radii]), np.concatenate([level[:0:-1], level])
    profile = PchipInterpolator(*mirrored)
    return profile, profile.derivative()
