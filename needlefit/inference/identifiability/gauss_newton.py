"""Find the nearest minimum of a sum of squares by Gauss-Newton steps, within bounds, with one parameter held
if wanted.

Each step is a small linear least-squares problem with bounds (the box, and a radius about the last point), so
parameters may come to rest at their bounds.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from needlefit.arrays import Floats
from needlefit.inference.objective import EVALUATION_ERRORS
from needlefit.inference.problem import Problem

#: a minimum is reached where a further step would lessen the sum of squares by less than this
MIN_GAIN = 1e-3
FIRST_RADIUS = 2.0  #: longest first step along any parameter: of a logarithm, or of a shape parameter
MAX_EVALUATIONS = 40  #: evaluations after which a descent gives up


@dataclass(frozen=True)
class LocalMinimum:
    """The point where a Gauss-Newton search ended."""

    theta: Floats  #: (P,)
    value: float  #: sum of squares; infinite where it cannot be computed
    slope: Floats  #: (P,) its derivatives
    information: Floats  #: (P, P) J^T J
    evaluations: int = 1
    converged: bool = False  #: whether this is a minimum, as far as steps from it tell


def minimize_squares(
    target: Problem,
    theta: Floats,
    held: int | None = None,
    max_evaluations: int = MAX_EVALUATIONS,
    min_gain: float = MIN_GAIN,
) -> LocalMinimum:
    """Return the minimum nearest to `theta` (P,); the parameter numbered `held` keeps its value."""
    moving = np.arange(len(theta)) != held
    lower, upper = target.lower[moving], target.upper[moving]
    at = _evaluate(target, np.clip(theta, target.lower, target.upper))
    radius, evaluations, converged = FIRST_RADIUS, 1, not moving.any()
    while math.isfinite(at.value) and evaluations < max_evaluations and not converged:
        step_bounds = (
            np.maximum(lower - at.theta[moving], -radius),
            np.minimum(upper - at.theta[moving], radius),
        )
        step = _step(at, moving, step_bounds)
        # the decrease that the linear model predicts: slope is 2 J^T r, so this is -(2 r^T J s + |J s|^2)
        gain = -float(at.slope[moving] @ step + step @ at.information[np.ix_(moving, moving)] @ step)
        converged = gain < min_gain
        if converged:
            break
        ahead = at.theta.copy()
        ahead[moving] += step
        trial = _evaluate(target, np.clip(ahead, target.lower, target.upper))
        evaluations += 1
        gain_ratio = (at.value - trial.value) / gain
        if gain_ratio > 0.75:
            radius *= 2
        # written with `not`, so that a NaN shrinks the radius too
        elif not gain_ratio > 0.25:
            radius = 0.25 * float(np.max(np.abs(step)))
        at = trial if gain_ratio > 0 else at
    return LocalMinimum(at.theta, at.value, at.slope, at.information, evaluations, converged)


def _step(at: LocalMinimum, moving: NDArray[np.bool_], step_bounds: tuple[Floats, Floats]) -> Floats:
    """Return the step (Q,) within `step_bounds` that would be best if residuals were linear."""
    information = at.information[np.ix_(moving, moving)]
    precision, axes = np.linalg.eigh(information)
    # least squares needs a root of the information: eigenvalues are kept above rounding, 1e-300 guards a zero
    # matrix
    root = np.sqrt(np.maximum(precision, 1e-12 * max(float(precision[-1]), 1e-300)))
    rows, wanted = (root[:, None] * axes.T, -0.5 * (axes.T @ at.slope[moving]) / root)
    # bvls solves the box exactly; the default, trf, only approaches active bounds
    return lsq_linear(rows, wanted, bounds=step_bounds, method="bvls").x


def _evaluate(target: Problem, theta: Floats) -> LocalMinimum:
    try:
        residuals, slopes = target.jacobian(theta)
    except EVALUATION_ERRORS:
        residuals, slopes = np.array([math.nan]), np.zeros((1, len(theta)))
    if not (np.all(np.isfinite(residuals)) and np.all(np.isfinite(slopes))):
        nothing = np.zeros(len(theta))
        return LocalMinimum(theta, math.inf, nothing, np.outer(nothing, nothing))
    return LocalMinimum(theta, float(residuals @ residuals), 2 * residuals @ slopes, slopes.T @ slopes)
