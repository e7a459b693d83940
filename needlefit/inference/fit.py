"""Run of a search (starts and fit), and the callbacks that report and stop it.

Objective functions are the negative log posterior, half a sum of squares but for a constant, whose residuals
have an exact Jacobian, or the metric objective, which has an exact gradient.
"""

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from needlefit.arrays import Floats
from needlefit.errors import ModelError
from needlefit.inference.metric_objective import WeightedDistances
from needlefit.project.callbacks import Step, never_stop, no_step
from needlefit.schemas.recipe import ObjectiveName

INTERRUPTED = "interrupted"

BEHIND = "behind"  #: status of a start that was not continued after its approach
#: status of a start that stands for a better point, which the profiles about the fit met
MET_BY_PROFILE = "profile"
#: reasons to end after which no further gain is expected
CONVERGED_REASONS = ("tolerance", "bound", "flat", "roundoff")


@dataclass(frozen=True)
class StartPoint:
    """Where one local search begins: its number and theta."""

    index: int
    theta: tuple[float, ...]


@dataclass(frozen=True)
class Start:
    """The result of one local search."""

    index: int  #: which of the recipe's starts, from 0
    #: theta0, theta: where it began, and the best point that it evaluated
    theta0: tuple[float, ...]
    theta: tuple[float, ...]
    #: at `theta`: the negative log posterior, or mm of the metric objective; infinite if no evaluation
    #: succeeded
    objective: float
    #: evaluations, failures: what was evaluated, and what of it failed
    evaluations: int
    failures: int
    #: why it ended: "tolerance" at a minimum, and nothing else is a success: "stalled" (a further step would
    #: gain), "flat" (a parameter has no effect), "bound" (a minimum of the box alone), "budget", "roundoff",
    #: "behind" (left after its approach), "interrupted", "no finite value", "profile" (no search: a better
    #: point that a profile met), ...
    stopped: str
    gradients: int = 0  #: evaluations with derivatives among all; one costs about two without
    joined: int | None = None  #: the start that it met on the way, whose end is its own


@dataclass(frozen=True)
class Fit:
    """The best of all local searches, and all of them."""

    theta: tuple[float, ...]
    values: Mapping[str, float]  #: every parameter at `theta` (Pa, mm)
    objective: float  #: the negative log posterior, or mm of the metric objective, at `theta`
    starts: tuple[Start, ...]  #: in the order of their index; one that was interrupted says so
    #: evaluations, failures: over all starts
    evaluations: int
    failures: int
    interrupted: bool  #: whether the search was stopped before all starts had ended
    minimized: ObjectiveName = "posterior"
    gradients: int = 0  #: over all starts
    #: free parameters that were held at the centre of their prior, which hardly move any measured point
    held: tuple[str, ...] = ()

    @property
    def fault(self) -> str:
        """Why the best point may not be a minimum; empty if a search ended at one."""
        if not self.starts or any(start.stopped in CONVERGED_REASONS for start in self.starts):
            return ""
        reasons = ", ".join(sorted({start.stopped for start in self.starts} - {BEHIND, MET_BY_PROFILE}))
        fix = "needlefit explain not-converged"
        if any(start.stopped == "budget" for start in self.starts):
            fix = "raise `evaluations` in the recipe"
        return f"no start of the search ended at a minimum ({reasons}); {fix}"


@dataclass(frozen=True)
class Callbacks:
    """Callbacks to report and stop a long computation."""

    stop: Callable[[], bool] = never_stop  #: asked before every evaluation or step, from any thread
    #: called with how much of a sampler's chain, or of a search, is done, and of how much
    step: Step = no_step
    jobs: int = 1  #: threads; the result does not depend on their number


@dataclass(frozen=True)
class ObjectiveFunction:
    """A function on a box, to be minimised; any evaluation may fail or not be finite."""

    #: lower, upper: (P,) of theta; infinite bounds are for searches that need no box (gradients, least
    #: squares)
    lower: Floats
    upper: Floats
    value: Callable[[Floats], float]  #: theta (P,) -> the value to minimise
    #: theta -> the value and its exact gradient (P,); for a value that is no sum of squares
    gradient: Callable[[Floats], tuple[float, Floats]] | None = None
    #: theta -> residuals (R,), half whose sum of squares is the value but for a constant, and their exact
    #: Jacobian (R, P)
    jacobian: Callable[[Floats], tuple[Floats, Floats]] | None = None
    #: theta -> the weighted distances whose sum is the value, with their exact derivatives
    distances: Callable[[Floats], WeightedDistances] | None = None
    #: theta -> those residuals that are of data alone, each of size 1 where the model is right
    misfits: Callable[[Floats], Floats] | None = None
    #: absolute change of the value under which a search may end; 0 leaves it to relative changes
    absolute_tolerance: float = 0.0
    #: an easier one with its minima next to this one's; a search minimises that first
    approach: "ObjectiveFunction | None" = None

    @property
    def span(self) -> Floats:
        """Width of the box: (P,)."""
        return self.upper - self.lower


Value = TypeVar("Value")

#: exceptions that count as a failed evaluation; any other one is a bug and ends the search
EVALUATION_ERRORS = (ModelError, ArithmeticError, np.linalg.LinAlgError)


