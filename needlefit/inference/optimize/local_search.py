"""Search from one start: the algorithms of a recipe in turn, then a check that the end is a minimum.

nlopt reports success on a NaN, forgets the best point when it is stopped, and breaks or crashes on values
that are not finite. So nothing that it returns is used: every evaluation goes through an
`EvaluationRecorder`, which keeps the best point, counts, and ends the search; nlopt only gets finite numbers.
It works in the unit cube, where one step size and one tolerance suit all parameters.

A search ends by its tolerance on a plateau and in a narrow valley as well as at a minimum. Where the
objective is a sum of squares the exact Jacobian J distinguishes them: the best step s within the bounds of
the linear problem, min |r + J s|, would gain next to nothing at a minimum.
"""

import math
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
from needlefit.inference.fit import INTERRUPTED, Start, StartPoint
from needlefit.inference.objective import EvaluationRecorder, ObjectiveFunction, SearchEnded
from needlefit.inference.optimize.least_squares_search import run_least_squares
from needlefit.project.progress import never_stop
from needlefit.schemas.recipe import RecipeRecord

FIRST_STEP = 0.25  #: initial step of a local search without gradients, as a part of each parameter's range
FIRST_GRADIENT_STEP = 0.1  #: first step of a search by gradients, likewise
#: step, likewise, under which a search by gradients for the peak of a posterior ends
GRADIENT_STEP_TOLERANCE = 1e-12
#: relative gain of a restarted gradient search that counts as none, unless the caller states another
MIN_RELATIVE_GAIN = 1e-6
#: shown to nlopt for a value that is not finite, until finite ones are known; then 2 * worst + 1 is
PENALTY = 1e3
#: relative change of the value under which a search ends, as a part of the recipe's tolerance
VALUE_TOLERANCE = 0.1


def run_nlopt(
    code: int, with_gradient: bool, recorder: EvaluationRecorder, start: Floats, tolerance: float
) -> str:
    """Search with nlopt's algorithm `code` from theta `start` (P,), with or without gradients; return why it
    ended.

    A search by slopes is begun anew where it ended until that gains nothing: some end in a narrow valley.
    """
    if len(start) == 0:
        with suppress(SearchEnded):
            recorder.value(start)
        return recorder.reason or "tolerance"
    reason = _run_once(recorder, code, with_gradient, tolerance, start)
    while with_gradient and not recorder.reason and recorder.theta is not None:
        before = recorder.objective
        reason = _run_once(recorder, code, with_gradient, tolerance, recorder.theta)
        if before - recorder.objective <= (
            recorder.objective_function.absolute_tolerance or MIN_RELATIVE_GAIN * abs(before)
        ):
            break
    return reason


def _run_once(
    recorder: EvaluationRecorder, code: int, with_gradient: bool, tolerance: float, start: Floats
) -> str:
    lower, span = (
        recorder.objective_function.lower,
        recorder.objective_function.upper - recorder.objective_function.lower,
    )
    optimizer = nlopt.opt(code, len(start))
    try:
        scale = _choose_scale(recorder, start, span) if with_gradient else 1.0
    except SearchEnded:
        return recorder.reason
    _configure(optimizer, tolerance, recorder.objective_function.absolute_tolerance * scale, with_gradient)
    bugs: list[BaseException] = []

    def function(cube: Floats, slope: Floats) -> float:
        try:
            value = scale * _evaluate(recorder, lower + cube * span, slope, scale * span)
        except SearchEnded:
            value = math.inf
            optimizer.force_stop()
        except BaseException as error:
            value = math.inf
            bugs.append(error)
            optimizer.force_stop()
        # above every finite value seen, so that nlopt moves away; 1 is added for values near 0
        worst = scale * (2 * abs(recorder.worst) + 1) if math.isfinite(recorder.worst) else PENALTY
        return value if math.isfinite(value) else worst

    # Nothing is raised inside: some algorithms call on after an exception, which Python does not survive.
    optimizer.set_min_objective(function)
    reason = _run(optimizer, np.clip((start - lower) / span, 0.0, 1.0))
    if bugs:
        raise bugs[0]
    return recorder.reason or reason


def _choose_scale(recorder: EvaluationRecorder, start: Floats, span: Floats) -> float:
    """Return what the value is multiplied by, so that the first step along its slope is `FIRST_GRADIENT_STEP`
    long.

    Methods that know no curvature at first take the slope for the step: from a bad start, where a log
    posterior falls by 1e5 over the box, that leads into a corner, from which line searches fail.
    """
    steepness = float(np.linalg.norm(recorder.gradient(start)[1] * span))
    return FIRST_GRADIENT_STEP / steepness if steepness > 0 else 1.0


