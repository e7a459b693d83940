"""Descent of a sum of squares to its nearest minimum within bounds, one parameter held if wanted.

Gauss-Newton steps from the exact Jacobian, bounded by the box and by a radius about the last point: each
step is a small linear least-squares problem with bounds, so parameters may come to rest at their bounds.
"""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from needlefit.inference.goal import Box
from needlefit.inference.ledger import FAILURES
from needlefit.schemas.recipe import ObjectiveName

Floats = NDArray[np.float64]

GAIN = 1e-3
"""A minimum is reached where a further step would lessen the sum of squares by less than this."""

RADIUS = 2.0
"""Longest first step along any parameter: of a logarithm, or of alpha."""

MOST = 40
"""Evaluations after which a descent gives up."""


class Squares(Box, Protocol):
    """A sum of squares; `Problem` is one: its log posterior is constant - |residuals|^2 / 2."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters, P of them."""

    def jacobian(self, theta: Floats) -> tuple[Floats, Floats]:
        """Return residuals (R,) and their derivatives (R, P); not finite where they cannot be computed."""

    def approach(self, minimized: ObjectiveName) -> "Squares | None":
        """Return a cheaper sum of squares with its minima close by; None if there is none."""


@dataclass(frozen=True)
class Settled:
    """Where a descent ended.

    Attributes
    ----------
    theta : (P,) array
    value : float
        Sum of squares; infinite where it cannot be computed.
    slope : (P,) array
        Its derivatives.
    information : (P, P) array
        J^T J.
    evaluations : int
    converged : bool
        Whether this is a minimum, as far as steps from it tell.
    """

    theta: Floats
    value: float
    slope: Floats
    information: Floats
    evaluations: int = 1
    converged: bool = False


def settle(target: Squares, theta: Floats, held: int | None = None, most: int = MOST) -> Settled:
    """Return the minimum nearest to `theta` (P,), with parameter `held` as it is there."""
    moving = np.arange(len(theta)) != held
    lower, upper = target.lower[moving], target.upper[moving]
    at = _look(target, np.clip(theta, target.lower, target.upper))
    radius, evaluations, converged = RADIUS, 1, not moving.any()
    while math.isfinite(at.value) and evaluations < most and not converged:
        room = np.maximum(lower - at.theta[moving], -radius), np.minimum(upper - at.theta[moving], radius)
        step = _step(at, moving, room)
        gain = -float(at.slope[moving] @ step + step @ at.information[np.ix_(moving, moving)] @ step)
        converged = gain < GAIN
        if converged:
            break
        ahead = at.theta.copy()
        ahead[moving] += step
        trial = _look(target, np.clip(ahead, target.lower, target.upper))
        evaluations += 1
        share = (at.value - trial.value) / gain
        if share > 0.75:
            radius *= 2
        elif not share > 0.25:
            radius = 0.25 * float(np.max(np.abs(step)))
        at = trial if share > 0 else at
    return Settled(at.theta, at.value, at.slope, at.information, evaluations, converged)


def _step(at: Settled, moving: NDArray[np.bool_], room: tuple[Floats, Floats]) -> Floats:
    """Return the step (Q,) within `room` that would be best if residuals were linear."""
    information = at.information[np.ix_(moving, moving)]
    precision, axes = np.linalg.eigh(information)
    root = np.sqrt(np.maximum(precision, 1e-12 * max(float(precision[-1]), 1e-300)))
    rows, wanted = (
        root[:, None] * axes.T,
        -0.5 * (axes.T @ at.slope[moving]) / root,
    )
    step: Floats = lsq_linear(rows, wanted, bounds=room, method="bvls").x
    return step


def _look(target: Squares, theta: Floats) -> Settled:
    try:
        residuals, slopes = target.jacobian(theta)
    except FAILURES:
        residuals, slopes = np.array([math.nan]), np.zeros((1, len(theta)))
    if not (np.all(np.isfinite(residuals)) and np.all(np.isfinite(slopes))):
        nothing = np.zeros(len(theta))
        return Settled(theta, math.inf, nothing, np.outer(nothing, nothing))
    return Settled(theta, float(residuals @ residuals), 2 * residuals @ slopes, slopes.T @ slopes)
