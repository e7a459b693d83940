"""Run one stage of a search by one of nlopt's algorithms.

nlopt reports success on a NaN, forgets the best point when it is stopped, and breaks or crashes on values
that are not finite. So nothing that it returns is used: every evaluation goes through an
`EvaluationRecorder`, which keeps the best point, counts, and ends the search; nlopt only gets finite numbers.
It works in the unit cube, where one step size and one tolerance suit all parameters.
"""

import math
from contextlib import suppress

import nlopt
import numpy as np

from needlefit.arrays import Floats
from needlefit.inference.evaluation_recorder import EvaluationRecorder, SearchEnded

FIRST_STEP = 0.25
"""Initial step of a local search without gradients, as a part of each parameter's range."""

FIRST_GRADIENT_STEP = 0.1
"""First step of a search by gradients, likewise."""

GRADIENT_STEP_TOLERANCE = 1e-12
"""Step, likewise, under which a search by gradients for the peak of a posterior ends."""

MIN_RELATIVE_GAIN = 1e-6
"""Relative gain of a search by gradients begun anew that is none, where nothing is said to be negligible."""

PENALTY = 1e3
"""Shown to nlopt for a value that is not finite, until finite ones are known; then 2 * worst + 1 is."""

VALUE_TOLERANCE = 0.1
"""Relative change of the value under which a search ends, as a part of the recipe's tolerance."""


def run_nlopt(
    recorder: EvaluationRecorder, code: int, with_gradient: bool, tolerance: float, start: Floats
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


def seed_nlopt(number: int) -> None:
    """Seed nlopt's generator; without a thread-local one this seeds that of all threads."""
    nlopt.srand(number)


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
