"""Search for the best fit: many starts, each by least squares or by gradients, then a check of its end.

Searches begin at many starts spread over the box, side by side; the best end is the fit.
Starts first go down an easier way; those that end at the same point there continue as one, and those far
behind the best do not. With uncertain depths every needle is simulated many times: depths taken as stated
make a posterior whose modes lie next to those of the whole one, at a fraction of the cost. The metric
objective, a weighted sum of distances, is approached by Gauss-Newton steps. A step leads to the least sum of
the distances made linear, within the bounds and a radius (Osborne and Watson 1971,
https://doi.org/10.1093/comjnl/14.2.184). The kinks, where a distance is 0, stay in the linear problem: most
minima lie on some of them, which quasi-Newton methods find in many small steps. The linear problem is solved
by least squares, reweighted while the kinks are made sharp.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from needlefit.arrays import Floats
from needlefit.errors import FitError
from needlefit.inference.fit import (
    BEHIND,
    EVALUATION_ERRORS,
    FIRST_RADIUS,
    INTERRUPTED,
    Callbacks,
    EvaluationRecorder,
    Fit,
    ObjectiveFunction,
    Start,
    StartPoint,
    half_square,
)
from needlefit.inference.least_squares import certify_minimum, find_step, run_least_squares
from needlefit.inference.metric_objective import SMOOTHING_MM, WeightedDistances
from needlefit.inference.prior_shift import central_range, measure_shifts
from needlefit.inference.problem import Problem, make_objective
from needlefit.inference.sampling.importance import find_modes
from needlefit.inference.side_by_side import run_side_by_side
from needlefit.inference.slsqp import run_slsqp
from needlefit.project.callbacks import Stop, never_stop
from needlefit.project.processes import one_thread
from needlefit.project.tasks import TaskStop
from needlefit.schemas.recipe import ObjectiveName, RecipeRecord

#: smallest gain that the linear problem promises, as a fraction of the sum, with which a search goes on
MIN_GAIN = 1e-4
#: number of times the linear problem is reweighted: from kinks as wide as a typical distance to sharp ones
REWEIGHTINGS = 5


def run_gauss_newton(recorder: EvaluationRecorder, start: Floats) -> str:
    """Search from theta `start` (P,) within the bounds; return why it ended.

    Raises SearchEnded where the recorder ends it.
    """
    lower, upper = recorder.objective_function.lower, recorder.objective_function.upper
    theta, radius, distances = start, FIRST_RADIUS, recorder.distances(start)
    if distances is None:
        return "failed at its start"
    while True:
        step = _solve_linear(distances, np.maximum(lower - theta, -radius), np.minimum(upper - theta, radius))
        gain = distances.total - distances.move(step).total
        if gain <= MIN_GAIN * distances.total:
            return "tolerance"
        trial = recorder.distances(theta + step)
        gain_ratio = -1.0 if trial is None else (distances.total - trial.total) / gain
        if gain_ratio > 0.75:
            radius *= 2
        elif gain_ratio < 0.25:
            radius = 0.25 * float(np.max(np.abs(step)))
        if trial is not None and gain_ratio > 0:
            theta, distances = np.clip(theta + step, lower, upper), trial


def _solve_linear(distances: WeightedDistances, low: Floats, high: Floats) -> Floats:
    """Return the step (P,) between two bounds that makes the sum of the distances made linear least."""
    step = np.zeros(len(low))
    width = float(np.median(np.linalg.norm(distances.off, axis=1)))
    for smoothing in np.geomspace(max(width, SMOOTHING_MM), SMOOTHING_MM, REWEIGHTINGS):
        off = distances.move(step).off
        pull = distances.weights / np.sqrt(np.sum(off**2, axis=1) + smoothing**2)
        pulls = np.repeat(pull, distances.off.shape[1])
        curvature = (distances.rows.T * pulls) @ distances.rows
        # singular where a combination of parameters moves nothing
        curvature[np.diag_indices(len(low))] += 1e-12 * max(float(np.trace(curvature)), 1e-300)
        best_step = find_step((distances.off.ravel() * pulls) @ distances.rows, curvature, low, high)
        if best_step is None:
            break
        step = np.clip(best_step, low, high)
    return step


def search(
    objective_function: ObjectiveFunction,
    recipe: RecipeRecord,
    start_point: StartPoint,
    stop: Callable[[], bool] = never_stop,
) -> Start:
    """Search from one start with a recipe's tolerance and budget: by least squares, or else by gradients.

    The start has the best point, and why the search ended: "tolerance" if at a minimum, as far as known.
    """
    recorder = EvaluationRecorder(objective_function, recipe.evaluations, stop)
    start = np.array(start_point.theta, dtype=np.float64)
    if objective_function.jacobian is not None:
        reason = recorder.run(run_least_squares, start)
    elif objective_function.distances is not None:
        reason = recorder.run(run_gauss_newton, start)
    else:
        reason = run_slsqp(recorder, start, recipe.tolerance)
    if reason != INTERRUPTED:
        reason = certify_minimum(recorder, reason)
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
    )


#: largest number of evaluations of an approach by least squares: one that needs more is left where it is
APPROACH_EVALUATIONS = 60
#: largest misfit (sum of squares) of an end of the approach that is continued, in units of the best one: far
#: from all needles a start crawls for hundreds of evaluations, and ends there
MAX_MISFIT_RATIO = 5.0
SAME_OBJECTIVE = 1e-3  #: difference of the easier goal below which two ends are one
SAME_THETA = 1e-2  #: difference of every parameter of theta below which they are


def group_approaches(ends: Sequence[Start]) -> dict[int, int]:
    """Map each start to the start that continues for it: itself, or a better one that ended at the same
    point.

    An end without a finite value has met nobody.
    """
    chosen: dict[int, int] = {}
    first: list[Start] = []
    for end in sorted(ends, key=lambda s: (s.objective, s.index)):
        leader = end
        for other in first if math.isfinite(end.objective) else ():
            apart = np.abs(np.subtract(end.theta, other.theta))
            if abs(end.objective - other.objective) < SAME_OBJECTIVE and np.all(apart < SAME_THETA):
                leader = other
                break
        chosen[end.index] = leader.index
        if leader is end:
            first.append(end)
    return chosen


@one_thread
def minimize(
    problem: Problem, recipe: RecipeRecord, rng: np.random.Generator, callbacks: Callbacks | None = None
) -> Fit:
    """Minimise the recipe's objective from every start, and return the best point of all.

    Parameters that are held stand at the centre of their prior. Where one moves measured points, the search
    goes on from there with it free: `held` of the fit are the others.

    The result depends on the problem, the recipe and `rng` alone, not on the number of threads.

    Raises FitError if no evaluation succeeded.
    """
    callbacks = Callbacks() if callbacks is None else callbacks
    searched = problem.searched
    design = starting_points(searched.lower, searched.upper, recipe.starts, rng)  # (n, S)
    fit = _extend(_search_from(design, searched, recipe, callbacks), problem)
    if not fit.held or fit.interrupted or not math.isfinite(fit.objective):
        return fit
    modes = find_modes(fit, problem.upper - problem.lower)
    shifts = measure_shifts(problem, modes)
    wider = problem.holding([name for name in fit.held if shifts[name].is_hidden])
    if wider is problem:
        return fit
    further = wider.parameters.restrict(_spread_over_prior(problem, wider, modes))
    minima = _search_from(further, wider.searched, recipe, callbacks, len(design))
    return _join(fit, _extend(minima, wider))


def _spread_over_prior(problem: Problem, wider: Problem, modes: Floats) -> Floats:
    """Return `modes` (M, P), and each with one of the freed parameters at either end of its prior."""
    starts = [*modes]
    for name in (name for name in problem.parameters.held if name not in wider.parameters.held):
        for end in central_range(problem.parameters, name):
            moved = modes.copy()
            moved[:, problem.names.index(name)] = end
            starts += [*moved]
    return np.array(starts)


def _extend(fit: Fit, problem: Problem) -> Fit:
    """Return a fit of the searched parameters of a problem as one of all free ones."""
    parameters = problem.parameters
    if not parameters.held:
        return fit

    def extend(theta: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(parameters.extend(np.array(theta)).tolist())

    starts = tuple(replace(s, theta0=extend(s.theta0), theta=extend(s.theta)) for s in fit.starts)
    return replace(fit, theta=extend(fit.theta), starts=starts, held=parameters.held)


def _join(first: Fit, then: Fit) -> Fit:
    """Return the fit of two searches, of which the second went on with more parameters free."""
    best = min(first, then, key=lambda fit: fit.objective)
    return replace(
        then,
        theta=best.theta,
        values=best.values,
        objective=best.objective,
        starts=(*first.starts, *then.starts),
        evaluations=first.evaluations + then.evaluations,
        gradients=first.gradients + then.gradients,
        failures=first.failures + then.failures,
    )


def _search_from(
    design: Floats, problem: Problem, recipe: RecipeRecord, callbacks: Callbacks, first: int = 0
) -> Fit:
    """Return the fit of the searches that begin at `design` (n, P), numbered from `first`."""
    whole, starts = _SearchTask(problem, recipe), list[Start]()
    points = [StartPoint(first + k, tuple(theta0.tolist())) for k, theta0 in enumerate(design)]
    easier, before = whole.objective_function.approach, 0
    if easier is None:
        ended = whole.run_each(points, callbacks)
    else:
        ended, before = _search_by_approach(whole, easier, points, callbacks), len(points)
    for start in ended:
        starts += [start] if start.evaluations else []
        callbacks.step(before + len(starts), before + len(points))
    starts.sort(key=lambda start: start.index)
    return _select_fit(problem, recipe.minimize, tuple(starts), design)


@dataclass(frozen=True)
class _SearchTask:
    """A search, of which every start is a task: by a recipe, of a problem or of the easier one before it."""

    problem: Problem
    recipe: RecipeRecord
    of_approach: bool = False

    @cached_property
    def objective_function(self) -> ObjectiveFunction:
        """What is minimised."""
        objective = make_objective(self.problem, self.recipe.minimize)
        if not self.of_approach:
            return objective
        assert objective.approach is not None
        return objective.approach

    def run(self, stop: Stop, start_point: StartPoint) -> Start:
        """Return what came of one start."""
        return search(self.objective_function, self.recipe, start_point, stop)

    def run_each(self, start_points: list[StartPoint], callbacks: Callbacks) -> Iterator[Start]:
        """Yield the search from each place as it ends, in the calling thread."""
        stop = TaskStop(callbacks.stop)
        for _, start in run_side_by_side(partial(self.run, stop), start_points, callbacks.jobs, stop):
            yield start


def _search_by_approach(
    whole: _SearchTask, easier: ObjectiveFunction, start_points: list[StartPoint], callbacks: Callbacks
) -> Iterator[Start]:
    """Yield what came of all starts: down the easier goal, then one for all that have met there."""
    half = whole.recipe.model_copy(update={"evaluations": max(1, whole.recipe.evaluations // 2)})
    few = half.model_copy(update={"evaluations": min(half.evaluations, APPROACH_EVALUATIONS)})
    approach = _SearchTask(whole.problem, few, of_approach=True)
    ends: dict[int, Start] = {}
    for end in approach.run_each(start_points, callbacks):
        ends[end.index] = end
        callbacks.step(len(ends), 2 * len(start_points))
    if callbacks.stop():
        # what is interrupted still leaves its best point
        best = min(ends.values(), key=lambda s: (s.objective, s.index), default=None)
        if best is None or not math.isfinite(best.objective):
            return
        with suppress(*EVALUATION_ERRORS):
            value = whole.objective_function.value(np.array(best.theta))
            yield replace(
                best,
                objective=value if math.isfinite(value) else math.inf,
                evaluations=best.evaluations + 1,
                stopped=INTERRUPTED,
            )
        return
    leader = group_approaches([ends[start_point.index] for start_point in start_points])
    continuing = select_leaders(easier, [ends[k] for k in sorted(set(leader.values()))])
    single = half.model_copy(update={"evaluations": 1})
    for recipe, chosen in ((half, True), (single, False)):
        begin = [
            replace(p, theta=ends[p.index].theta)
            for p in start_points
            if leader[p.index] == p.index and (p.index in continuing) == chosen
        ]
        for minimum in _SearchTask(whole.problem, recipe).run_each(begin, callbacks):
            ended = chosen or minimum.stopped == INTERRUPTED
            continued = minimum if ended else replace(minimum, stopped=BEHIND)
            for index in (k for k in leader if leader[k] == continued.index):
                end, is_own = ends[index], index == continued.index
                yield replace(
                    continued,
                    index=index,
                    theta0=end.theta0,
                    joined=None if is_own else continued.index,
                    evaluations=end.evaluations + is_own * continued.evaluations,
                    gradients=end.gradients + is_own * continued.gradients,
                    failures=end.failures + is_own * continued.failures,
                )


def select_leaders(easier: ObjectiveFunction, ends: Sequence[Start]) -> set[int]:
    """Return the indices of the ends of the approach that are continued: of a misfit near the best one's."""
    best, *others = sorted(ends, key=lambda end: (end.objective, end.index))
    limit = math.inf
    if easier.misfits is not None and math.isfinite(best.objective):
        misfits = easier.misfits(np.array(best.theta))
        limit = best.objective + (MAX_MISFIT_RATIO - 1) * max(0.5 * len(misfits), half_square(misfits))
    return {best.index, *(end.index for end in others if end.objective <= limit)}


