"""The search from one start: stages in turn, each from the best point so far."""

import threading
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from needlefit.inference.goal import Goal
from needlefit.inference.ledger import Ledger
from needlefit.inference.optimize import by_nlopt
from needlefit.inference.optimize.algorithms import Algorithm, stages
from needlefit.inference.optimize.certify import certified
from needlefit.inference.starts import INTERRUPTED, Place, Start
from needlefit.project.progress import never_stop
from needlefit.schemas.recipe import RecipeRecord

Floats = NDArray[np.float64]

_RANDOM = threading.Lock()  # a build of nlopt without thread-local storage has one generator for all threads


def search(goal: Goal, recipe: RecipeRecord, place: Place, stop: Callable[[], bool] = never_stop) -> Start:
    """Search from one start with a recipe's algorithm, tolerance and budget.

    Returns
    -------
    Start
        The best point seen and why the search ended: "tolerance" if, as far as can be told, at a minimum.
    """
    plan = stages(recipe.algorithm, goal)
    books = Ledger(goal, recipe.evaluations, stop)
    theta0 = np.array(place.theta, dtype=np.float64)
    if any(algorithm.stochastic for algorithm in plan):
        with _RANDOM:
            by_nlopt.seed(place.seed)
            reason = _in_turn(books, plan, recipe.tolerance, theta0)
    else:
        reason = _in_turn(books, plan, recipe.tolerance, theta0)
    if books.theta is None and reason != INTERRUPTED:
        reason = "no finite value"
    return Start(
        index=place.index,
        theta0=place.theta,
        theta=place.theta if books.theta is None else tuple(books.theta.tolist()),
        objective=books.objective,
        evaluations=books.evaluations,
        gradients=books.gradients,
        failures=books.failures,
        stopped=reason,
        failed=tuple(books.failed),
    )


def _in_turn(books: Ledger, plan: tuple[Algorithm, ...], tolerance: float, theta0: Floats) -> str:
    """Run the stages, each with its share of what is left of the budget; return why the last one ended."""
    total, reason = books.budget, ""
    for k, algorithm in enumerate(plan):
        left = total - books.evaluations
        books.budget, books.reason = books.evaluations + -(-left // (len(plan) - k)), ""
        reason = algorithm.run(books, theta0 if books.theta is None else books.theta, tolerance)
        if reason == INTERRUPTED:
            return reason
    return certified(books, reason)
