"""Search for the least sum of squares with the exact Jacobian, and check the end of a search.

SciPy's trust region method within the bounds comes near a minimum, in theta itself. It takes J^T J for the
second derivatives, which leaves out those of the residuals: where these matter each step gains the same part
of what is left. So the last steps are Newton's, with the missing part estimated from the changes of J^T r, as
in NL2SOL (Dennis, Gay and Welsch, https://doi.org/10.1145/355958.355965). Where they fail SciPy's method goes
on.

A search ends by its tolerance on a plateau and in a narrow valley as well as at a minimum. The exact Jacobian
J distinguishes them: the best step s within the bounds of the linear problem, min |r + J s|, would gain next
to nothing at a minimum.
"""

from contextlib import suppress

import numpy as np
from scipy.optimize import least_squares, lsq_linear

from needlefit.arrays import Floats
from needlefit.inference.fit import EvaluationRecorder, SearchEnded, half_square
from needlefit.inference.slsqp import FAILED

#: relative change of the sum of squares, and of theta, under which a search ends, unless more is negligible
MIN_TOLERANCE = 1e-15
#: typical least value of half the squares: a change by a fraction of it is negligible
TYPICAL_HALF_SQUARES = 1e2
NEAR_TOLERANCE = 1e-2  #: relative change of the sum of squares by a step under which a minimum is near
#: number of Newton's steps in a row that increase the sum of squares, after which the method is left
MAX_FAILED_STEPS = 3
#: smallest cosine between a step and the change of the gradient that gives a curvature along the step
MIN_COSINE = 1e-6
MAX_SIDES = 8  #: largest number of rounds in which the parameters at their bounds are searched
#: increase of the sum of squares, as a fraction of it, that may be rounding of the simulation
VALUE_ROUNDING = 1e-9


def run_least_squares(recorder: EvaluationRecorder, start: Floats) -> str:
    """Search from theta `start` (P,), to rounding; return why it ended.

    Raises SearchEnded where the recorder ends it.
    """
    if not recorder.find_constant(start):
        return "failed at its start"
    small = max(MIN_TOLERANCE, recorder.objective_function.absolute_tolerance / TYPICAL_HALF_SQUARES)
    if len(start) == 0:
        return "tolerance"

    lower, upper = recorder.objective_function.lower, recorder.objective_function.upper
    steps = _ScipySteps(recorder, small)
    try:
        solution = least_squares(
            steps.residuals,
            np.clip(start, lower, upper),
            jac=steps.slopes,
            bounds=(lower, upper),
            x_scale="jac",
            ftol=small,
            xtol=small,
            gtol=None,  # absolute: it would depend on the units of theta
            max_nfev=recorder.budget,  # the recorder ends it, which counts the Jacobians too
        )
        reason = "tolerance" if solution.status > 0 else "budget"
    except _Converged:
        reason = "tolerance"
    # of large squares at the start their constant lost digits; this evaluation is no part of the search
    recorder.budget = max(recorder.budget, recorder.evaluations + 1)
    assert recorder.theta is not None
    recorder.objective = recorder.value(recorder.theta)
    return reason


class _Converged(Exception):  # noqa: N818  (no error: the way out of SciPy's method)
    """Raised to leave SciPy's method where Newton's steps have converged."""