def starting_points(lower: Floats, upper: Floats, count: int, rng: np.random.Generator) -> Floats:
    """Return `count` starts (n, P) spread evenly over the box by an additive recurrence with a random shift.

    More starts extend fewer ones. Where nothing is free there is one start, without coordinates. The steps of
    the P coordinates are the powers of 1 / phi, with phi^(P + 1) = phi + 1: M. Roberts, "The unreasonable
    effectiveness of quasirandom sequences" (2018).
    """
    if len(lower) == 0:
        return np.empty((1, 0))
    phi = np.roots([1.0, *[0.0] * (len(lower) - 1), -1.0, -1.0]).real.max()
    steps = phi ** -np.arange(1.0, len(lower) + 1)
    cube = (rng.random(len(lower)) + np.arange(count)[:, None] * steps) % 1.0
    return lower + cube * (upper - lower)


def _select_fit(problem: Problem, minimized: ObjectiveName, starts: tuple[Start, ...], design: Floats) -> Fit:
    interrupted = len(starts) < len(design) or any(s.stopped == INTERRUPTED for s in starts)
    evaluations = sum(s.evaluations for s in starts)
    best = min(starts, key=lambda s: (s.objective, s.index), default=None)
    if not interrupted and (best is None or not math.isfinite(best.objective)):
        raise FitError(
            f"none of {evaluations} evaluations from {len(starts)} starts could be solved",
            fix="narrow the bounds, or check depths and layers",
        )
    theta = tuple(design[0].tolist()) if best is None else best.theta
    return Fit(
        theta=theta,
        values=problem.values(np.array(theta)),
        minimized=minimized,
        objective=math.inf if best is None else best.objective,
        starts=starts,
        evaluations=evaluations,
        gradients=sum(s.gradients for s in starts),
        failures=sum(s.failures for s in starts),
        interrupted=interrupted,
    )
