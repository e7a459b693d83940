"""Search from many starts spread over the box, side by side, resumable; the best end is the fit.

An easier objective is minimised first; starts that end at the same point there continue as one.

With uncertain depths every needle is simulated many times. Depths taken as stated make a posterior whose
modes lie next to those of the whole one, at a fraction of the cost.
"""

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from needlefit.arrays import Floats
from needlefit.errors import FitError
from needlefit.inference.fit import (
    EVALUATION_ERRORS,
    INTERRUPTED,
    Callbacks,
    Fit,
    ObjectiveFunction,
    Start,
    StartPoint,
)
from needlefit.inference.optimize.local_search import search, select_algorithms
from needlefit.inference.problem import Problem, make_objective
from needlefit.inference.side_by_side import run_side_by_side
from needlefit.project.processes import one_thread
from needlefit.project.progress import Stop
from needlefit.project.tasks import TaskStop, run_parts
from needlefit.schemas.recipe import ObjectiveName, RecipeRecord

#: differences of the easier goal, and of every parameter of theta, up to which two ends are one
SAME_OBJECTIVE, SAME_THETA = 1e-3, 1e-2


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


def continue_start(end: Start, continued: Start) -> Start:
    """Return the whole search of a start: its approach `end`, then that of its group's leader."""
    alone = continued.index == end.index
    return replace(
        continued,
        index=end.index,
        theta0=end.theta0,
        evaluations=end.evaluations + (continued.evaluations if alone else 0),
        gradients=end.gradients + (continued.gradients if alone else 0),
        failures=end.failures + (continued.failures if alone else 0),
        failed=end.failed + (continued.failed if alone else ()),
        joined=None if alone else continued.index,
    )


@one_thread
def minimize(
    problem: Problem, recipe: RecipeRecord, rng: np.random.Generator, callbacks: Callbacks | None = None
) -> Fit:
    """Minimise the recipe's objective from every start, and return the best point of all.

    The result depends on the problem, the recipe and `rng` alone: not on the number of threads, and not
    on whether some starts were computed by an earlier, interrupted run.

    Raises ConfigError if the recipe asks for an unknown algorithm; FitError if no evaluation of any start
    succeeded, or finished starts belong to another fit.
    """
    callbacks = Callbacks() if callbacks is None else callbacks
    whole = _SearchTask(problem, recipe)
    # an unknown algorithm is an error before anything is computed
    select_algorithms(recipe.algorithm, whole.objective_function)
    # the order of draws from `rng` is part of the result: first the points, then the seeds
    design = starting_points(problem.lower, problem.upper, recipe.starts, rng)  # (n, P)
    seeds = rng.integers(1, 2**31, size=len(design))
    done = {index: start for index, start in callbacks.finished.items() if index < len(design)}
    for index, start in done.items():
        if start.theta0 != tuple(design[index].tolist()):
            raise FitError(
                f"start {index} of the checkpoint began elsewhere than this fit's",
                fix="run again without --resume; seed, bounds or recipe have changed",
            )
    start_points = [StartPoint(k, tuple(design[k].tolist()), int(seeds[k])) for k in range(len(design))]
    easier = whole.objective_function.approach
    if easier is None or not recipe.approach or len(done) == len(start_points):
        for start in whole.run_each([p for p in start_points if p.index not in done], callbacks):
            _add_start(start, done, callbacks)
    else:
        _search_by_approach(whole, easier, start_points, done, callbacks)
    return _select_fit(problem, recipe.minimize, tuple(done[index] for index in sorted(done)), design)


