"""The books of one search: what was evaluated, what failed, what was best, and when to end."""

import math
from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from needlefit.errors import NeedlefitError
from needlefit.inference.starts import INTERRUPTED

Floats = NDArray[np.float64]

FAILURES = (NeedlefitError, ArithmeticError, np.linalg.LinAlgError)
"""What an evaluation may raise and be counted as failed; anything else is a bug and ends the search."""

KEPT = 20
"""Failed points that one start, or one ensemble of the sampler, keeps; the others are only counted."""


class Target(Protocol):
    """What can be minimised; `Problem` is one."""

    @property
    def lower(self) -> Floats:
        """Lower bounds of theta: (P,)."""

    @property
    def upper(self) -> Floats:
        """Upper bounds of theta: (P,)."""

    def objective(self, theta: Floats) -> float:
        """Return what is minimised; not finite where it cannot be computed."""

    def values(self, theta: Floats) -> dict[str, float]:
        """Return what theta means."""


class Ended(Exception):  # noqa: N818  (no error: the way out of a search)
    """The search is over: its budget is spent, or a stop was asked for."""


class Ledger:
    """Evaluates a target on the unit cube and keeps the books.

    Attributes
    ----------
    budget : int
        Evaluations allowed; the next one ends the search.
    theta : (P,) array or None
        Best point seen, None before any evaluation succeeded.
    objective, worst : float
        Smallest and largest finite value seen.
    evaluations, failures : int
    failed : list of tuple of float
        The first `KEPT` points that failed.
    reason : str
        Why the books ended the search; empty if they did not.
    """

    def __init__(self, target: Target, budget: int, stop: Callable[[], bool]) -> None:
        self._target, self._stop = target, stop
        self._lower, self._span = target.lower, target.upper - target.lower
        self.budget = budget
        self.theta: Floats | None = None
        self.objective, self.worst = math.inf, -math.inf
        self.evaluations = self.failures = 0
        self.failed: list[tuple[float, ...]] = []
        self.reason = ""

    def to_cube(self, theta: Floats) -> Floats:
        """Return a point of the box as one of the unit cube."""
        cube: Floats = np.clip((theta - self._lower) / self._span, 0.0, 1.0)
        return cube

    def evaluate(self, cube: Floats) -> float:
        """Return the target's value at a point of the unit cube, infinite where it failed.

        Raises
        ------
        Ended
            Instead of evaluating, once the budget is spent or a stop is asked for.
        """
        if self._stop():
            self.reason = INTERRUPTED
        elif self.evaluations >= self.budget:
            self.reason = "budget"
        if self.reason:
            raise Ended
        return self._book(self._lower + np.clip(cube, 0.0, 1.0) * self._span)

    def _book(self, theta: Floats) -> float:
        self.evaluations += 1
        try:
            value = float(self._target.objective(theta.copy()))
        except FAILURES:
            value = math.nan
        if not math.isfinite(value):
            self.failures += 1
            if len(self.failed) < KEPT:
                self.failed.append(tuple(theta.tolist()))
            return math.inf
        self.worst = max(self.worst, value)
        if value < self.objective:
            self.objective, self.theta = value, theta
        return value
