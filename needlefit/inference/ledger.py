"""The books of one search: what was evaluated, what failed, what was best, and when to end."""

import math
from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from needlefit.errors import NeedlefitError
from needlefit.inference.goal import Goal
from needlefit.inference.starts import INTERRUPTED

Floats = NDArray[np.float64]
Answer = TypeVar("Answer")

FAILURES = (NeedlefitError, ArithmeticError, np.linalg.LinAlgError)
"""What an evaluation may raise and be counted as failed; anything else is a bug and ends the search."""

KEPT = 20
"""Failed points that one start, or one ensemble of the sampler, keeps; the others are only counted."""


def half_square(residuals: Floats) -> float:
    """Return half the sum of squares; infinite where it overflows."""
    with np.errstate(over="ignore"):
        return 0.5 * float(residuals @ residuals)


class Ended(Exception):  # noqa: N818  (no error: the way out of a search)
    """The search is over: its budget is spent, or a stop was asked for."""


class Ledger:
    """Evaluates a goal within its bounds and keeps the books.

    Whatever is asked of the goal is one evaluation: of the value, of the residuals, or, counted among the
    `gradients` too, of either with its derivatives (which costs about as much as two values).

    Attributes
    ----------
    budget : int
        Evaluations allowed; the next one ends the search.
    constant : float
        What half the sum of squares lacks to be the value; known once `calibrate` was called.
    theta : (P,) array or None
        Best point seen, None before any evaluation succeeded.
    objective, worst : float
        Smallest and largest finite value seen.
    evaluations, gradients, failures : int
    failed : list of tuple of float
        The first `KEPT` points that failed.
    reason : str
        Why the books ended the search; empty if they did not.
    """

    def __init__(self, goal: Goal, budget: int, stop: Callable[[], bool]) -> None:
        self.goal, self._stop = goal, stop
        self.budget = budget
        self.constant = 0.0
        self.theta: Floats | None = None
        self.objective, self.worst = math.inf, -math.inf
        self.evaluations = self.gradients = self.failures = 0
        self.failed: list[tuple[float, ...]] = []
        self.reason = ""

    def value(self, theta: Floats) -> float:
        """Return the goal's value, infinite where it failed.

        Raises
        ------
        Ended
            Instead of evaluating, once the budget is spent or a stop is asked for; so do all the others.
        """
        place = self._within(theta)
        return self._book(place, self._ask(self.goal.value, place))

    def gradient(self, theta: Floats) -> tuple[float, Floats]:
        """Return the value and its gradient (P,); infinite and without slope where either failed."""
        assert self.goal.gradient is not None
        place = self._within(theta)
        self.gradients += 1
        found = self._ask(self.goal.gradient, place)
        if found is None or not np.all(np.isfinite(found[1])):
            return self._book(place, None), np.zeros(len(place))
        value = self._book(place, found[0])
        return value, found[1] if math.isfinite(value) else np.zeros(len(place))

    def residuals(self, theta: Floats) -> Floats:
        """Return the residuals (R,); a single infinite one where they failed."""
        assert self.goal.residuals is not None
        place = self._within(theta)
        found = self._ask(self.goal.residuals, place)
        value = self._book(place, None if found is None else self.constant + half_square(found))
        return found if found is not None and math.isfinite(value) else np.array([math.inf])

    def jacobian(self, theta: Floats) -> tuple[Floats, Floats] | None:
        """Return the residuals (R,) and their Jacobian (R, P); None where either failed."""
        assert self.goal.jacobian is not None
        place = self._within(theta)
        self.gradients += 1
        found = self._ask(self.goal.jacobian, place)
        if found is None or not np.all(np.isfinite(found[1])):
            self._book(place, None)
            return None
        value = self._book(place, self.constant + half_square(found[0]))
        return found if math.isfinite(value) else None

    def calibrate(self, theta: Floats) -> bool:
        """Find what half the sum of squares lacks to be the value; return whether theta could be solved."""
        assert self.goal.residuals is not None
        value, place = self.value(theta), self._within(theta)
        found = self._ask(self.goal.residuals, place)
        if found is None or not math.isfinite(value) or not np.all(np.isfinite(found)):
            self._book(place, None)
            return False
        self.constant = value - half_square(found)
        return True

    def _within(self, theta: Floats) -> Floats:
        """Return a copy of theta in its bounds: rounding may have put it one digit outside."""
        if self._stop():
            self.reason = INTERRUPTED
        elif self.evaluations >= self.budget:
            self.reason = "budget"
        if self.reason:
            raise Ended
        self.evaluations += 1
        place: Floats = np.clip(theta, self.goal.lower, self.goal.upper)
        return place

    def _ask(self, function: Callable[[Floats], Answer], theta: Floats) -> Answer | None:
        try:
            return function(theta.copy())
        except FAILURES:
            return None

    def _book(self, theta: Floats, value: float | None) -> float:
        if value is None or not math.isfinite(value):
            self.failures += 1
            if len(self.failed) < KEPT:
                self.failed.append(tuple(theta.tolist()))
            return math.inf
        self.worst = max(self.worst, float(value))
        if value < self.objective:
            self.objective, self.theta = float(value), theta
        return float(value)