def _evaluate(recorder: EvaluationRecorder, theta: Floats, slope: Floats, span: Floats) -> float:
    """Return the value; with its slope along the cube written into `slope` (P,), if that is asked for."""
    if slope.size == 0:
        return recorder.value(theta)
    slope[:] = 0.0
    value, gradient = recorder.gradient(theta)
    # nlopt reads the gradient from this buffer: it must be filled in place; span is the chain rule of the
    # unit cube
    slope[:] = gradient * span
    return value


def _configure(
    optimizer: "nlopt.opt", tolerance: float, absolute_tolerance: float, with_gradient: bool
) -> None:
    """Set bounds, first step, and when to end: gradients reach a minimum to rounding, values do not."""
    dimensions = optimizer.get_dimension()
    optimizer.set_lower_bounds(np.zeros(dimensions))
    optimizer.set_upper_bounds(np.ones(dimensions))
    optimizer.set_initial_step(np.full(dimensions, FIRST_STEP))
    optimizer.set_xtol_abs(
        np.full(dimensions, GRADIENT_STEP_TOLERANCE if with_gradient and absolute_tolerance else tolerance)
    )
    if absolute_tolerance:
        optimizer.set_ftol_abs(absolute_tolerance)
    else:
        optimizer.set_ftol_rel(tolerance * VALUE_TOLERANCE)


def _run(optimizer: "nlopt.opt", start: Floats) -> str:
    """Return why nlopt ended; its answer is not looked at."""
    try:
        optimizer.optimize(start)
    except nlopt.ForcedStop:
        return "stopped"
    except nlopt.RoundoffLimited:
        return "roundoff"
    except (nlopt.exception, RuntimeError, ValueError, MemoryError) as error:
        return f"nlopt failed: {error}"
    return "tolerance"


@dataclass(frozen=True)
class Algorithm:
    """One search algorithm that a recipe may name."""

    #: recorder, theta to start from (P,), tolerance of the recipe -> why it ended
    run: Callable[[EvaluationRecorder, Floats, float], str]
    needs: Literal["value", "gradient", "jacobian"] = "value"  #: what of the objective function it evaluates
    stochastic: bool = False  #: whether it draws random numbers
    dimensions: int = 1  #: the fewest free parameters that it can search; below, Nelder-Mead takes its place


def _use_values(code: int, stochastic: bool = False, dimensions: int = 1) -> Algorithm:
    return Algorithm(partial(run_nlopt, code, False), "value", stochastic, dimensions)


def _use_gradients(code: int) -> Algorithm:
    return Algorithm(partial(run_nlopt, code, True), "gradient")


ALGORITHMS = {
    "leastsquares": Algorithm(run_least_squares, "jacobian"),
    "slsqp": _use_gradients(nlopt.LD_SLSQP),
    "lbfgs": _use_gradients(nlopt.LD_LBFGS),
    "var2": _use_gradients(nlopt.LD_VAR2),
    "tnewton": _use_gradients(nlopt.LD_TNEWTON_PRECOND_RESTART),
    "mma": _use_gradients(nlopt.LD_MMA),
    "ccsaq": _use_gradients(nlopt.LD_CCSAQ),
    "sbplx": _use_values(nlopt.LN_SBPLX),
    "bobyqa": _use_values(nlopt.LN_BOBYQA, dimensions=2),
    "neldermead": _use_values(nlopt.LN_NELDERMEAD),
    "cobyla": _use_values(nlopt.LN_COBYLA),
    "praxis": _use_values(nlopt.LN_PRAXIS, stochastic=True, dimensions=2),
    "crs2": _use_values(nlopt.GN_CRS2_LM, stochastic=True),
    "isres": _use_values(nlopt.GN_ISRES, stochastic=True),
    "esch": _use_values(nlopt.GN_ESCH, stochastic=True),
}  #: algorithms that a recipe may name: `leastsquares`, `bobyqa+neldermead`, `crs2+slsqp`


def select_algorithms(name: str, objective_function: ObjectiveFunction) -> tuple[Algorithm, ...]:
    """Return the algorithms that a recipe's `algorithm` names, e.g. `crs2+leastsquares`.

    Raises ConfigError if one of them is unknown, or needs a derivative that the objective function lacks.
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


#: largest gain of the value that a further step may promise; in units of the mean square where that is above
#: 1, because rounding grows with it, or where nothing says what is negligible
MAX_REMAINING_GAIN = 1e-6
#: a further step that changes no parameter by more than this part of it promises nothing
NEGLIGIBLE_STEP = 1e-8
#: a parameter whose whole scale moves the residuals by less than this part of them has no effect; neither has
#: a combination of parameters whose effects cancel to this part of each
FLAT_FRACTION = 1e-8


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
            nlopt.srand(start_point.seed)
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