@dataclass(frozen=True)
class _SearchTask:
    """A search, of which every start is a task: by a recipe, of a problem or of the easier one before it."""

    problem: Problem
    recipe: RecipeRecord
    of_approach: bool = False

    def __reduce__(self) -> tuple[type["_SearchTask"], tuple[object, ...]]:
        return _SearchTask, (self.problem, self.recipe, self.of_approach)  # functions cannot travel

    @cached_property
    def objective_function(self) -> ObjectiveFunction:
        """What is minimised."""
        found = make_objective(self.problem, self.recipe.minimize)
        if not self.of_approach:
            return found
        assert found.approach is not None
        return found.approach

    def run(self, stop: Stop, start_point: StartPoint) -> Start:
        """Return what came of one start."""
        return search(self.objective_function, self.recipe, start_point, stop)

    def run_each(self, start_points: list[StartPoint], callbacks: Callbacks) -> Iterator[Start]:
        """Yield the search from each place as it ends, in the calling thread."""
        stop, plan = (
            TaskStop(callbacks.stop),
            select_algorithms(self.recipe.algorithm, self.objective_function),
        )
        # searches with random numbers take turns, so that none of them may wait for another
        run = run_parts if any(one.stochastic for one in plan) else run_side_by_side
        for _, start in run(partial(self.run, stop), start_points, callbacks.pool, callbacks.jobs, stop):
            yield start


def _search_by_approach(
    whole: _SearchTask,
    easier: ObjectiveFunction,
    start_points: list[StartPoint],
    done: dict[int, Start],
    callbacks: Callbacks,
) -> None:
    """Add to `done` what came of all starts: down the easier goal, then one for all that have met there.

    Approaches are not stored: a resumed search repeats them, and so finds the same groups.
    """
    half = whole.recipe.model_copy(update={"evaluations": max(1, whole.recipe.evaluations // 2)})
    first_recipe = half if easier.jacobian is None else half.model_copy(update={"algorithm": "leastsquares"})
    approach = _SearchTask(whole.problem, first_recipe, of_approach=True)
    ends: dict[int, Start] = {}
    for end in approach.run_each(start_points, callbacks):
        ends[end.index] = end
        callbacks.step(len(ends), len(start_points))
    if callbacks.stop():
        # what is interrupted still leaves its best point
        best = min(ends.values(), key=lambda s: (s.objective, s.index), default=None)
        if best is None or not math.isfinite(best.objective) or best.index in done:
            return
        with suppress(*EVALUATION_ERRORS):
            value = whole.objective_function.value(np.array(best.theta))
            done[best.index] = replace(
                best,
                objective=value if math.isfinite(value) else math.inf,
                evaluations=best.evaluations + 1,
                stopped=INTERRUPTED,
            )
        return
    leader = group_approaches([ends[start_point.index] for start_point in start_points])
    begin = [
        replace(p, theta=ends[p.index].theta)
        for p in start_points
        # a group whose members are all stored needs no continuation
        if leader[p.index] == p.index and any(k not in done for k in leader if leader[k] == p.index)
    ]
    for continued in _SearchTask(whole.problem, half).run_each(begin, callbacks):
        for index in (k for k in leader if leader[k] == continued.index and k not in done):
            _add_start(continue_start(ends[index], continued), done, callbacks)


def _add_start(start: Start, done: dict[int, Start], callbacks: Callbacks) -> None:
    if start.stopped != INTERRUPTED:
        callbacks.report(start)
    if start.evaluations:
        done[start.index] = start


def starting_points(lower: Floats, upper: Floats, count: int, rng: np.random.Generator) -> Floats:
    """Return `count` starts (n, P) spread over the box by a scrambled Halton sequence.

    More starts extend fewer ones. Where nothing is free there is one start, without coordinates.
    """
    if len(lower) == 0:
        return np.empty((1, 0))
    from scipy.stats import qmc  # late: it takes 0.2 s to load, which a report need not wait for

    cube = qmc.Halton(len(lower), scramble=True, rng=rng).random(count)
    return lower + cube * (upper - lower)


def _select_fit(problem: Problem, minimized: ObjectiveName, starts: tuple[Start, ...], design: Floats) -> Fit:
    interrupted = len(starts) < len(design) or any(s.stopped == INTERRUPTED for s in starts)
    evaluations = sum(s.evaluations for s in starts)
    best = min(starts, key=lambda s: (s.objective, s.index), default=None)
    if not interrupted and (best is None or not math.isfinite(best.objective)):
        raise FitError(
            f"none of {evaluations} evaluations from {len(starts)} starts could be solved",
            fix="narrow the bounds of the medium, or check depths and layers of the insertions",
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
