"""The error-minimising fit: parameters whose errors (IPE, TE, EDP) are the least, or not significantly more.

The objective is flat along the ridge of modulus and bevel: a search ends somewhere on it, often at a bound.
What the errors determine is the set of all parameters whose objective lies within the tolerance
(`error_tolerance`) of the least one. Of this set are found

- the range of each parameter: its profile of the objective, the others searched again, up to the limit;
- the point nearest to a target, the median of the posterior, in posterior standard deviations: it is the fit
  that is reported. It minimises f / tolerance + mu d^2 / 2 with the largest mu for which f is within the
  limit (Tikhonov regularisation with Morozov's discrepancy principle);
- the range of each parameter about that point while the others are held. It distinguishes a parameter that is
  determined only together with others from one on which the errors do not depend.

All searches are by gradients, with SLSQP.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, NamedTuple

import numpy as np

from needlefit.arrays import Floats
from needlefit.inference.error_tolerance import ErrorTolerance, estimate_tolerance
from needlefit.inference.fit import EvaluationRecorder, Fit, ObjectiveFunction
from needlefit.inference.identifiability.directions import Determined, name_determined, widest_interval
from needlefit.inference.optimize import run_slsqp
from needlefit.inference.parameters import Parameters
from needlefit.inference.problem import Problem, make_objective
from needlefit.inference.side_by_side import run_side_by_side
from needlefit.project.progress import Stop, never_stop
from needlefit.project.tasks import TaskStop

End = Literal["closed", "bound", "lost"]

FIRST_STEP = 0.2  #: of a profile, in theta; steps are doubled until the limit or a bound
#: to which the end of a range is found, in theta (10 % of a modulus) and as a part of its distance
RESOLUTION, RELATIVE_RESOLUTION = 0.1, 0.05
MIN_TARGET_SD = 0.05  #: smallest standard deviation of the distance to a target
SEARCH_EVALUATIONS = 40  #: most evaluations of one search
ACCURACY = 1e-4  #: relative tolerance of a search
#: excess of the objective, in tolerances, at which a search with one parameter held ends
INSIDE = 0.3
MIN_GAIN = 0.02  #: gain over the least objective, in tolerances, after which the ranges are found again
MAX_RESTARTS = 3  #: how often that may happen
NEAREST_STEPS = 8  #: bisections of the weight of the distance


@dataclass(frozen=True)
class ErrorRange:
    """The range of one parameter within the tolerance, in its coordinate of theta."""

    low: float
    high: float
    #: "closed" where the errors limit it, "bound" where its bound does, "lost" where no solution is beyond
    ends: tuple[End, End]
    alone: tuple[float, float]  #: its range about the reported point while all others are held
    alone_ends: tuple[End, End]

    def determined(self, name: str) -> Determined:
        """Return whether the errors determine the parameter: by itself, only together with others, or not."""
        alone = _is_narrow(name, (self.low, self.high), self.ends)
        return name_determined(alone, _is_narrow(name, self.alone, self.alone_ends))


def _is_narrow(name: str, interval: tuple[float, float], ends: tuple[End, End]) -> bool:
    return ends == ("closed", "closed") and interval[1] - interval[0] < widest_interval(name)


@dataclass(frozen=True)
class ErrorMinimisingFit:
    """The fit of the errors that is reported, and what the errors determine."""

    theta: tuple[float, ...]  #: within the tolerance, nearest to the target
    objective: float  #: there, mm
    least: float  #: the least objective found, mm
    tolerance: ErrorTolerance
    ranges: Mapping[str, ErrorRange]  #: by free parameter
    evaluations: int  #: beside those of the search for the least objective

    def determined(self, name: str) -> Determined:
        """Return whether the errors determine a free parameter; without a known tolerance, they do not."""
        return self.ranges[name].determined(name) if self.tolerance.known else "no"


class Target(NamedTuple):
    """What the reported fit is to be near: theta (P,), and the standard deviations (P,) of the distance."""

    theta: Floats
    sds: Floats


@dataclass(frozen=True)
class ErrorSearch:
    """How the errors are examined."""

    stated: Parameters  #: with the ties that have a spread, which the problem takes as exact
    ranges: bool = True  #: whether the range of each parameter is found


def examine_errors(
    problem: Problem,
    fit: Fit,
    target: Target | None,
    how: ErrorSearch,
    rng: np.random.Generator,
    jobs: int = 1,
    stop: Stop = never_stop,
) -> ErrorMinimisingFit | None:
    """Return what the errors determine about a fit that minimised them; None after a stop.

    Without a `target` the least point is reported. The result does not depend on `jobs`.
    """
    names, found = problem.names, np.array(fit.theta)
    region = _Region(problem, found, fit.objective, estimate_tolerance(problem, how.stated, found, rng))
    parts, spent = [(k, side) for k in range(len(names)) for side in (-1, 1)] if how.ranges else [], 0
    for restart in range(MAX_RESTARTS + 1):
        sides: dict[int, _Side] = dict(run_side_by_side(region.trace, parts, jobs, TaskStop(stop)))
        spent += sum(one.evaluations for one in sides.values())
        if len(sides) < len(parts):
            return None
        best = min((one.best for one in sides.values()), key=lambda one: one.value, default=None)
        gained = best is not None and best.value < region.least - MIN_GAIN * region.tolerance.value
        if best is None or not gained or restart == MAX_RESTARTS:
            break
        lower = region.search(best.theta)
        spent += lower.evaluations
        tolerance = estimate_tolerance(problem, how.stated, lower.theta, rng)
        region = _Region(problem, lower.theta, lower.value, tolerance)
    nearest = _Point(region.least, region.theta) if target is None else region.find_nearest(target)
    about = replace(region, theta=nearest.theta, least=nearest.value)
    alone = partial(about.find_end, compute=about.evaluate)
    held = dict(run_side_by_side(alone, parts, jobs, TaskStop(never_stop)))
    ranges = {}
    for k, name in enumerate(names if how.ranges else ()):
        whole, single = ((some[2 * k], some[2 * k + 1]) for some in (sides, held))
        ranges[name] = ErrorRange(
            whole[0].at,
            whole[1].at,
            (whole[0].end, whole[1].end),
            (single[0].at, single[1].at),
            (single[0].end, single[1].end),
        )
    spent += nearest.evaluations + sum(one.evaluations for one in held.values())
    theta = tuple(nearest.theta.tolist())
    return ErrorMinimisingFit(theta, nearest.value, region.least, region.tolerance, ranges, spent)


class _Point(NamedTuple):
    value: float  #: of the objective, mm; infinite where it failed
    theta: Floats  #: (P,)
    evaluations: int = 0


class _Side(NamedTuple):
    """One end of a range, and the point of the least objective met on the way."""

    at: float
    end: End
    best: _Point
    evaluations: int


@dataclass(frozen=True)
class _Region:
    """All parameters whose objective is within the tolerance of the least one, at `theta`."""

    problem: Problem
    theta: Floats
    least: float
    tolerance: ErrorTolerance

    @property
    def limit(self) -> float:
        return self.least + self.tolerance.value

    def trace(self, part: tuple[int, int]) -> _Side:
        """Return the end of the range of parameter k on one side, -1 or 1, the others searched again."""
        return self.find_end(part, partial(self._hold, part[0]))

    def find_end(self, part: tuple[int, int], compute: Callable[[Floats], _Point]) -> _Side:
        """Return the end of the range of parameter k on one side; `compute` searches the others, or none."""
        k, side = part
        bound = float((self.problem.upper if side > 0 else self.problem.lower)[k])
        points, outside, step = [_Point(self.least, self.theta)], math.inf, FIRST_STEP
        end: End = "closed"
        best, spent, inside = points[0], 0, float(self.theta[k])
        while True:
            resolution = max(RESOLUTION, RELATIVE_RESOLUTION * abs(inside - self.theta[k]))
            if abs(outside - inside) <= resolution:
                return _Side(0.5 * (inside + outside), end, best, spent)
            at = inside + side * step if math.isinf(outside) else 0.5 * (inside + outside)
            at = bound if (bound - at) * side <= 0 else at
            found = compute(_extrapolate(points, k, at, self.problem.lower, self.problem.upper))
            spent, step = spent + found.evaluations, 2 * step
            best = min(best, found, key=lambda one: one.value)
            if not found.value <= self.limit:
                outside, end = at, "closed" if math.isfinite(found.value) else "lost"
            elif at == bound:
                return _Side(bound, "bound", best, spent)
            else:
                points.append(found)
                inside = at

    def evaluate(self, theta: Floats) -> _Point:
        return _Point(self.problem.objective(theta), theta, 1)

    def _hold(self, k: int, begin: Floats) -> _Point:
        """Return a point well within the limit whose parameter k is that of `begin`; else the best one."""
        others = np.arange(len(begin)) != k

        def fill(some: Floats) -> Floats:
            theta = begin.copy()
            theta[others] = some
            return theta

        def gradient(some: Floats) -> tuple[float, Floats]:
            value, slope = self.problem.objective_gradient(fill(some))
            return value, slope[others]

        inside = self.least + INSIDE * self.tolerance.value
        bounds = self.problem.lower[others], self.problem.upper[others]
        function = ObjectiveFunction(*bounds, lambda some: self.problem.objective(fill(some)), gradient)
        found = self._minimize(function, begin[others], inside)
        return found._replace(theta=fill(found.theta))

    def search(self, begin: Floats) -> _Point:
        """Return the least objective that is found from `begin` (P,)."""
        return self._minimize(make_objective(self.problem, "metric"), begin)

    def _minimize(self, function: ObjectiveFunction, begin: Floats, inside: float = -math.inf) -> _Point:
        recorder = EvaluationRecorder(function, SEARCH_EVALUATIONS, lambda: recorder.objective <= inside)
        run_slsqp(recorder, begin, ACCURACY)
        theta = begin if recorder.theta is None else recorder.theta
        return _Point(recorder.objective, theta, recorder.evaluations)

    def find_nearest(self, target: Target) -> _Point:
        """Return the point within the limit that is nearest to the target."""
        goal = np.clip(target.theta, self.problem.lower, self.problem.upper)
        found = self.evaluate(goal)
        if found.value <= self.limit or not len(goal):
            return found
        inside, spent, sds = _Point(self.least, self.theta), 1, np.maximum(target.sds, MIN_TARGET_SD)
        distance = np.sum(((self.theta - goal) / sds) ** 2)
        # of the weight mu: with the first one both terms are alike; it is bisected in its logarithm
        low, middle, high = -math.inf, math.log(2 / distance), math.inf
        for _ in range(NEAREST_STEPS):
            tried = self._minimize(self._add_distance(goal, sds, math.exp(middle)), inside.theta)
            value = self.evaluate(tried.theta).value
            spent += tried.evaluations + 1
            if value <= self.limit:
                inside, low = _Point(value, tried.theta), middle
            else:
                high = middle
            middle = low + 2 if math.isinf(high) else high - 2 if math.isinf(low) else 0.5 * (low + high)
        return inside._replace(evaluations=spent)

    def _add_distance(self, goal: Floats, sds: Floats, weight: float) -> ObjectiveFunction:
        """Return the objective in tolerances plus half the weighted square of the distance from `goal`."""
        problem, unit = self.problem, self.tolerance.value

        def gradient(theta: Floats) -> tuple[float, Floats]:
            value, slope = problem.objective_gradient(theta)
            away = (theta - goal) / sds
            return value / unit + 0.5 * weight * float(away @ away), slope / unit + weight * away / sds

        def value(theta: Floats) -> float:
            away = (theta - goal) / sds
            return problem.objective(theta) / unit + 0.5 * weight * float(away @ away)

        return ObjectiveFunction(problem.lower, problem.upper, value, gradient)


def _extrapolate(points: list[_Point], k: int, at: float, lower: Floats, upper: Floats) -> Floats:
    """Return where the others go, on a line through the last two points, as parameter k goes to `at`."""
    last = points[-1].theta
    theta = last.copy()
    if len(points) > 1:
        before = points[-2].theta
        theta = last + (last - before) * ((at - last[k]) / (last[k] - before[k]))
    theta[k] = at
    return np.clip(theta, lower, upper)
