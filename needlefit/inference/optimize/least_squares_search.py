"""Run one stage of a search by nonlinear least squares, with the exact Jacobian, in theta itself.

SciPy's trust region method within the bounds. As with nlopt, the best point is the recorder's own.
"""

from contextlib import suppress

import numpy as np
from scipy.optimize import least_squares

from needlefit.arrays import Floats
from needlefit.inference.evaluation_recorder import EvaluationRecorder, SearchEnded

MIN_TOLERANCE = 1e-15
"""Relative change of the sum of squares, and of theta, under which it ends, unless more is negligible."""

TYPICAL_HALF_SQUARES = 1e2
"""About as large as half the squares are at their least: a part of them is negligible."""

SUM_TOLERANCE, CONSTANT_ROUNDING = 1e-6, 1e-12
"""Differences between value and sum of squares from which on one does not stand for the other: of the best
value, and of the first one, next to which the constant between them was found."""


def run_least_squares(recorder: EvaluationRecorder, start: Floats) -> str:
    """Search from theta `start` (P,); return why it ended."""
    reason = ""
    with suppress(SearchEnded):
        reason = _run_scipy(recorder, start)
    return recorder.reason or reason


def _run_scipy(recorder: EvaluationRecorder, start: Floats) -> str:
    if not recorder.find_constant(start):
        return "failed at its start"
    first = abs(recorder.objective)
    small = max(MIN_TOLERANCE, recorder.objective_function.absolute_tolerance / TYPICAL_HALF_SQUARES)
    if len(start) == 0:
        return "tolerance"

    cached = _CachedJacobian(recorder)
    found = least_squares(
        cached.residuals,
        np.clip(start, recorder.objective_function.lower, recorder.objective_function.upper),
        jac=cached.slopes,
        bounds=(recorder.objective_function.lower, recorder.objective_function.upper),
        x_scale="jac",
        ftol=small,
        xtol=small,
        gtol=None,  # absolute: it would depend on the units of theta
        max_nfev=recorder.budget,  # the recorder ends it, which counts the Jacobians too
    )
    return _verify_sum(recorder, CONSTANT_ROUNDING * first, "tolerance" if found.status > 0 else "budget")


class _CachedJacobian:
    """Residuals and Jacobian from one evaluation: SciPy asks for both at almost every point.

    Attributes
    ----------
    theta, slopes : (P,) and (R, P) arrays
        Where it was asked last, and the Jacobian there; None if there is none.
    """

    def __init__(self, recorder: EvaluationRecorder) -> None:
        self._recorder = recorder
        self._theta: Floats | None = None
        self._slopes: Floats | None = None

    def residuals(self, theta: Floats) -> Floats:
        """Return (R,); a single infinite one where they failed."""
        found = self._recorder.jacobian(theta)
        self._theta, self._slopes = theta.copy(), None if found is None else found[1]
        # one infinite residual is enough: SciPy rejects the step and shortens it
        return np.array([np.inf]) if found is None else found[0]

    def slopes(self, theta: Floats) -> Floats:
        """Return the Jacobian (R, P); where it cannot be computed the search ends with its best point."""
        if self._theta is None or not np.array_equal(theta, self._theta):
            self.residuals(theta)
        if self._slopes is None:
            self._recorder.reason = "no Jacobian"
            raise SearchEnded
        return self._slopes


def _verify_sum(recorder: EvaluationRecorder, rounding: float, reason: str) -> str:
    """Compare the best sum of squares with the value that it stands for."""
    assert recorder.theta is not None
    # the value is computed anew: residuals stand for it only if they are a complete sum of squares
    claimed = recorder.objective
    recorder.budget = max(
        recorder.budget, recorder.evaluations + 1
    )  # this evaluation is no part of the search
    recorder.objective = recorder.value(recorder.theta)
    if abs(recorder.objective - claimed) > SUM_TOLERANCE * (1 + abs(claimed)) + rounding:
        return "no sum of squares"
    return reason
