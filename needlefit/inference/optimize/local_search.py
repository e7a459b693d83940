"""Search from one start: the algorithms of a recipe in turn, then a check that the end is a minimum.

A search ends by its tolerance on a plateau and in a narrow valley as well as at a minimum. Where the
objective is a sum of squares the exact Jacobian J distinguishes them: the best step s within the bounds of
the linear problem, min |r + J s|, would gain next to nothing at a minimum.
"""

import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Literal

import nlopt
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from needlefit.arrays import Floats
from needlefit.errors import ConfigError
from needlefit.inference.evaluation_recorder import EvaluationRecorder, SearchEnded
from needlefit.inference.fit import INTERRUPTED, Start, StartPoint
from needlefit.inference.objective import ObjectiveFunction
from needlefit.inference.optimize import least_squares_search, nlopt_search
from needlefit.project.progress import never_stop
from needlefit.schemas.recipe import RecipeRecord


@dataclass(frozen=True)
class Algorithm:
    """One search algorithm that a recipe may name.

    Attributes
    ----------
    run : callable
        Recorder, theta to start from (P,), tolerance of the recipe -> why it ended.
    needs : "value", "gradient" or "jacobian"
        What of the objective function it evaluates.
    stochastic : bool
        Whether it draws random numbers.
    dimensions : int
        The fewest free parameters that it can search; below, Nelder-Mead takes its place.
    """

    run: Callable[[EvaluationRecorder, Floats, float], str]
    needs: Literal["value", "gradient", "jacobian"] = "value"
    stochastic: bool = False
    dimensions: int = 1


def _run_least_squares(recorder: EvaluationRecorder, start: Floats, tolerance: float) -> str:
    return least_squares_search.run_least_squares(
        recorder, start
    )  # its end is rounding, whatever the recipe's tolerance


def _run_nlopt(
    code: int, with_gradient: bool, recorder: EvaluationRecorder, start: Floats, tolerance: float
) -> str:
    return nlopt_search.run_nlopt(recorder, code, with_gradient, tolerance, start)


def _without_gradient(code: int, stochastic: bool = False, dimensions: int = 1) -> Algorithm:
    return Algorithm(partial(_run_nlopt, code, False), "value", stochastic, dimensions)


def _with_gradient(code: int) -> Algorithm:
    return Algorithm(partial(_run_nlopt, code, True), "gradient")


ALGORITHMS = {
    "leastsquares": Algorithm(_run_least_squares, "jacobian"),
    "slsqp": _with_gradient(nlopt.LD_SLSQP),
    "lbfgs": _with_gradient(nlopt.LD_LBFGS),
    "var2": _with_gradient(nlopt.LD_VAR2),
    "tnewton": _with_gradient(nlopt.LD_TNEWTON_PRECOND_RESTART),
    "mma": _with_gradient(nlopt.LD_MMA),
    "ccsaq": _with_gradient(nlopt.LD_CCSAQ),
    "sbplx": _without_gradient(nlopt.LN_SBPLX),
    "bobyqa": _without_gradient(nlopt.LN_BOBYQA, dimensions=2),
    "neldermead": _without_gradient(nlopt.LN_NELDERMEAD),
    "cobyla": _without_gradient(nlopt.LN_COBYLA),
    "praxis": _without_gradient(nlopt.LN_PRAXIS, stochastic=True, dimensions=2),
    "crs2": _without_gradient(nlopt.GN_CRS2_LM, stochastic=True),
    "isres": _without_gradient(nlopt.GN_ISRES, stochastic=True),
    "esch": _without_gradient(nlopt.GN_ESCH, stochastic=True),
}
"""Algorithms that a recipe may name: `leastsquares`, `bobyqa+neldermead`, `crs2+slsqp`."""


def select_algorithms(name: str, objective_function: ObjectiveFunction) -> tuple[Algorithm, ...]:
    """Return the algorithms that a recipe's `algorithm` names, e.g. `crs2+leastsquares`.

    Raises
    ------
    ConfigError
        If one of them is unknown, or needs a derivative that the objective function lacks.
    """
    parts = [part.strip() for part in name.split("+")]
    unknown = [part for part in parts if part not in ALGORITHMS]
    if unknown:
        raise ConfigError(
            f"there is no algorithm `{unknown[0]}`",
            where="recipe, key `algorithm` or `metric_algorithm`",
            expected=f"one of {', '.join(ALGORITHMS)}, or several joined by +",
            fix="correct its name",
        )
    has = {
        "value": objective_function.value,
        "gradient": objective_function.gradient,
        "jacobian": objective_function.jacobian,
    }
    for part in parts:
        if has[ALGORITHMS[part].needs] is None:
            raise ConfigError(
                f"`{part}` needs a {ALGORITHMS[part].needs}, which what is minimised has not",
                where="recipe, key `algorithm` or `metric_algorithm`",
                expected="slsqp or bobyqa+neldermead: a metric, or depths by quadrature, are no squares",
            )
    named = (ALGORITHMS[part] for part in parts)
    return tuple(
        a if len(objective_function.lower) >= a.dimensions else ALGORITHMS["neldermead"] for a in named
    )


MAX_REMAINING_GAIN = 1e-6
"""Largest gain of the value that a further step may promise; in units of the mean square where that is above
1, because rounding grows with it, or where nothing says what is negligible."""

NEGLIGIBLE_STEP = 1e-8
"""A further step that changes no parameter by more than this part of it promises nothing."""

FLAT_FRACTION = 1e-8
"""A parameter whose whole scale moves the residuals by less than this part of them has no effect; neither
has a combination of parameters whose effects cancel to this part of each."""


