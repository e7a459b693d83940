"""The error-minimising fit: the least errors (IPE, TE, EDP), and the parameters within their tolerance.

    least and largest theta_k   subject to   f(theta) <= f_least + tolerance,   bounds

with the metric objective f (docs/fitting.md, "Error-minimising fit"). The ranges are joint: while theta_k
goes to an end, all others go where f lets it. An end is found by steps: nlopt's SLSQP solves the problem with
the distances of f made linear, within a radius, and the next step starts where f was evaluated. The first
search of an end begins at the outermost point within the limit of those known: the least f, and draws of the
posterior. Steps stay in one valley of f, and there may be several. So further searches begin where those of
other ends ended, until all of these points have been tried.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from needlefit.arrays import Floats
from needlefit.inference.error_tolerance import ErrorTolerance, estimate_tolerance
from needlefit.inference.fit import EVALUATION_ERRORS, FIRST_RADIUS, Callbacks, Fit
from needlefit.inference.metric_objective import WeightedDistances
from needlefit.inference.parameters import Parameters
from needlefit.inference.problem import Problem
from needlefit.inference.side_by_side import run_side_by_side
from needlefit.inference.slsqp import find_farthest_step
from needlefit.project.progress import Stop
from needlefit.project.tasks import TaskStop

MAX_ROUNDS = 5  #: of searches, at most: each begins at the ends that the one before found
APART = 0.5  #: of a logarithm or an alpha: of points nearer one another one begins searches
MAX_STEPS = 24  #: evaluations of f with derivatives, at most, of one end from one start
SLACK = 0.02  #: of the tolerance, by which f may exceed the limit at an end
#: of the tolerance, by which f may exceed the limit on the way: later steps lead back. No step is taken that
#: leads neither farther nor back.
MAX_EXCESS = 1.0
SMALL_EXCESS = 0.1  #: of the tolerance, up to which the next step may be twice as long
#: of theta_k (of a logarithm: a factor of 1.01), below which steps end, and a bound is reached
MIN_PROGRESS = 0.01
EXAMINED_DRAWS = 64  #: draws of the posterior, at most, of which f is evaluated


@dataclass(frozen=True)
class ErrorRange:
    """The least and the largest value of one parameter within the tolerance, in its coordinate of theta.

    An end that a bound of the parameter sets is that bound.
    """

    name: str
    low: float
    high: float


@dataclass(frozen=True)
class ErrorMinimisingFit:
    """The least errors that a search found, and the parameters whose errors are not significantly larger."""

    fit: Fit  #: the search; its objective is the least, mm
    tolerance: ErrorTolerance
    ranges: tuple[ErrorRange, ...]  #: of each free parameter within the tolerance; none after a stop


def examine_errors(
    problem: Problem,
    fit: Fit,
    draws: Floats,
    stated: Parameters,
    rng: np.random.Generator,
    callbacks: Callbacks | None = None,
) -> ErrorMinimisingFit:
    """Return the tolerance of a fit that minimised the errors, and the ranges of its parameters.

    `draws` (B, P) are of the posterior, in the problem's coordinates. `stated` are the parameters with the
    ties that have a spread, which the problem takes as exact. Of `callbacks` the number of threads and the
    stop count.
    """
    callbacks, least = Callbacks() if callbacks is None else callbacks, np.array(fit.theta)
    tolerance = estimate_tolerance(problem, stated, least, rng)
    ranges = find_error_ranges(problem, least, tolerance.value, draws, callbacks.jobs, callbacks.stop)
    return ErrorMinimisingFit(fit, tolerance, ranges)


def find_error_ranges(
    problem: Problem, least: Floats, tolerance: float, draws: Floats, jobs: int, stop: Stop
) -> tuple[ErrorRange, ...]:
    """Return the range of each free parameter, in the order of theta; none after a stop.

    `least` (P,) has the least f, `tolerance` is in mm, `draws` (B, P) are of the posterior.
    """
    limit = problem.objective(least) + tolerance
    inside = [least, *_list_inside(problem, draws[:EXAMINED_DRAWS], limit, jobs)]
    ends = [_End(k, side) for k in range(len(least)) for side in (-1, 1)]
    searches = [_EndSearch(problem, end, limit, tolerance, max(inside, key=end.reach)) for end in ends]
    begun: list[Floats] = []  # where searches of all ends began
    for _ in range(MAX_ROUNDS):
        found_ends = dict(run_side_by_side(_EndSearch.run, searches, jobs, TaskStop(stop)))
        inside += [found_ends[number] for number in sorted(found_ends)]
        outermost = {end: max(inside, key=end.reach) for end in ends}
        starts: list[Floats] = []
        for theta in outermost.values():
            if _is_apart(theta, [*begun, *starts]):
                starts.append(theta)
        begun += starts
        searches = [
            _EndSearch(problem, end, limit, tolerance, start)
            for end, theta in outermost.items()
            if not end.is_at_bound(problem, theta)
            for start in starts
            if _is_apart(start, [theta])
        ]
    if stop():
        return ()
    values = [end.value(problem, theta) for end, theta in outermost.items()]
    return tuple(map(ErrorRange, problem.names, values[::2], values[1::2]))


def _is_apart(theta: Floats, others: Sequence[Floats]) -> bool:
    """Return whether theta (P,) lies farther from each of the others than `APART` along some parameter."""
    return all(np.max(np.abs(theta - other)) > APART for other in others)


def _list_inside(problem: Problem, draws: Floats, limit: float, jobs: int) -> Floats:
    """Return those of the draws (B, P) whose f is within the limit."""
    values = problem.objectives(draws, jobs) if len(draws) else np.empty(0)
    return draws[values <= limit].reshape(-1, len(problem.names))


@dataclass(frozen=True)
class _End:
    """One end of the range of parameter `k`: `side` is -1 for its least value, 1 for its largest."""

    k: int
    side: int

    def reach(self, theta: Floats) -> float:
        """Return how far out theta (P,) lies."""
        return self.side * float(theta[self.k])

    def bound(self, problem: Problem) -> float:
        return float((problem.upper if self.side > 0 else problem.lower)[self.k])

    def is_at_bound(self, problem: Problem, theta: Floats) -> bool:
        return abs(self.bound(problem) - theta[self.k]) < MIN_PROGRESS

    def value(self, problem: Problem, theta: Floats) -> float:
        """Return the end that theta (P,) sets, the bound where it is reached."""
        return self.bound(problem) if self.is_at_bound(problem, theta) else float(theta[self.k])


@dataclass(frozen=True)
class _EndSearch:
    """The search for an end, from theta `start` (P,) within the limit."""

    problem: Problem
    end: _End
    limit: float  #: of f, mm
    tolerance: float  #: mm
    start: Floats

    def run(self) -> Floats:
        """Return the outermost theta (P,) found within the limit."""
        problem, end = self.problem, self.end
        theta, radius, best = self.start, FIRST_RADIUS, self.start
        distances = self._evaluate(theta)
        for _ in range(MAX_STEPS):
            if distances is None or end.is_at_bound(problem, best):
                break
            step = self._step(distances, theta, radius)
            ahead = np.clip(theta + step, problem.lower, problem.upper)
            trial, farther = self._evaluate(ahead), end.reach(ahead) - end.reach(theta) > MIN_PROGRESS
            excess = math.inf if trial is None else self._exceed(trial)
            if excess <= SLACK:
                progress = end.reach(ahead) - end.reach(best)
                best = ahead if progress > 0 else best
                if progress < MIN_PROGRESS:
                    break
            if excess > MAX_EXCESS or not (excess <= SLACK or farther or excess < self._exceed(distances)):
                radius = 0.25 * float(np.max(np.abs(step)))
                continue
            theta, distances = ahead, trial
            radius *= 2 if excess <= SMALL_EXCESS else 1
        return best

    def _exceed(self, distances: WeightedDistances) -> float:
        return (distances.total - self.limit) / self.tolerance

    def _evaluate(self, theta: Floats) -> WeightedDistances | None:
        try:
            distances = self.problem.distances(theta)
        except EVALUATION_ERRORS:
            return None
        return distances if np.isfinite(distances.total) and np.all(np.isfinite(distances.slopes)) else None

    def _step(self, distances: WeightedDistances, theta: Floats, radius: float) -> Floats:
        """Return the step (P,) that leads farthest toward the end where the distances are linear."""
        along = np.zeros(len(theta))
        along[self.end.k] = self.end.side

        def excess(step: Floats) -> tuple[float, Floats]:
            moved = distances.move(step)
            return self._exceed(moved), moved.differentiate() / self.tolerance

        low = np.maximum(self.problem.lower - theta, -radius)
        high = np.minimum(self.problem.upper - theta, radius)
        return find_farthest_step(along, excess, (low, high), SLACK / 2, MIN_PROGRESS / 4)
