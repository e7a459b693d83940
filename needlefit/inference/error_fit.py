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
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.noise import draw_measurement_errors
from needlefit.datasets.select import MIN_GROUPS, group_insertions
from needlefit.inference.fit import (
    EVALUATION_ERRORS,
    FIRST_RADIUS,
    Callbacks,
    EvaluationRecorder,
    Fit,
    ObjectiveFunction,
)
from needlefit.inference.forward_model import PreparedModel
from needlefit.inference.likelihood.compared_points import ComparedPoints, align, differentiate_align
from needlefit.inference.likelihood.nodes import Surface, make_nodes
from needlefit.inference.likelihood.observations import ScoredObservation
from needlefit.inference.likelihood.pose_errors import draw_rolls
from needlefit.inference.metric_objective import WeightedDistances, weigh_stations
from needlefit.inference.parameters import Parameters, Values
from needlefit.inference.problem import MetricGoal, Problem
from needlefit.inference.side_by_side import run_side_by_side
from needlefit.inference.slsqp import find_farthest_step, run_slsqp_once
from needlefit.project.callbacks import Stop, never_stop
from needlefit.project.tasks import TaskStop

# ---- the tolerance: how far the errors of a fit may exceed the least ones by chance
#
# Parameters are compared by f, the objective of `metric_misfits`, mm. The tolerance is the 95 % quantile of
# D, by which true parameters exceed the least f (docs/fitting.md, "Error-minimising fit"). One bootstrap
# draws the errors that data and ties state. The other draws groups of insertions again: it contains what no
# stated error explains, but not what all share. In both the needles are linear in theta about the best point.


REPLICATES = 200  #: number of replicates of each bootstrap
PROBABILITY = 0.95  #: probability of the quantile of the replicates' excesses that is the tolerance
STATIONS = 26  #: number of compared points of an insertion in a replicate, of 101
REPLICATE_EVALUATIONS = 100  #: largest number of evaluations of a replicate's search
REPLICATE_ACCURACY = 1e-4  #: relative tolerance of a replicate's search
MIN_RELATIVE_TOLERANCE = 0.01  #: smallest tolerance, as a fraction of the least objective
MIN_TOLERANCE_MM = 0.002  #: smallest tolerance (mm), where that fraction is less


def find_search_tolerance(objective: float) -> float:
    """Return within which difference of the metric objective, mm, two searches found the same minimum."""
    return max(MIN_RELATIVE_TOLERANCE * abs(objective), MIN_TOLERANCE_MM)


@dataclass(frozen=True)
class ErrorTolerance:
    """The tolerance of the objective and its two estimates, mm; one that could not be made is NaN."""

    by_noise: float
    by_insertions: float
    smallest: float  #: the value is not below it

    @property
    def value(self) -> float:
        """Largest excess of the objective over its least value that may be due to chance, mm."""
        return float(np.nanmax([self.smallest, self.by_noise, self.by_insertions]))


def estimate_tolerance(
    problem: Problem, stated: Parameters, theta: Floats, rng: np.random.Generator
) -> ErrorTolerance:
    """Return the tolerance of a problem's objective about its best point `theta` (P,).

    `stated` are the parameters with the ties that have a spread; the problem takes these as exact.
    """
    parts, replicates = zip(*_linearize(problem, stated, theta, rng), strict=True)
    bounds = problem.lower - theta, problem.upper - theta
    by_noise = by_insertions = math.nan
    whole, sizes = _concatenate(parts), [len(part.weights) for part in parts]
    drawn = [replicate for replicate in replicates if replicate is not None]
    if len(drawn) == len(parts):
        mean = replace(whole, weights=whole.weights * (1 / len(parts)))
        excesses = [
            _find_excess(replace(mean, off=np.concatenate(off)), *bounds) for off in zip(*drawn, strict=True)
        ]
        by_noise = float(np.quantile(excesses, PROBABILITY))
    _, group = np.unique(group_insertions(problem.dataset, problem.insertions), return_inverse=True)
    count = int(group.max()) + 1
    if count >= MIN_GROUPS:
        counts = rng.multinomial(count, np.full(count, 1 / count), size=REPLICATES)  # (B, G)
        times = counts[:, group]  # (B, insertions) how often each is drawn
        repeats = times * (len(group) / times.sum(axis=1, keepdims=True))
        weights = (np.repeat(row / len(parts), sizes) * whole.weights for row in repeats)
        excesses = [_find_excess(replace(whole, weights=row), *bounds) for row in weights]
        by_insertions = float(np.quantile(excesses, PROBABILITY))
    smallest = find_search_tolerance(problem.objective(theta))
    return ErrorTolerance(by_noise, by_insertions, smallest)


