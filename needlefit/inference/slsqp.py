"""Search by gradients with nlopt's SLSQP.

nlopt reports success on a NaN, forgets the best point when it is stopped, and breaks or crashes on values
that are not finite. So nothing that it returns is used: every evaluation goes through an
`EvaluationRecorder`, which keeps the best point, counts, and ends the search; nlopt only gets finite numbers.
"""

import math
from collections.abc import Callable
from contextlib import suppress

import nlopt
import numpy as np

from needlefit.arrays import Floats
from needlefit.inference.fit import EvaluationRecorder, SearchEnded

FIRST_GRADIENT_STEP = 0.1  #: first step of a search by gradients, as a fraction of each parameter's range
#: smallest relative gain of a restarted gradient search that counts
MIN_RELATIVE_GAIN = 1e-6
#: value that nlopt gets in place of one that is not finite, until finite ones are known; then it gets 2 *
#: worst + 1
PENALTY = 1e3
#: relative change of the value under which a search ends, as a fraction of the recipe's tolerance
VALUE_TOLERANCE = 0.1


def run_slsqp(recorder: EvaluationRecorder, start: Floats, tolerance: float) -> str:
    """Search by gradients with nlopt's SLSQP from theta `start` (P,); return why it ended.

    It is begun anew where it ended until that gains nothing: some end in a narrow valley.
    """
    if len(start) == 0:
        with suppress(SearchEnded):
            recorder.value(start)
        return recorder.reason or "tolerance"
    reason = run_slsqp_once(recorder, tolerance, start)
    while not recorder.reason and recorder.theta is not None:
        before = recorder.objective
        reason = run_slsqp_once(recorder, tolerance, recorder.theta)
        if before - recorder.objective <= MIN_RELATIVE_GAIN * abs(before):
            break
    return reason


def run_slsqp_once(recorder: EvaluationRecorder, tolerance: float, start: Floats) -> str:
    """Search as `run_slsqp`, without a new beginning."""
    lower, span = recorder.objective_function.lower, recorder.objective_function.span
    optimizer = nlopt.opt(nlopt.LD_SLSQP, len(start))
    # The first step along the slope is to be `FIRST_GRADIENT_STEP` long. A method that knows no curvature at
    # first takes the slope for the step: a steep one leads into a corner, from which line searches fail.
    try:
        steepness = float(np.linalg.norm(recorder.gradient(start)[1] * span))
    except SearchEnded:
        return recorder.reason
    scale = FIRST_GRADIENT_STEP / steepness if steepness > 0 else 1.0
    optimizer.set_lower_bounds(np.zeros(len(start)))
    optimizer.set_upper_bounds(np.ones(len(start)))
    optimizer.set_xtol_abs(np.full(len(start), tolerance))
    optimizer.set_ftol_rel(tolerance * VALUE_TOLERANCE)
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


FAILED = "nlopt failed"  #: reason why a search ended in which nlopt gave up


def _run(optimizer: "nlopt.opt", start: Floats) -> str:
    """Return why nlopt ended; its answer is not looked at."""
    try:
        optimizer.optimize(start)
    except nlopt.ForcedStop:
        return "stopped"
    except nlopt.RoundoffLimited:
        return "roundoff"
    except (nlopt.exception, RuntimeError, ValueError, MemoryError):
        return FAILED
    return "tolerance"


MAX_STEP_EVALUATIONS = 60  #: largest number of evaluations of the excess in the search for one step


def find_farthest_step(
    along: Floats,
    excess: Callable[[Floats], tuple[float, Floats]],
    bounds: tuple[Floats, Floats],
    slack: float,
    tolerance: float,
) -> Floats:
    """Return the step (P,) within bounds (P,) that goes farthest `along` (P,) where the excess is below 0.

    `excess` gives a value and its gradient (P,), of a function that costs little; it may be above 0 by
    `slack`. `tolerance` is of each part of the step. The step is 0 where nlopt gives up.
    """

    def backward(step: Floats, slope: Floats) -> float:
        if slope.size:
            slope[:] = -along
        return -float(along @ step)

    def beyond(step: Floats, slope: Floats) -> float:
        value, gradient = excess(step)
        if slope.size:
            slope[:] = gradient
        return value

    optimizer = nlopt.opt(nlopt.LD_SLSQP, len(along))
    optimizer.set_min_objective(backward)
    optimizer.add_inequality_constraint(beyond, slack)
    optimizer.set_lower_bounds(bounds[0])
    optimizer.set_upper_bounds(bounds[1])
    optimizer.set_xtol_abs(np.full(len(along), tolerance))
    optimizer.set_maxeval(MAX_STEP_EVALUATIONS)
    try:
        return optimizer.optimize(np.zeros(len(along)))
    except (nlopt.RoundoffLimited, RuntimeError, ValueError):
        return np.zeros(len(along))
