"""A needle's axis as a spline of arc length, and frames along it."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from needlefit.geometry.plane import any_normal

Floats = NDArray[np.float64]

HUBER = 1.5
"""Residuals beyond so many deviations count less."""

MOST_WEIGHT = 30.0
"""A point counts at most for so many cross-sections."""

ROUNDS = 4
"""Rounds of reweighting."""


@dataclass(frozen=True)
class Spine:
    """A cubic spline through cross-sections.

    Attributes
    ----------
    spline : BSpline
        Arc length from the first cross-section (mm, to the accuracy of one iteration) -> position (3,).
    length : float
        Where the last cross-section lies, mm.
    variance : float
        Of a cross-section of weight 1 in one direction, its neighbours' correlation included, mm^2.
    covariance : (C, C) array
        Of one coordinate's coefficients.
    s, points, weights : (S,), (S, 3), (S,) arrays
        The cross-sections it was drawn through.
    unseen : float
        Deviation that all cross-sections of a stretch share, so that their scatter does not show it, mm.
    """

    spline: BSpline
    length: float
    variance: float
    covariance: Floats
    s: Floats
    points: Floats
    weights: Floats
    unseen: float = 0.0


@dataclass(frozen=True)
class Frames:
    """Where cross-sections lie: `origins`, `tangents` and two directions across, `u`, `v`: each (S, 3)."""

    origins: Floats
    tangents: Floats
    u: Floats
    v: Floats


def draw(s: Floats, points: Floats, weights: Floats, knot: float) -> Spine:
    """Return the spline with a knot every `knot` mm that fits `points` (S, 3) at `s` (S,) best.

    Points far off, by Huber's rule, count less. The covariance holds the correlation of neighbouring
    residuals: by the sum of their autocorrelation a cross-section counts for less than one observation.
    """
    knots = _knots(s[0], s[-1], knot)
    matrix = BSpline.design_matrix(s, knots, 3).toarray()
    robust = np.ones(len(s))
    for _ in range(ROUNDS):
        w = weights * robust
        normal = matrix.T @ (matrix * w[:, None])
        coefficients = np.linalg.solve(normal, matrix.T @ (points * w[:, None]))
        residuals = points - matrix @ coefficients
        size = np.sqrt(weights) * np.linalg.norm(residuals, axis=1)
        scale = max(float(np.median(size)) / 1.18, 1e-9)  # of a two-dimensional Gaussian
        robust = np.minimum(1.0, HUBER * 1.4 / np.maximum(size / scale, 1e-9))
    freedom = max(1.0, len(s) - matrix.shape[1])
    variance = float(np.sum(w[:, None] * residuals**2) / (2 * freedom))  # two directions are free
    variance *= correlation(residuals, matrix.shape[1])
    covariance = np.asarray(np.linalg.inv(normal) * variance, dtype=np.float64)
    return Spine(BSpline(knots, coefficients, 3), float(s[-1]), variance, covariance, s, points, weights)


def extended(spine: Spine, at: float, point: Floats, sd: float, knot: float) -> Spine:
    """Return the spline drawn anew, through a further `point` (3,) of deviation `sd` (mm) at `at` (mm)."""
    weight = min(spine.variance / sd**2, MOST_WEIGHT)
    s, points = np.append(spine.s, at), np.vstack([spine.points, point])
    longer = draw(s, points, np.append(spine.weights, weight), knot)
    scale = spine.variance / longer.variance  # one point more tells nothing of the scatter
    covariance = longer.covariance * scale
    return replace(longer, variance=spine.variance, covariance=covariance, unseen=spine.unseen)


def correlation(residuals: Floats, parameters: int) -> float:
    """Return how many cross-sections count for one observation: 1 + 2 sum of the autocorrelation, 1 at least.

    The sum ends where the autocorrelation first falls below zero. Residuals of a fit of P parameters to
    S points are less correlated than the errors, about as if each lag's sum lacked P / S.
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


def deviation(spine: Spine, s: Floats) -> Floats:
    """Return the standard deviation in one direction across (N,) at `s` (N,), mm."""
    matrix = BSpline.design_matrix(s, spine.spline.t, 3, extrapolate=True).toarray()
    sd: Floats = np.sqrt(np.einsum("nc,cd,nd->n", matrix, spine.covariance, matrix) + spine.unseen**2)
    return sd


def frames(spine: Spine, s: Floats) -> Frames:
    """Return the frames (S,) at `s` (S,), mm; u is as near as can be to one direction for all."""
    tangents = spine.spline.derivative()(s)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    ends = spine.spline(np.array([0.0, spine.length]))
    reference = any_normal((ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0]))
    u = reference - (tangents @ reference)[:, None] * tangents
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    return Frames(spine.spline(s), tangents, u, np.cross(tangents, u))


def reversed_spine(spine: Spine) -> Spine:
    """Return the same curve, run through from the other end."""
    spline = spine.spline
    turned = BSpline(spine.length - spline.t[::-1], spline.c[::-1], 3)
    s = spine.length - spine.s[::-1]
    covariance = spine.covariance[::-1, ::-1]
    return Spine(turned, spine.length, spine.variance, covariance, s, spine.points[::-1], spine.weights[::-1])


def _knots(start: float, end: float, spacing: float) -> Floats:
    pieces = max(1, round((end - start) / spacing))
    inner = np.linspace(start, end, pieces + 1)
    return np.concatenate([[start] * 3, inner, [end] * 3])