def certify_minimum(recorder: EvaluationRecorder, reason: str) -> str:
    """Check the best point of a search, and return why the search ended: "tolerance" only at a minimum.

    "stalled" is no minimum, "flat" one in which some parameter or combination has no effect, "bound" one only
    because the box ends there. A function that is no sum of squares keeps the reason that the algorithm gave.
    """
    settled = reason in ("tolerance", "roundoff") or reason.startswith("nlopt failed")
    if (
        not settled
        or recorder.theta is None
        or recorder.objective_function.jacobian is None
        or not len(recorder.theta)
    ):
        return reason
    found, recorder.reason = recorder.linearized, ""
    recorder.budget = recorder.evaluations + 1  # this evaluation is no part of the search
    with suppress(SearchEnded):
        found = found or recorder.jacobian(recorder.theta)
    return recorder.reason or reason if found is None else _classify_minimum(recorder, *found)


def _classify_minimum(recorder: EvaluationRecorder, residuals: Floats, jacobian: Floats) -> str:
    assert recorder.theta is not None
    objective_function, theta = recorder.objective_function, recorder.theta
    spans = objective_function.upper - objective_function.lower
    # columns per whole range compare parameters of different units; without a range the value itself is the
    # scale
    scales = np.where(np.isfinite(spans), spans, np.maximum(np.abs(theta), 1e-300))
    columns = jacobian * scales  # (R, P) per whole scale of each parameter
    # the norms also scale the columns to length 1 below, so that the singular values measure directions alone
    lengths = np.linalg.norm(columns, axis=0)
    free = _find_free(recorder, residuals @ jacobian)
    if not np.any(free):
        return "bound"
    if np.any(lengths[free] <= FLAT_FRACTION * np.linalg.norm(residuals)):
        return "flat"
    directions = columns[:, free] / lengths[free]
    if np.linalg.svd(directions, compute_uv=False)[-1] <= FLAT_FRACTION:
        return "flat"
    unit = scales[free] / lengths[free]
    low, high = (
        (objective_function.lower - theta)[free] / unit,
        (objective_function.upper - theta)[free] / unit,
    )
    best = lsq_linear(directions, -residuals, (np.minimum(low, 0), np.maximum(high, 0)))
    gain = 0.5 * float(residuals @ residuals) - best.cost
    small = np.all(np.abs(best.x * unit) <= NEGLIGIBLE_STEP * np.abs(theta[free]))
    mean = float(residuals @ residuals) / max(1, len(residuals) - len(theta))
    unit_gain = max(1.0, mean) if objective_function.absolute_tolerance else mean
    if not small and gain > MAX_REMAINING_GAIN * unit_gain:
        return "stalled"
    return "tolerance" if np.all(free) else "bound"


def _find_free(recorder: EvaluationRecorder, slope: Floats) -> NDArray[np.bool_]:
    """Return which parameters (P,) are not held by a bound that the value falls towards."""
    assert recorder.theta is not None
    objective_function, theta = recorder.objective_function, recorder.theta
    held_low = (theta - objective_function.lower <= NEGLIGIBLE_STEP * np.maximum(1, np.abs(theta))) & (
        slope > 0
    )
    held_high = (objective_function.upper - theta <= NEGLIGIBLE_STEP * np.maximum(1, np.abs(theta))) & (
        slope < 0
    )
    return ~(held_low | held_high)


_NLOPT_LOCK = (
    threading.Lock()
)  # a build of nlopt without thread-local storage has one generator for all threads


def search(
    objective_function: ObjectiveFunction,
    recipe: RecipeRecord,
    start_point: StartPoint,
    stop: Callable[[], bool] = never_stop,
) -> Start:
    """Search from one start with a recipe's algorithm, tolerance and budget.

    Returns
    -------
    Start
        The best point, and why the search ended: "tolerance" if at a minimum, as far as can be determined.
    """
    plan = select_algorithms(recipe.algorithm, objective_function)
    recorder = EvaluationRecorder(objective_function, recipe.evaluations, stop)
    theta0 = np.array(start_point.theta, dtype=np.float64)
    if any(algorithm.stochastic for algorithm in plan):
        with _NLOPT_LOCK:
            nlopt_search.seed_nlopt(start_point.seed)
            reason = _run_stages(recorder, plan, recipe.tolerance, theta0)
    else:
        reason = _run_stages(recorder, plan, recipe.tolerance, theta0)
    if recorder.theta is None and reason != INTERRUPTED:
        reason = "no finite value"
    return Start(
        index=start_point.index,
        theta0=start_point.theta,
        theta=start_point.theta if recorder.theta is None else tuple(recorder.theta.tolist()),
        objective=recorder.objective,
        evaluations=recorder.evaluations,
        gradients=recorder.gradients,
        failures=recorder.failures,
        stopped=reason,
        failed=tuple(recorder.failed),
    )


def _run_stages(
    recorder: EvaluationRecorder, plan: tuple[Algorithm, ...], tolerance: float, theta0: Floats
) -> str:
    """Run the stages, each with its share of what is left of the budget; return why the last one ended."""
    total, reason = recorder.budget, ""
    for k, algorithm in enumerate(plan):
        remaining = total - recorder.evaluations
        # -(-a // b) rounds up: the stages share the rest of the budget, the first ones get the odd evaluation
        recorder.budget, recorder.reason = recorder.evaluations + -(-remaining // (len(plan) - k)), ""
        reason = algorithm.run(recorder, theta0 if recorder.theta is None else recorder.theta, tolerance)
        if reason == INTERRUPTED:
            return reason
    return certify_minimum(recorder, reason)
