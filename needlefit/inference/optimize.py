"""The shell around nlopt: multi-start search that keeps its own books.

nlopt reports success on a NaN, forgets the best point when it is stopped, has one generator for
everybody, and breaks or crashes on values that are not finite. So nothing that it returns is used:
every evaluation goes through a `Ledger`, which keeps the best point, counts, and ends the search;
nlopt is only ever shown finite numbers. It works in the unit cube, where one step size and one
tolerance suit all parameters.
"""

import math
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import dataclass

import nlopt
import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from needlefit.errors import ConfigError, FitError
from needlefit.inference.ledger import Ended, Ledger, Target
from needlefit.inference.starts import INTERRUPTED, Fit, Start, Watch
from needlefit.project.records.recipe import RecipeRecord

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Algorithm:
    """One of nlopt's algorithms.

    Attributes
    ----------
    code : int
        nlopt's.
    stochastic : bool
        Whether it draws random numbers.
    dimensions : int
        The fewest free parameters that it can search; below, Nelder-Mead takes its place.
    """

    code: int
    stochastic: bool = False
    dimensions: int = 1


ALGORITHMS = {
    "sbplx": Algorithm(nlopt.LN_SBPLX),
    "bobyqa": Algorithm(nlopt.LN_BOBYQA, dimensions=2),
    "neldermead": Algorithm(nlopt.LN_NELDERMEAD),
    "cobyla": Algorithm(nlopt.LN_COBYLA),
    "praxis": Algorithm(nlopt.LN_PRAXIS, stochastic=True, dimensions=2),
    "crs2": Algorithm(nlopt.GN_CRS2_LM, stochastic=True),
    "isres": Algorithm(nlopt.GN_ISRES, stochastic=True),
    "esch": Algorithm(nlopt.GN_ESCH, stochastic=True),
}
"""What a recipe may ask for, alone or one after the other: `sbplx`, `bobyqa+neldermead`, `crs2+sbplx`."""

FIRST_STEP = 0.25
"""Initial step of a local search, as a part of each parameter's range."""

PENALTY = 1e3
"""Shown to nlopt for a value that is not finite, until finite ones are known; then 2 * worst + 1 is."""

VALUE_TOLERANCE = 0.1
"""Relative change of the value under which a search ends, as a part of the recipe's tolerance."""

_RANDOM = threading.Lock()  # a build of nlopt without thread-local storage has one generator for all threads


def minimize(
    problem: Target, recipe: RecipeRecord, rng: np.random.Generator, watch: Watch | None = None
) -> Fit:
    """Search from every start of the recipe and return the best point of all.

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
    plan = stages(recipe.algorithm, len(problem.lower))
    design = starting_points(problem.lower, problem.upper, recipe.starts, rng)  # (n, P)
    seeds = rng.integers(1, 2**31, size=len(design))
    done = _resumed(watch, design)

    def run(index: int, stop: Callable[[], bool]) -> Start:
        books = Ledger(problem, recipe.evaluations, stop)
        return _search(books, plan, recipe.tolerance, (index, design[index], int(seeds[index])))

    for start in _in_threads(run, [i for i in range(len(design)) if i not in done], watch):
        if start.stopped != INTERRUPTED:
            watch.report(start)
        if start.evaluations:
            done[start.index] = start
    return _best(problem, tuple(done[index] for index in sorted(done)), design)


def starting_points(lower: Floats, upper: Floats, count: int, rng: np.random.Generator) -> Floats:
    """Return `count` starts (n, P) spread over the box: a scrambled Halton sequence.

    More starts extend fewer ones. Where nothing is free there is one start, without coordinates.
    """
    if len(lower) == 0:
        return np.empty((1, 0))
    cube = qmc.Halton(len(lower), scramble=True, rng=rng).random(count)
    spread: Floats = lower + cube * (upper - lower)
    return spread


def stages(name: str, dimensions: int) -> tuple[Algorithm, ...]:
    """Return the algorithms that a recipe's `algorithm` names, e.g. `bobyqa+neldermead`.

    Raises
    ------
    ConfigError
        If one of them is unknown.
    """
    parts = [part.strip() for part in name.split("+")]
    unknown = [part for part in parts if part not in ALGORITHMS]
    if unknown:
        raise ConfigError(
            f"there is no algorithm `{unknown[0]}`",
            where="recipe, key `algorithm`",
            expected=f"one of {', '.join(ALGORITHMS)}, or several joined by +",
        )
    named = (ALGORITHMS[part] for part in parts)
    return tuple(a if dimensions >= a.dimensions else ALGORITHMS["neldermead"] for a in named)


def _resumed(watch: Watch, design: Floats) -> dict[int, Start]:
    """Return the starts that need no repetition; FitError if they are another fit's."""
    kept = {index: start for index, start in watch.finished.items() if index < len(design)}
    for index, start in kept.items():
        if start.theta0 != tuple(design[index].tolist()):
            raise FitError(
                f"start {index} of the checkpoint began elsewhere than this fit's",
                mend="run again without --resume; seed, bounds or recipe have changed",
            )
    return kept


