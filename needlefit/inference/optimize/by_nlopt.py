"""One stage of a search by one of nlopt's algorithms.

nlopt reports success on a NaN, forgets the best point when it is stopped, and breaks or crashes on values
that are not finite. So nothing that it returns is used: every evaluation goes through a `Ledger`, which
keeps the best point, counts, and ends the search; nlopt is only ever shown finite numbers. It works in the
unit cube, where one step size and one tolerance suit all parameters.
"""

import math
from contextlib import suppress

import nlopt
import numpy as np
from numpy.typing import NDArray

from needlefit.inference.ledger import Ended, Ledger

Floats = NDArray[np.float64]

FIRST_STEP = 0.25
"""Initial step of a local search without gradients, as a part of each parameter's range."""

FIRST_SLOPE = 0.1
"""First step of a search by gradients, likewise."""

ROUNDING = 1e-12
"""Step, likewise, under which a search by gradients for the peak of a posterior ends."""

GAIN = 1e-6
"""Relative gain of a search by gradients begun anew that is none, where nothing is said to be negligible."""

PENALTY = 1e3
"""Shown to nlopt for a value that is not finite, until finite ones are known; then 2 * worst + 1 is."""

VALUE_TOLERANCE = 0.1
"""Relative change of the value under which a search ends, as a part of the recipe's tolerance."""


def stage(books: Ledger, code: int, sloped: bool, tolerance: float, start: Floats) -> str:
    """Let nlopt's algorithm `code` search from theta `start` (P,), by slopes or not; return why it ended.

    A search by slopes is begun anew where it ended until that gains nothing: some end in a narrow valley.
    """
    if len(start) == 0:
        with suppress(Ended):
            books.value(start)
        return books.reason or "tolerance"
    reason = _once(books, code, sloped, tolerance, start)
    while sloped and not books.reason and books.theta is not None:
        before = books.objective
        reason = _once(books, code, sloped, tolerance, books.theta)
        if before - books.objective <= (books.goal.negligible or GAIN * abs(before)):
            break
    return reason


def _once(books: Ledger, code: int, sloped: bool, tolerance: float, start: Floats) -> str:
    lower, span = books.goal.lower, books.goal.upper - books.goal.lower
    optimizer = nlopt.opt(code, len(start))
    try:
        scale = _scale(books, start, span) if sloped else 1.0
    except Ended:
        return books.reason
    _prepare(optimizer, tolerance, books.goal.negligible * scale, sloped)
    bugs: list[BaseException] = []

    def function(cube: Floats, slope: Floats) -> float:
        try:
            value = scale * _evaluate(books, lower + cube * span, slope, scale * span)
        except Ended:
            value = math.inf
            optimizer.force_stop()
        except BaseException as error:
            value = math.inf
            bugs.append(error)
            optimizer.force_stop()
        worst = scale * (2 * abs(books.worst) + 1) if math.isfinite(books.worst) else PENALTY
        return value if math.isfinite(value) else worst

    # Nothing is raised inside: some algorithms call on after an exception, which Python does not survive.
    optimizer.set_min_objective(function)
    reason = _run(optimizer, np.clip((start - lower) / span, 0.0, 1.0))
    if bugs:
        raise bugs[0]
    return books.reason or reason


def seed(number: int) -> None:
    """Seed nlopt's generator; where it has no thread-local one, that of all threads."""
    nlopt.srand(number)


def _scale(books: Ledger, start: Floats, span: Floats) -> float:
    """Return what the value is multiplied by, so that the first step along its slope is `FIRST_SLOPE` long.

    Methods that know no curvature at first take the slope for the step: from a bad start, where a log
    posterior falls by 1e5 over the box, that leads into a corner, from which line searches fail.
    """
    steepness = float(np.linalg.norm(books.gradient(start)[1] * span))
    return FIRST_SLOPE / steepness if steepness > 0 else 1.0


def _evaluate(books: Ledger, theta: Floats, slope: Floats, span: Floats) -> float:
    """Return the value; with its slope along the cube written into `slope` (P,), if that is asked for."""
    if slope.size == 0:
        return books.value(theta)
    slope[:] = 0.0
    value, gradient = books.gradient(theta)
    slope[:] = gradient * span
    return value


def _prepare(optimizer: "nlopt.opt", tolerance: float, negligible: float, sloped: bool) -> None:
    """Set bounds, first step, and when to end: gradients reach a minimum to rounding, values do not."""
    dimensions = optimizer.get_dimension()
    optimizer.set_lower_bounds(np.zeros(dimensions))
    optimizer.set_upper_bounds(np.ones(dimensions))
    optimizer.set_initial_step(np.full(dimensions, FIRST_STEP))
    optimizer.set_xtol_abs(np.full(dimensions, ROUNDING if sloped and negligible else tolerance))
    if negligible:
        optimizer.set_ftol_abs(negligible)
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