def _run_newton(
    recorder: EvaluationRecorder, theta: Floats, linearized: tuple[Floats, Floats], small: float
) -> bool:
    """Take Newton's steps from theta (P,), with its residuals and Jacobian; return whether they converged."""
    lower, upper = recorder.objective_function.lower, recorder.objective_function.upper
    curvature = np.zeros((len(theta), len(theta)))  # what J^T J lacks
    failed = 0
    while failed < MAX_FAILED_STEPS:
        residuals, jacobian = linearized
        value, slope = half_square(residuals), residuals @ jacobian
        step = find_step(slope, jacobian.T @ jacobian + curvature, lower - theta, upper - theta)
        if step is None:
            return False
        gain = -0.5 * float(slope @ step)
        if gain <= max(recorder.objective_function.absolute_tolerance, small * value):
            return True
        tried = recorder.jacobian(theta + step) if gain <= NEAR_TOLERANCE * value else None
        if tried is None:
            return False
        # a step too far says as much of the curvature as another one
        change = tried[0] @ (tried[1] - jacobian)
        curvature = _update_curvature(curvature, step, change, tried[0] @ tried[1] - slope)
        if half_square(tried[0]) <= (1 + VALUE_ROUNDING) * value:
            theta, linearized, failed = np.clip(theta + step, lower, upper), tried, 0
        else:
            failed += 1
    return False


def find_step(slope: Floats, curvature: Floats, low: Floats, high: Floats) -> Floats | None:
    """Return the step (P,) to the minimum of a quadratic function between two bounds; None if it has none.

    Which parameters lie at their bounds is sought as by M. Hintermueller, K. Ito and K. Kunisch
    (https://doi.org/10.1137/S1052623401383558), in two or three rounds; where it goes around in a circle, by
    SciPy's slower method.
    """
    try:
        factor = np.linalg.cholesky(curvature)
    except np.linalg.LinAlgError:
        return None
    low, high = np.minimum(low, 0.0), np.maximum(high, 0.0)
    side = np.zeros(len(slope))  # -1 and 1: at the lower and at the upper bound
    for _ in range(MAX_SIDES):
        step = np.where(side < 0, low, np.where(side > 0, high, 0.0))
        free = side == 0
        step[free] = np.linalg.solve(curvature[np.ix_(free, free)], -(slope + curvature @ step)[free])
        force = -(slope + curvature @ step) * (side != 0)  # along which the function falls
        changed = np.where(free, 1.0 * (step > high) - (step < low), side * (side * force > 0))
        if np.array_equal(changed, side):
            return step
        side = changed
    return lsq_linear(factor.T, np.linalg.solve(factor, -slope), (low, high), method="bvls").x


def _update_curvature(curvature: Floats, step: Floats, change: Floats, whole: Floats) -> Floats:
    """Return the estimate (P, P) of what J^T J lacks, after a step that changed J^T r by `whole` (P,).

    `change` (P,) is what of this the residuals' second derivatives do. The estimate is first made smaller
    where it predicted more.
    """
    along, predicted = float(whole @ step), float(step @ curvature @ step)
    if along <= MIN_COSINE * float(np.linalg.norm(whole) * np.linalg.norm(step)):
        return curvature
    if predicted:
        curvature = curvature * min(1.0, abs(float(change @ step) / predicted))
    missing = change - curvature @ step
    both = np.outer(missing, whole) + np.outer(whole, missing)
    return curvature + both / along - float(missing @ step) / along**2 * np.outer(whole, whole)


class _ScipySteps:
    """Residuals and Jacobian for SciPy's method, which asks for both at almost every point; near a minimum
    Newton's steps are tried between its own.
    """

    def __init__(self, recorder: EvaluationRecorder, small: float) -> None:
        self._recorder, self._small = recorder, small
        self._theta: Floats | None = None
        self._found: tuple[Floats, Floats] | None = None
        self._value, self._near = np.inf, NEAR_TOLERANCE

    def residuals(self, theta: Floats) -> Floats:
        """Return (R,); a single infinite one where they failed."""
        best, linearized = self._recorder.theta, self._recorder.linearized
        if best is None or linearized is None or not np.array_equal(theta, best):
            linearized = self._recorder.jacobian(theta)
        self._theta, self._found = theta.copy(), linearized
        # one infinite residual is enough: SciPy rejects the step and shortens it
        return np.array([np.inf]) if linearized is None else linearized[0]

    def slopes(self, theta: Floats) -> Floats:
        """Return the Jacobian (R, P) at a point that SciPy accepted.

        Where it cannot be computed the search ends with its best point.
        """
        if self._theta is None or not np.array_equal(theta, self._theta):
            self.residuals(theta)
        if self._found is None:
            self._recorder.reason = "no Jacobian"
            raise SearchEnded
        value, before = half_square(self._found[0]), self._value
        self._value = value
        if before - value <= self._near * value:
            if _run_newton(self._recorder, theta, self._found, self._small):
                raise _Converged
            self._near *= NEAR_TOLERANCE  # SciPy's method must come nearer before the next attempt
        return self._found[1]


