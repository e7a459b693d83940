"""The error-minimising fit: parameters whose errors (IPE, TE, EDP) are the least, or not significantly more.

Of the parameters whose objective f is within the tolerance of the least one (docs/fitting.md,
"Error-minimising fit") the nearest to a target is reported. It minimises f / tolerance + mu d^2 / 2 with the
largest mu for which f is within the limit (Tikhonov regularisation with Morozov's discrepancy principle), by
gradients, with SLSQP.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from needlefit.arrays import Floats
from needlefit.inference.error_tolerance import ErrorTolerance, estimate_tolerance
from needlefit.inference.fit import EvaluationRecorder, Fit, ObjectiveFunction
from needlefit.inference.parameters import Parameters
from needlefit.inference.problem import Problem
from needlefit.inference.slsqp import run_slsqp
from needlefit.project.progress import never_stop

MIN_TARGET_SD = 0.05  #: smallest standard deviation of the distance to a target
SEARCH_EVALUATIONS = 40  #: most evaluations of one search
ACCURACY = 1e-4  #: relative tolerance of a search
NEAREST_STEPS = 8  #: bisections of the weight of the distance


@dataclass(frozen=True)
class ErrorMinimisingFit:
    """The fit of the errors that is reported."""

    theta: tuple[float, ...]  #: within the tolerance, nearest to the target
    objective: float  #: there, mm
    least: float  #: the least objective found, mm
    tolerance: ErrorTolerance
    evaluations: int  #: beside those of the search for the least objective


class Target(NamedTuple):
    """What the reported fit is to be near: theta (P,), and the standard deviations (P,) of the distance."""

    theta: Floats
    sds: Floats


def examine_errors(
    problem: Problem, fit: Fit, target: Target | None, stated: Parameters, rng: np.random.Generator
) -> ErrorMinimisingFit:
    """Return the point to be reported of a fit that minimised the errors; without a `target`, the least.

    `stated` are the parameters with the ties that have a spread, which the problem takes as exact.
    """
    least = _Point(fit.objective, np.array(fit.theta))
    tolerance = estimate_tolerance(problem, stated, least.theta, rng)
    nearest = least if target is None else _find_nearest(problem, target, least, tolerance.value)
    theta = tuple(nearest.theta.tolist())
    return ErrorMinimisingFit(theta, nearest.value, least.value, tolerance, nearest.evaluations)


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
