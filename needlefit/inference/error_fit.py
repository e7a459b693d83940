"""The error-minimising fit: parameters whose errors (IPE, TE, EDP) are the least, or not significantly more.

The set of those whose objective f is within the tolerance of the least one is described by the range of each
parameter (docs/fitting.md, "Error-minimising fit"). Needles are predicted by the point of it that is nearest
to a target. It minimises f / tolerance + mu d^2 / 2 with the largest mu for which f is within the limit
(Tikhonov regularisation with Morozov's discrepancy principle), by gradients, with SLSQP.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from needlefit.arrays import Floats
from needlefit.inference.error_ranges import ErrorRange, find_error_ranges
from needlefit.inference.error_tolerance import ErrorTolerance, estimate_tolerance
from needlefit.inference.fit import Callbacks, EvaluationRecorder, Fit, ObjectiveFunction
from needlefit.inference.parameters import Parameters
from needlefit.inference.problem import Problem
from needlefit.inference.slsqp import run_slsqp
from needlefit.project.progress import never_stop
from needlefit.project.tasks import TaskStop

MIN_TARGET_SD = 0.05  #: smallest standard deviation of the distance to a target
SEARCH_EVALUATIONS = 40  #: most evaluations of one search
ACCURACY = 1e-4  #: relative tolerance of a search
NEAREST_STEPS = 8  #: bisections of the weight of the distance


@dataclass(frozen=True)
class ErrorMinimisingFit:
    """The least errors that a search found, and what of the parameters has errors as small."""

    least_theta: tuple[float, ...]
    least: float  #: the objective there, mm
    tolerance: ErrorTolerance
    ranges: tuple[ErrorRange, ...]  #: of each free parameter within the tolerance; of none after a stop
    theta: tuple[float, ...]  #: within the tolerance, nearest to the target: what predicts needles
    objective: float  #: there, mm
    evaluations: int  #: of the search for `theta`


class Target(NamedTuple):
    """What a point is to be near: theta (P,), and the standard deviations (P,) of the distance."""

    theta: Floats
    sds: Floats


def examine_errors(
    problem: Problem,
    fit: Fit,
    draws: Floats,
    stated: Parameters,
    rng: np.random.Generator,
    callbacks: Callbacks | None = None,
) -> ErrorMinimisingFit:
    """Return what a fit that minimised the errors, by a search, tells of the parameters.

    `draws` (B, P) are of the posterior, in the problem's coordinates; needles are predicted by the point
    nearest to their median, without any by the least one. `stated` are the parameters with the ties that have
    a spread, which the problem takes as exact. Of `callbacks` the number of threads and the stop count.
    """
    callbacks = Callbacks() if callbacks is None else callbacks
    least = _Point(fit.objective, np.array(fit.theta))
    tolerance = estimate_tolerance(problem, stated, least.theta, rng)
    nearest = least
    if len(draws):
        target = Target(np.median(draws, axis=0), np.std(draws, axis=0))
        nearest = _find_nearest(problem, target, least, tolerance.value)
    stop = TaskStop(callbacks.stop)
    ranges = find_error_ranges(problem, least.theta, tolerance.value, draws, callbacks.jobs, stop)
    theta = tuple(nearest.theta.tolist())
    return ErrorMinimisingFit(
        tuple(fit.theta), least.value, tolerance, ranges, theta, nearest.value, nearest.evaluations
    )


class _Point(NamedTuple):
    value: float  #: of the objective, mm; infinite where it failed
    theta: Floats  #: (P,)
    evaluations: int = 0


def _find_nearest(problem: Problem, target: Target, least: _Point, tolerance: float) -> _Point:
    """Return the point within the tolerance (mm) of the least one that is nearest to the target."""
    limit, goal = least.value + tolerance, np.clip(target.theta, problem.lower, problem.upper)
    found = _Point(problem.objective(goal), goal, 1)
    if found.value <= limit or not len(goal):
        return found
    inside, spent, sds = least, 1, np.maximum(target.sds, MIN_TARGET_SD)
    distance = np.sum(((least.theta - goal) / sds) ** 2)
    # of the weight mu: with the first one both terms are alike; it is bisected in its logarithm
    low, middle, high = -math.inf, math.log(2 / distance), math.inf
    for _ in range(NEAREST_STEPS):
        function = _add_distance(problem, tolerance, goal, sds, math.exp(middle))
        recorder = EvaluationRecorder(function, SEARCH_EVALUATIONS, never_stop)
        run_slsqp(recorder, inside.theta, ACCURACY)
        theta = inside.theta if recorder.theta is None else recorder.theta
        value = problem.objective(theta)
        spent += recorder.evaluations + 1
        if value <= limit:
            inside, low = _Point(value, theta), middle
        else:
            high = middle
        middle = low + 2 if math.isinf(high) else high - 2 if math.isinf(low) else 0.5 * (low + high)
    return inside._replace(evaluations=spent)


def _add_distance(
    problem: Problem, tolerance: float, goal: Floats, sds: Floats, weight: float
) -> ObjectiveFunction:
    """Return the objective in tolerances plus half the weighted square of the distance from `goal`."""

    def gradient(theta: Floats) -> tuple[float, Floats]:
        value, slope = problem.objective_gradient(theta)
        away = (theta - goal) / sds
        return value / tolerance + 0.5 * weight * float(away @ away), slope / tolerance + weight * away / sds

    def value(theta: Floats) -> float:
        away = (theta - goal) / sds
        return problem.objective(theta) / tolerance + 0.5 * weight * float(away @ away)

    return ObjectiveFunction(problem.lower, problem.upper, value, gradient)
