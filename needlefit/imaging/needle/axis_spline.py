"""Fit the needle's axis as a spline of arc length through cross-sections of the needle."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import BSpline

from needlefit.arrays import Floats
from needlefit.geometry.curves import make_normal
from needlefit.geometry.frames import to_unit
from needlefit.geometry.smoothing_spline import DEGREE, design_matrix, free_end_basis, make_knots
from needlefit.imaging.constants import MM, SD
from needlefit.imaging.volume import Volume, sample

FEWEST = 8  # smallest number of cross-sections, or voxels, that make an axis; fewer are noise
# number of times that sections are moved to the middle, each on the axis before; reweighting takes one more
ROUNDS = 3


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
    edges = np.unique(even)
    # none ends a piece without cross-sections: nothing shapes it
    filled = (np.histogram(s, edges)[0][:-1] > 0) & (edges[1:-1] <= s[-1])
    knots = np.concatenate([even[: DEGREE + 1], edges[1:-1][filled], even[-DEGREE - 1 :]])
    basis = np.eye(len(knots) - 4) if tip is None else free_end_basis(knots)  # (C, F)
    matrix = design_matrix(s, knots) @ basis
    robust = np.ones(len(s))
    for _ in range(1 + ROUNDS):
        w = weights * robust
        normal = matrix.T @ (matrix * w[:, None])
        coefficients = np.linalg.solve(normal, matrix.T @ (points * w[:, None]))
        residuals = points - matrix @ coefficients
        size = np.sqrt(weights) * np.linalg.norm(residuals, axis=1)
        scale = max(float(np.median(size)) / 1.18, 1e-9)  # of a two-dimensional Gaussian
        robust = np.minimum(1.0, SD.OUTLIER * 1.4 / np.maximum(size / scale, 1e-9))
    freedom = max(1.0, len(s) - matrix.shape[1])
    variance = float(np.sum(w[:, None] * residuals**2) / (2 * freedom))  # two directions are free
    variance *= correlation_factor(residuals, matrix.shape[1])
    covariance = basis @ np.linalg.inv(normal) @ basis.T * variance
    spline = BSpline(knots, basis @ coefficients, 3)
    return AxisSpline(spline, float(s[-1]), variance, covariance, s, points, weights, w)


def extend_axis(axis: AxisSpline, at: float, point: Floats, sd: float, knot: float) -> AxisSpline:
    """Fit the spline again with a further `point` (3,) of deviation `sd` (mm) at `at` (mm)."""
    s, points = np.append(axis.s, at), np.vstack([axis.points, point])
    longer = fit_axis(s, points, np.append(axis.weights, axis.variance / sd**2), knot)
    scale = axis.variance / longer.variance  # one point more determines no scatter
    covariance = longer.covariance * scale
    return replace(
        longer,
        variance=axis.variance,
        covariance=covariance,
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
    variance = np.einsum("nc,cd,nd->n", matrix, axis.covariance, matrix)
    return np.sqrt(variance)


def axis_frames(axis: AxisSpline, s: Floats) -> AxisFrames:
    """Return the frames (S,) at `s` (S,), mm; u stays as close as possible to one direction."""
    first, last = axis.spline(np.array([0.0, axis.length]))
    return _make_frames(axis.spline(s), axis.spline.derivative()(s), last - first)


def frames_along(points: Floats) -> AxisFrames:
    """Return the frames at points (S, 3) along a needle, mm."""
    return _make_frames(points, np.gradient(points, axis=0), points[-1] - points[0])


def _make_frames(origins: Floats, ways: Floats, chord: Floats) -> AxisFrames:
    tangents, reference = to_unit(ways), make_normal(to_unit(chord))
    u = to_unit(reference - (tangents @ reference)[:, None] * tangents)
    return AxisFrames(origins, tangents, u, np.cross(tangents, u))


# spacing (mm) of the points in a plane, also of pictures: finer than a cone beam's voxels
PLANE_SPACING_MM = 0.3


def disc_points(radius: float) -> Floats:
    """Return the grid points (P, 2) in a disc, mm."""
    steps = (
        np.arange(-np.floor(radius / PLANE_SPACING_MM), np.floor(radius / PLANE_SPACING_MM) + 1)
        * PLANE_SPACING_MM
    )
    grid = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    return grid[np.hypot(*grid.T) <= radius]


def sample_planes(volume: Volume, where: AxisFrames, plane: Floats) -> Floats:
    """Return the brightness (S, P), HU, at `plane` (P, 2) in every frame; nan outside the volume."""
    across = plane @ np.stack([where.u, where.v], axis=1)  # (S, P, 3)
    return sample(volume, where.origins[:, None] + across)


def find_sections(
    volume: Volume, where: AxisFrames, reach: float, least: float = 1.0
) -> tuple[Floats, Floats, Floats]:
    """Return how far a needle lies beside frames (S, 3), mm, its brightness over its surroundings, and these.

    Centroids of what outshines the rim of a cross-section, within `reach` of its middle; brightness (S,), HU.
    Where the volume holds less than the part `least` of a section, the needle lies in its middle and has no
    brightness.
    """
    plane = disc_points(MM.PATCH)
    values, radius = sample_planes(volume, where, plane), np.hypot(*plane.T)
    values[np.isfinite(values).mean(axis=1) < least] = 0.0
    rim = np.nanmedian(values[:, radius > MM.RIM], axis=1)
    over = np.where((radius <= reach) & np.isfinite(values), values - rim[:, None], 0.0)
    over = np.clip(over - 0.3 * over.max(axis=1, keepdims=True), 0, None)
    across = over @ plane / np.maximum(over.sum(axis=1), 1e-9)[:, None]
    return across[:, :1] * where.u + across[:, 1:] * where.v, over.max(axis=1), rim