def _in_threads(
    run: Callable[[int, Callable[[], bool]], Start], indices: list[int], watch: Watch
) -> Iterator[Start]:
    """Yield each start as it ends, in the calling thread."""
    if watch.jobs <= 1:
        for index in indices:
            if watch.stop():
                return
            yield run(index, watch.stop)
        return
    leave = threading.Event()  # ends the other threads when one of them finds a bug

    def stop() -> bool:
        return leave.is_set() or watch.stop()

    with ThreadPoolExecutor(watch.jobs, thread_name_prefix="start") as pool:
        futures = [pool.submit(run, index, stop) for index in indices]
        try:
            for future in as_completed(futures):
                yield future.result()
        finally:
            leave.set()


def _best(problem: Target, starts: tuple[Start, ...], design: Floats) -> Fit:
    interrupted = len(starts) < len(design) or any(s.stopped == INTERRUPTED for s in starts)
    evaluations = sum(s.evaluations for s in starts)
    best = min(starts, key=lambda s: (s.objective, s.index), default=None)
    if not interrupted and (best is None or not math.isfinite(best.objective)):
        raise FitError(
            f"none of {evaluations} evaluations from {len(starts)} starts could be solved",
            mend="narrow the bounds of the medium, or check depths and layers of the insertions",
        )
    theta = tuple(design[0].tolist()) if best is None else best.theta
    return Fit(
        theta=theta,
        values=problem.values(np.array(theta)),
        objective=math.inf if best is None else best.objective,
        starts=starts,
        evaluations=evaluations,
        failures=sum(s.failures for s in starts),
        interrupted=interrupted,
    )


def _search(
    books: Ledger, plan: tuple[Algorithm, ...], tolerance: float, place: tuple[int, Floats, int]
) -> Start:
    """Return what the start at `place` (index, theta0, seed) comes to."""
    index, theta0, seed = place
    if any(algorithm.stochastic for algorithm in plan):
        with _RANDOM:
            nlopt.srand(seed)
            reason = _in_turn(books, plan, tolerance, theta0)
    else:
        reason = _in_turn(books, plan, tolerance, theta0)
    if books.theta is None and reason != INTERRUPTED:
        reason = "no finite value"
    return Start(
        index=index,
        theta0=tuple(theta0.tolist()),
        theta=tuple((theta0 if books.theta is None else books.theta).tolist()),
        objective=books.objective,
        evaluations=books.evaluations,
        failures=books.failures,
        stopped=reason,
        failed=tuple(books.failed),
    )


def _in_turn(books: Ledger, plan: tuple[Algorithm, ...], tolerance: float, theta0: Floats) -> str:
    """Run the stages, each from the best point so far with its share of what is left of the budget.

    Returns why the last one ended.
    """
    total, reason = books.budget, ""
    for k, algorithm in enumerate(plan):
        left = total - books.evaluations
        books.budget, books.reason = books.evaluations + -(-left // (len(plan) - k)), ""
        start = theta0 if books.theta is None else books.theta
        reason = _stage(books, algorithm.code, tolerance, books.to_cube(start))
        if reason == INTERRUPTED:
            break
    return reason


def _stage(books: Ledger, code: int, tolerance: float, start: Floats) -> str:
    """Let nlopt search from `start` (P,) of the unit cube; return why it ended."""
    if len(start) == 0:
        with suppress(Ended):
            books.evaluate(start)
        return books.reason or "nothing is free"
    optimizer = _optimizer(code, tolerance, len(start))
    bugs: list[BaseException] = []

    def function(cube: Floats, gradient: Floats) -> float:
        try:
            value = books.evaluate(cube)
        except Ended:
            value = math.inf
            optimizer.force_stop()
        except BaseException as error:
            value = math.inf
            bugs.append(error)
            optimizer.force_stop()
        worst = 2 * abs(books.worst) + 1 if math.isfinite(books.worst) else PENALTY
        return value if math.isfinite(value) else worst

    # Nothing is raised inside: some algorithms call on after an exception, which Python does not survive.
    optimizer.set_min_objective(function)
    reason = _run(optimizer, start)
    if bugs:
        raise bugs[0]
    return books.reason or reason


def _optimizer(code: int, tolerance: float, dimensions: int) -> "nlopt.opt":
    optimizer = nlopt.opt(code, dimensions)
    optimizer.set_lower_bounds(np.zeros(dimensions))
    optimizer.set_upper_bounds(np.ones(dimensions))
    optimizer.set_initial_step(np.full(dimensions, FIRST_STEP))
    optimizer.set_xtol_abs(np.full(dimensions, tolerance))
    optimizer.set_ftol_rel(tolerance * VALUE_TOLERANCE)
    return optimizer


def _run(optimizer: "nlopt.opt", start: Floats) -> str:
    """Return why nlopt ended; its answer is not looked at."""
    try:
        optimizer.optimize(start)
    except nlopt.ForcedStop:
        return "stopped"
    except nlopt.RoundoffLimited:
        return "roundoff"
    except (RuntimeError, ValueError, MemoryError) as error:
        return f"nlopt failed: {error}"
    return "tolerance"
