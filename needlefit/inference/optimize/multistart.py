"""Many starts spread over the box, in threads, resumable; the best of them is the fit."""

import math
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from needlefit.errors import FitError
from needlefit.inference.goal import Goal, Weighed, goal_of
from needlefit.inference.ledger import FAILURES
from needlefit.inference.optimize.algorithms import stages
from needlefit.inference.optimize.approach import broken_off, leaders, went_on
from needlefit.inference.optimize.search import search
from needlefit.inference.starts import INTERRUPTED, Fit, Place, Start, Watch
from needlefit.project.threads import one_thread
from needlefit.schemas.recipe import ObjectiveName, RecipeRecord

Floats = NDArray[np.float64]


@one_thread
def minimize(
    problem: Weighed, recipe: RecipeRecord, rng: np.random.Generator, watch: Watch | None = None
) -> Fit:
    """Minimise what the recipe says from every one of its starts and return the best point of all.

    The result depends on the problem, the recipe and `rng` alone: not on the number of threads, and not
    on whether some starts were computed by an earlier, interrupted run.

    Raises
    ------
    ConfigError
        If the recipe asks for an unknown algorithm.
    FitError
        If no evaluation of any start succeeded, or finished starts belong to another fit.
    """
    watch = Watch() if watch is None else watch
    goal = goal_of(problem, recipe.minimize)
    stages(recipe.algorithm, goal)  # an unknown algorithm is told before anything is computed
    design = starting_points(problem.lower, problem.upper, recipe.starts, rng)  # (n, P)
    seeds = rng.integers(1, 2**31, size=len(design))
    done = _resumed(watch, design)
    places = [Place(k, tuple(design[k].tolist()), int(seeds[k])) for k in range(len(design))]
    if goal.approach is None or not recipe.approach or len(done) == len(places):
        for start in _in_threads(goal, recipe, [p for p in places if p.index not in done], watch):
            _keep(start, done, watch)
    else:
        _by_approach(goal, goal.approach, recipe, places, done, watch)
    return _best(problem, recipe.minimize, tuple(done[index] for index in sorted(done)), design)


def _by_approach(
    goal: Goal, easier: Goal, recipe: RecipeRecord, places: list[Place], done: dict[int, Start], watch: Watch
) -> None:
    """Add to `done` what came of all starts: down the easier goal, then one for all that have met there.

    Approaches are not kept: a resumed search repeats them, and with them who met whom.
    """
    half = recipe.model_copy(update={"evaluations": max(1, recipe.evaluations // 2)})
    way = half if easier.jacobian is None else half.model_copy(update={"algorithm": "leastsquares"})
    ends: dict[int, Start] = {}
    for end in _in_threads(easier, way, places, watch):
        ends[end.index] = end
        watch.step(len(ends), len(places))
    if watch.stop():
        _break_off(goal, list(ends.values()), done)
        return
    leader = leaders([ends[place.index] for place in places])
    begin = [
        replace(p, theta=ends[p.index].theta)
        for p in places
        if leader[p.index] == p.index and any(k not in done for k in leader if leader[k] == p.index)
    ]
    for led in _in_threads(goal, half, begin, watch):
        for index in (k for k in leader if leader[k] == led.index and k not in done):
            _keep(went_on(ends[index], led), done, watch)


def _keep(start: Start, done: dict[int, Start], watch: Watch) -> None:
    if start.stopped != INTERRUPTED:
        watch.report(start)
    if start.evaluations:
        done[start.index] = start


def _break_off(goal: Goal, ends: list[Start], done: dict[int, Start]) -> None:
    """Add the best of the approaches to `done`, so that what is interrupted still leaves its best point."""
    best = min(ends, key=lambda s: (s.objective, s.index), default=None)
    if best is None or not math.isfinite(best.objective) or best.index in done:
        return
    try:
        value = goal.value(np.array(best.theta))
    except FAILURES:
        return
    done[best.index] = broken_off(best, value)


def starting_points(lower: Floats, upper: Floats, count: int, rng: np.random.Generator) -> Floats:
    """Return `count` starts (n, P) spread over the box: a scrambled Halton sequence.

    More starts extend fewer ones. Where nothing is free there is one start, without coordinates.
    """
    if len(lower) == 0:
        return np.empty((1, 0))
    cube = qmc.Halton(len(lower), scramble=True, rng=rng).random(count)
    spread: Floats = lower + cube * (upper - lower)
    return spread


def _resumed(watch: Watch, design: Floats) -> dict[int, Start]:
    """Return the starts that need no repetition; FitError if they are another fit's."""
    kept = {index: start for index, start in watch.finished.items() if index < len(design)}
    for index, start in kept.items():
        if start.theta0 != tuple(design[index].tolist()):
            raise FitError(
                f"start {index} of the checkpoint began elsewhere than this fit's",
                fix="run again without --resume; seed, bounds or recipe have changed",
            )
    return kept


def _in_threads(goal: Goal, recipe: RecipeRecord, places: list[Place], watch: Watch) -> Iterator[Start]:
    """Yield the search from each place as it ends, in the calling thread."""
    if watch.jobs <= 1:
        for place in places:
            if watch.stop():
                return
            yield search(goal, recipe, place, watch.stop)
        return
    leave = threading.Event()  # ends the other threads when one of them finds a bug

    def stop() -> bool:
        return leave.is_set() or watch.stop()

    with ThreadPoolExecutor(watch.jobs, thread_name_prefix="start") as pool:
        futures = [pool.submit(search, goal, recipe, place, stop) for place in places]
        try:
            for future in as_completed(futures):
                yield future.result()
        finally:
            leave.set()


def _best(problem: Weighed, minimized: ObjectiveName, starts: tuple[Start, ...], design: Floats) -> Fit:
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