def _find_excess(distances: WeightedDistances, lower: Floats, upper: Floats) -> float:
    """Return the linear objective minus its least value, for steps within bounds (P,)."""

    def gradient(step: Floats) -> tuple[float, Floats]:
        moved = distances.move(step)
        return moved.total, moved.differentiate()

    function = ObjectiveFunction(lower, upper, lambda step: distances.move(step).total, gradient)
    recorder = EvaluationRecorder(function, REPLICATE_EVALUATIONS, never_stop)
    run_slsqp_once(recorder, REPLICATE_ACCURACY, np.zeros(len(lower)))  # convex: one search finds the least
    return distances.total - recorder.objective


def _concatenate(parts: Iterable[WeightedDistances]) -> WeightedDistances:
    return WeightedDistances(
        *(np.concatenate(some) for some in zip(*((p.weights, p.off, p.slopes) for p in parts), strict=True))
    )


def _linearize(
    problem: Problem, stated: Parameters, theta: Floats, rng: np.random.Generator
) -> list[tuple[WeightedDistances, Floats | None]]:
    """Return the distances of each insertion, linear about theta (P,), and replicates of their `off`.

    The replicates (B, R, 2 or 3) are what `off` would be at the true theta, mm; None without noise.
    """
    values, some = problem.values(theta), list[MetricGoal]()
    for _, goals in groupby(problem.goals, lambda goal: goal.insertion.id):
        thinned = [_thin(goal) for goal in goals]
        all_weights = weigh_stations([goal.points.target for goal in thinned], problem.weights)
        some += [goal._replace(weights=one) for goal, one in zip(thinned, all_weights, strict=True)]
    model = PreparedModel(problem.medium, [goal.insertion for goal in some])
    s = [goal.points.s for goal in some]
    pairs = model.differentiate([values], problem.parameters, s)
    stated_pairs = model.differentiate([values], stated, s)
    ties = [tie for tie in stated.prior.ties if tie.name in stated.free]
    columns = [stated.free.index(tie.name) for tie in ties]
    spreads = rng.standard_normal((REPLICATES, len(ties))) * [math.log(tie.spread) for tie in ties]
    shared: dict[Surface, Floats] = {}
    parts = dict[str, list[tuple[WeightedDistances, Floats | None]]]()
    for (insertion, part, goal, weights), (simulated, by), (_, by_stated) in zip(
        some, pairs, stated_pairs, strict=True
    ):
        by_stated, by = (goal.select(derivatives[0], axis=-2) for derivatives in (by_stated, by))
        measured, place = goal.target, (goal.pose, goal.select(simulated[0]), goal.target)
        drawn = _draw_errors(problem, part, goal, values, shared, rng)
        if drawn is not None:
            drawn = drawn + np.einsum("bt,kit->bki", spreads, by_stated[..., columns])
            # as an alignment changes simulated points, so it changes these
            drawn = np.moveaxis(differentiate_align(*place, np.moveaxis(drawn, 0, -1)), -1, 0)
        distances = WeightedDistances(weights, align(*place) - measured, differentiate_align(*place, by))
        parts.setdefault(insertion.id, []).append((distances, drawn))
    return [_join_goals(of_insertion) for of_insertion in parts.values()]


def _thin(goal: MetricGoal) -> MetricGoal:
    points = goal.points
    stations = np.unique(np.linspace(0, len(points.s) - 1, STATIONS).round().astype(np.int64))
    return goal._replace(points=replace(points, s=points.s[stations], measured=points.measured[stations]))


