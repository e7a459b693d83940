"""Smoothing of noisy values whose noise nobody states: a spline with a penalty on its third derivative.

Neither the weight of the penalty nor the noise is given: both are those of the greatest restricted likelihood
(REML), where the third differences of the spline's coefficients are random. With five to ten points that is
far less often misled than cross-validation. Parabolas are never penalised: an arc of a bent needle stays one.
"""

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
import scipy

from needlefit.arrays import Floats

DEGREE = 3  # degree of the spline
PENALTY_ORDER = 3  # order of the differences that are penalised
MAX_PIECES = 40  # largest number of cubics of a spline
MAX_GAP_PIECES = 2  # largest number of cubics in a gap between places: in more the penalty alone would decide
# logarithm of the ratio of variances, penalised part to noise: the most likely of the tried ones is taken
MIN_LOG_RATIO = -30.0  # smallest logarithm that is tried
MAX_LOG_RATIO = 33.0  # largest logarithm that is tried
LOG_RATIOS = 85  # number of logarithms that are tried
MIN_RELATIVE_NOISE = 1e-9  # smallest noise, as a fraction of the values' range: less is rounding
# number of residuals that a stated noise counts as: a few points may hide theirs by chance
STATED_WEIGHT = 2.0


@dataclass(frozen=True)
class PenalizedSpline:
    """A spline fitted to values (N, d) at places between 0 and 1, linear in them once smoothed so much."""

    curve: "scipy.interpolate.BSpline"  # place (...,) -> value (..., d)
    operator: Floats  # (F, N); from values to coefficients
    noise_sd: float  # standard deviation of the noise that the values show

    @cached_property
    def slope(self) -> "scipy.interpolate.BSpline":
        """The derivative of the curve."""
        return self.curve.derivative()

    def differentiate(self, u: Floats) -> tuple[Floats, Floats]:
        """Return the derivative (K, d) at places (K,), and the matrix (K, N) that gives it of the values."""
        bases = scipy.interpolate.BSpline(self.curve.t, self.operator, DEGREE).derivative()
        return self.slope(u), bases(u)


def fit_penalized_spline(
    u: Floats, values: Floats, noisy_axes: int, stated_sd: float = 0.0
) -> PenalizedSpline:
    """Smooth `values` (N, d) at places `u` (N,) from 0 to 1, in any order, N > 3.

    `noisy_axes`: how many of the d coordinates can show noise; a curve whose places are its own feet shows
    none along itself. `stated_sd`: standard deviation of the noise, 0 where it is unknown.
    """
    widest = float(np.diff(np.sort(u)).max())
    pieces = max(1, min(MAX_PIECES, len(u), round(MAX_GAP_PIECES / widest)))
    knots = np.arange(-DEGREE, pieces + DEGREE + 1) / pieces
    design = scipy.interpolate.BSpline.design_matrix(u, knots, DEGREE, extrapolate=True).toarray()
    fixed, random = _split_coefficients(design.shape[1])
    axes, triangle = np.linalg.qr(design @ fixed)  # (N, 3)
    wiggles = design @ random
    left, sizes, right = np.linalg.svd(wiggles - axes @ (axes.T @ wiggles), full_matrices=False)
    rest = values - axes @ (axes.T @ values)
    stated = STATED_WEIGHT * stated_sd**2
    count = noisy_axes * (len(u) - PENALTY_ORDER)
    ratio, misfit = _maximize_likelihood(
        sizes, left.T @ rest, float(np.sum(rest**2)), stated, noisy_axes, count
    )
    of_random = (right.T * (ratio * sizes / (1 + ratio * sizes**2))) @ left.T  # (F - 3, N)
    of_fixed = np.linalg.solve(triangle, axes.T - (axes.T @ wiggles) @ of_random)
    operator = fixed @ of_fixed + random @ of_random
    return PenalizedSpline(
        scipy.interpolate.BSpline(knots, operator @ values, DEGREE),
        operator,
        float(np.sqrt(misfit / count)),
    )


@cache
def _split_coefficients(count: int) -> tuple[Floats, Floats]:
    """Return a basis of the coefficients that no penalty meets, (F, 3), and one of the others, (F, F - 3)."""
    differences = np.diff(np.eye(count), PENALTY_ORDER, axis=0)
    fixed: Floats = np.vander(np.linspace(-1, 1, count), PENALTY_ORDER)
    return fixed, np.asarray(np.linalg.pinv(differences), dtype=np.float64)


def _maximize_likelihood(
    sizes: Floats, parts: Floats, total: float, stated: float, noisy_axes: int, count: int
) -> tuple[float, float]:
    """Return the most likely ratio of variances, and the weighted sum of squares that it leaves.

    `sizes` (r,): what each direction of the penalised part adds to the values; `parts` (r, d): of the values
    along these. `total`: sum of squares of all that no parabola takes away; `stated`: what a stated noise
    adds to it. `count`: how many values show noise beside the parabola.
    """
    squares, largest, sizes = np.sum(parts**2, axis=1), sizes[0], sizes**2
    outside = max(total - float(squares.sum()), 0.0)
    outside += count * max(MIN_RELATIVE_NOISE**2 * total, np.finfo(np.float64).tiny)
    weight = count + (STATED_WEIGHT if stated else 0.0)

    def misfit(ratios: Floats) -> Floats:
        return outside + (squares / (1 + ratios)).sum(axis=-1)

    def objective(log_ratio: Floats) -> Floats:
        ratios = np.exp(log_ratio) * sizes
        grown = noisy_axes * np.log1p(ratios).sum(axis=-1)
        return grown + weight * np.log(misfit(ratios) + stated)

    # relative to the largest direction, so that the range fits values of any count and unit
    grid = np.linspace(MIN_LOG_RATIO, MAX_LOG_RATIO, LOG_RATIOS)[:, None] - 2 * np.log(largest)
    best, step = float(grid[np.argmin(objective(grid)), 0]), float(grid[1, 0] - grid[0, 0])
    optimum = scipy.optimize.minimize_scalar(
        lambda logarithm: float(objective(np.array(logarithm))),
        bounds=(best - step, best + step),
        method="bounded",
    )
    return float(np.exp(optimum.x)), float(misfit(np.exp(optimum.x) * sizes))