def half_square(residuals: Floats) -> float:
    """Return half the sum of squares; infinite where it overflows."""
    with np.errstate(over="ignore"):
        return 0.5 * float(residuals @ residuals)


FIRST_RADIUS = 2.0  #: largest first step along any parameter: of a logarithm, or of a shape parameter


class SearchEnded(Exception):  # noqa: N818  (no error: the way out of a search)
    """Raised to leave a search: its budget is spent, or a stop was requested."""


class EvaluationRecorder:
    """Evaluate an objective function within its bounds, and record the evaluations.

    Every call of the objective function is one evaluation: of the value, of the residuals, or, counted among
    the `gradients` too, of either with its derivatives (which costs about as much as two values).
    """

    def __init__(self, objective_function: ObjectiveFunction, budget: int, stop: Callable[[], bool]) -> None:
        self.objective_function, self._stop = objective_function, stop
        self.budget = budget  #: evaluations allowed; the next one ends the search
        #: what half the sum of squares lacks to be the value; known once `find_constant` was called
        self.constant = 0.0
        self.theta: Floats | None = None  #: (P,) best point evaluated, None before any evaluation succeeded
        #: (R,), (R, P) residuals and Jacobian at `theta`, where they were evaluated
        self.linearized: tuple[Floats, Floats] | None = None
        self.objective, self.worst = math.inf, -math.inf  #: smallest and largest finite value
        self.evaluations = self.gradients = self.failures = 0
        self.reason = ""  #: why the recorder ended the search; empty if it did not

    def run(self, method: "Callable[[EvaluationRecorder, Floats], str]", start: Floats) -> str:
        """Search from theta `start` (P,) by a method; return why it ended, by itself or by the recorder."""
        reason = ""
        with suppress(SearchEnded):
            reason = method(self, start)
        return self.reason or reason

    def value(self, theta: Floats) -> float:
        """Return the objective, infinite where it failed.

        Raises SearchEnded instead of evaluating, once the budget is spent or a stop is requested; so do all
        other methods.
        """
        point = self._begin_evaluation(theta)
        return self._record(point, self._evaluate(self.objective_function.value, point))

    def gradient(self, theta: Floats) -> tuple[float, Floats]:
        """Return the value and its gradient (P,); infinity and zeros where either failed."""
        point, result = self._differentiate(self.objective_function.gradient, theta)
        if result is None or not np.all(np.isfinite(result[1])):
            return self._record(point, None), np.zeros(len(point))
        value = self._record(point, result[0])
        return value, result[1] if math.isfinite(value) else np.zeros(len(point))

    def jacobian(self, theta: Floats) -> tuple[Floats, Floats] | None:
        """Return the residuals (R,) and their Jacobian (R, P); None where either failed."""
        point, result = self._differentiate(self.objective_function.jacobian, theta)
        if result is None or not np.all(np.isfinite(result[1])):
            self._record(point, None)
            return None
        value = self._record(point, self.constant + half_square(result[0]), result)
        return result if math.isfinite(value) else None

    def distances(self, theta: Floats) -> WeightedDistances | None:
        """Return the weighted distances whose sum is the value; None where they failed."""
        point, result = self._differentiate(self.objective_function.distances, theta)
        value = self._record(point, None if result is None else result.total)
        return result if math.isfinite(value) else None

    def find_constant(self, theta: Floats) -> bool:
        """Find the constant between value and half the sum of squares; return whether theta was solved."""
        value = self.value(theta)
        point, result = self._differentiate(self.objective_function.jacobian, theta)
        if result is None or not math.isfinite(value) or not np.all(np.isfinite(result[0])):
            self._record(point, None)
            return False
        self.constant = value - half_square(result[0])
        if np.all(np.isfinite(result[1])) and self.theta is not None and np.array_equal(point, self.theta):
            self.linearized = result
        return True

    def _differentiate(
        self, function: Callable[[Floats], Value] | None, theta: Floats
    ) -> tuple[Floats, Value | None]:
        """Return theta in its bounds, and what a function gives there with derivatives; None if it fails."""
        assert function is not None
        point = self._begin_evaluation(theta)
        self.gradients += 1
        return point, self._evaluate(function, point)

    def _begin_evaluation(self, theta: Floats) -> Floats:
        """Return a copy of theta in its bounds: rounding may have put it one digit outside."""
        if self._stop():
            self.reason = INTERRUPTED
        elif self.evaluations >= self.budget:
            self.reason = "budget"
        if self.reason:
            raise SearchEnded
        self.evaluations += 1
        # a third of the time of `np.clip`
        return np.minimum(np.maximum(theta, self.objective_function.lower), self.objective_function.upper)

    def _evaluate(self, function: Callable[[Floats], Value], theta: Floats) -> Value | None:
        try:
            # a copy: the point is recorded after the call, so the function must not change it
            return function(theta.copy())
        except EVALUATION_ERRORS:
            return None

    def _record(
        self, theta: Floats, value: float | None, linearized: tuple[Floats, Floats] | None = None
    ) -> float:
        if value is None or not math.isfinite(value):
            self.failures += 1
            return math.inf
        self.worst = max(self.worst, float(value))
        if value < self.objective:
            self.objective, self.theta, self.linearized = float(value), theta, linearized
        return float(value)