#: largest gain of the value that a further step may promise at a minimum; in units of the mean square where
#: that is above 1, because rounding grows with it, or where nothing states what is negligible
MAX_REMAINING_GAIN = 1e-6
#: largest change of every parameter, as a fraction of it, by a further step that promises nothing
NEGLIGIBLE_STEP = 1e-8
#: fraction of the residuals below which a parameter has no effect, if its whole scale moves them by less;
#: neither has a combination of parameters whose effects cancel to this fraction of each
FLAT_FRACTION = 1e-8


def certify_minimum(recorder: EvaluationRecorder, reason: str) -> str:
    """Check the best point of a search, and return why the search ended: "tolerance" only at a minimum.

    "stalled" is no minimum, "flat" one in which some parameter or combination has no effect, "bound" one only
    because the box ends there. A function that is no sum of squares keeps the reason that the algorithm gave.
    """
    settled = reason in ("tolerance", "roundoff", FAILED)
    squares, theta = recorder.objective_function.jacobian is not None, recorder.theta
    if not settled or not squares or theta is None or not len(theta):
        return reason
    linearized, recorder.reason = recorder.linearized, ""
    recorder.budget = recorder.evaluations + 1  # this evaluation is no part of the search
    with suppress(SearchEnded):
        linearized = linearized or recorder.jacobian(theta)
    return recorder.reason or reason if linearized is None else _classify_minimum(recorder, *linearized)


def _classify_minimum(recorder: EvaluationRecorder, residuals: Floats, jacobian: Floats) -> str:
    assert recorder.theta is not None
    objective_function, theta = recorder.objective_function, recorder.theta
    spans = objective_function.span
    # columns per whole range compare parameters of different units; without a range the value itself is the
    # scale
    scales = np.where(np.isfinite(spans), spans, np.maximum(np.abs(theta), 1e-300))
    columns = jacobian * scales  # (R, P) per whole scale of each parameter
    # the norms also scale the columns to length 1 below, so that the singular values measure directions alone
    lengths = np.linalg.norm(columns, axis=0)
    # parameters that are not held by a bound that the value falls towards
    slope, near = residuals @ jacobian, NEGLIGIBLE_STEP * np.maximum(1, np.abs(theta))
    held = (theta - objective_function.lower <= near) & (slope > 0)
    free = ~(held | ((objective_function.upper - theta <= near) & (slope < 0)))
    if not np.any(free):
        return "bound"
    if np.any(lengths[free] <= FLAT_FRACTION * np.linalg.norm(residuals)):
        return "flat"
    directions = columns[:, free] / lengths[free]
    if np.linalg.svd(directions, compute_uv=False)[-1] <= FLAT_FRACTION:
        return "flat"
    unit = scales[free] / lengths[free]
    low = (objective_function.lower - theta)[free] / unit
    high = (objective_function.upper - theta)[free] / unit
    best = lsq_linear(directions, -residuals, (np.minimum(low, 0), np.maximum(high, 0)))
    gain = 0.5 * float(residuals @ residuals) - best.cost
    small = np.all(np.abs(best.x * unit) <= NEGLIGIBLE_STEP * np.abs(theta[free]))
    mean = float(residuals @ residuals) / max(1, len(residuals) - len(theta))
    unit_gain = max(1.0, mean) if objective_function.absolute_tolerance else mean
    if not small and gain > MAX_REMAINING_GAIN * unit_gain:
        return "stalled"
    return "tolerance" if np.all(free) else "bound"