def _join_goals(
    parts: Sequence[tuple[WeightedDistances, Floats | None]],
) -> tuple[WeightedDistances, Floats | None]:
    """Return the distances of all that was measured of one insertion, and their replicates."""
    distances, drawn = zip(*parts, strict=True)
    return _concatenate(distances), None if any(one is None for one in drawn) else np.hstack(drawn)


def _draw_errors(
    problem: Problem,
    part: ScoredObservation,
    goal: ComparedPoints,
    values: Values,
    shared: dict[Surface, Floats],
    rng: np.random.Generator,
) -> Floats | None:
    """Draw by how much a simulated needle errs at the stations, (B, K, 2 or 3) mm; None without noise.

    `shared` has the errors (B,) of surfaces, in standard deviations; what is missing is drawn and added.
    """
    insertion, directions = part.insertion, part.dataset.directions
    measured = draw_measurement_errors(part.dataset, insertion, rng, REPLICATES, directions)
    if measured is None:
        return None
    along = insertion.measure_arc("plane")
    scale = along[-1] / insertion.depth if goal.pose in ("known", "direction") else 1
    places = along[-1] - (insertion.depth - goal.s) * scale
    drawn = np.stack(
        [_interpolate(places, along, heights) for heights in np.moveaxis(measured, -1, 0)], axis=-1
    )
    rolls = draw_rolls(insertion.roll_sd, directions, REPLICATES, rng)
    _, y, z = goal.measured.T
    turned = np.stack([0.0 * z, -z, y], axis=-1)[:, : 1 + directions]
    drawn = drawn + rolls[:, None, None] * turned
    nodes = make_nodes(insertion, goal.s, "linear")
    model = PreparedModel(problem.medium, nodes.insertions)
    points = model.read_points([values], list(nodes.s))
    curves = np.stack([goal.select(point[0]) for point in points])  # (m, K, 2 or 3)
    for axis, effect in zip(nodes.axes, np.tensordot(nodes.linear[1:], curves, axes=1), strict=True):
        deviation = axis.own * rng.standard_normal(REPLICATES)
        if axis.surface:
            if axis.surface not in shared:
                shared[axis.surface] = rng.standard_normal(REPLICATES)
            deviation = deviation + axis.shared * shared[axis.surface]
        drawn = drawn + np.multiply.outer(deviation, effect)
    return drawn


def _interpolate(places: Floats, along: Floats, heights: Floats) -> Floats:
    """Return the rows of `heights` (B, N), known at `along` (N,), at other places (K,): (B, K)."""
    left = np.clip(np.searchsorted(along, places) - 1, 0, len(along) - 2)
    part = (places - along[left]) / (along[left + 1] - along[left])
    return heights[:, left] * (1 - part) + heights[:, left + 1] * part


# ---- the ranges within the tolerance

MAX_ROUNDS = 5  #: largest number of rounds of searches: each begins at the ends of the one before
#: smallest difference, of a logarithm or an alpha, between points that both begin searches
MIN_START_DISTANCE = 0.5
MAX_STEPS = 24  #: largest number of evaluations of f, with derivatives, of one end from one start
SLACK = 0.02  #: largest excess of f over the limit at an end, as a fraction of the tolerance
#: largest excess of f over the limit on the way, as a fraction of the tolerance: later steps lead back. No
#: step is taken that leads neither farther nor back.
MAX_EXCESS = 1.0
#: largest excess, as a fraction of the tolerance, after which the next step may be twice as long
SMALL_EXCESS = 0.1
#: smallest progress of theta_k (of a logarithm: a factor of 1.01): with less, steps end, and a bound is
#: reached
MIN_PROGRESS = 0.01
EXAMINED_DRAWS = 64  #: largest number of draws of the posterior of which f is evaluated


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
    """Return whether theta (P,) differs from each of the others by `MIN_START_DISTANCE` in some parameter."""
    return all(np.max(np.abs(theta - other)) > MIN_START_DISTANCE for other in others)


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
