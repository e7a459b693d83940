"""What a search makes small: the negative log posterior, or the metric objective.

Both are asked in the same words: a value, a value with its exact gradient, and, where the value is half a
sum of squares but for a constant, the residuals and their exact Jacobian.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from needlefit.errors import ConfigError
from needlefit.schemas.recipe import ObjectiveName

Floats = NDArray[np.float64]


class Box(Protocol):
    """What has bounds."""

    @property
    def lower(self) -> Floats:
        """Lower bounds of theta: (P,)."""

    @property
    def upper(self) -> Floats:
        """Upper bounds of theta: (P,)."""


class Bounded(Box, Protocol):
    """What has a theta."""

    def values(self, theta: Floats) -> dict[str, float]:
        """Return what theta means."""


class Led(Bounded, Protocol):
    """What may know something easier with its best points close by."""

    def approach(self, minimized: ObjectiveName) -> "Weighed | None":
        """Return what leads to the best points of what is minimised; None if nothing is easier."""


class Weighed(Led, Protocol):
    """What has a posterior; `Problem` is one."""

    def log_posterior(self, theta: Floats) -> float:
        """Return the log posterior; not finite where it cannot be computed."""

    def gradient(self, theta: Floats) -> tuple[float, Floats]:
        """Return the log posterior and its gradient (P,)."""

    @property
    def squares(self) -> bool:
        """Whether the log posterior is a constant minus half the residuals' squares."""

    def residuals(self, theta: Floats) -> Floats:
        """Return the whitened residuals (R,)."""

    def jacobian(self, theta: Floats) -> tuple[Floats, Floats]:
        """Return the whitened residuals (R,) and their Jacobian (R, P)."""


@runtime_checkable
class Measured(Led, Protocol):
    """What has a metric objective; `Problem` is one, a fit to tip tracks is not."""

    def objective(self, theta: Floats) -> float:
        """Return the metric objective, mm; not finite where it cannot be computed."""

    def slope(self, theta: Floats) -> tuple[float, Floats]:
        """Return the metric objective and its gradient (P,)."""


@dataclass(frozen=True)
class Goal:
    """A function on a box, to be made small; any of its functions may fail or not be finite.

    Attributes
    ----------
    lower, upper : (P,) array
        Of theta; infinite bounds are for searches that need no box (gradients, least squares).
    value : callable
        theta (P,) -> what is made small.
    gradient : callable or None
        theta -> the value and its exact gradient (P,).
    residuals : callable or None
        theta -> (R,); the value is half their sum of squares but for a constant.
    jacobian : callable or None
        theta -> the residuals and their exact Jacobian (R, P).
    negligible : float
        Absolute change of the value under which a search may end; 0 leaves it to relative changes.
    approach : Goal or None
        An easier goal with its minima next to this one's; a search goes down that first.
    """

    lower: Floats
    upper: Floats
    value: Callable[[Floats], float]
    gradient: Callable[[Floats], tuple[float, Floats]] | None = None
    residuals: Callable[[Floats], Floats] | None = None
    jacobian: Callable[[Floats], tuple[Floats, Floats]] | None = None
    negligible: float = 0.0
    approach: "Goal | None" = None


NEGLIGIBLE = 1e-9
"""Change of the log posterior under which a search for its peak ends."""

APPROACHED = 1e-6
"""The same on the way to where a search begins; small enough to see which starts met."""


def goal_of(problem: Weighed, minimized: ObjectiveName) -> Goal:
    """Return what a recipe's `minimize` names, of one problem, and what leads to its minima.

    Raises
    ------
    ConfigError
        If the problem has no metric objective.
    """
    if minimized == "posterior":
        goal = posterior(problem)
    elif isinstance(problem, Measured):
        goal = metric(problem)
    else:
        raise ConfigError("there is no metric objective of this fit", expected='minimize = "posterior"')
    easier = problem.approach(minimized)
    return goal if easier is None else replace(goal, approach=posterior(easier, APPROACHED))


def posterior(problem: Weighed, negligible: float = NEGLIGIBLE) -> Goal:
    """Return the negative log posterior density in theta."""

    def value(theta: Floats) -> float:
        return -problem.log_posterior(theta)

    def gradient(theta: Floats) -> tuple[float, Floats]:
        density, slope = problem.gradient(theta)
        return -density, -slope

    goal = Goal(problem.lower, problem.upper, value, gradient, negligible=negligible)
    return replace(goal, residuals=problem.residuals, jacobian=problem.jacobian) if problem.squares else goal


def metric(problem: Measured) -> Goal:
    """Return the metric objective: a weighted mean of IPE, TE and EDP, mm."""
    return Goal(problem.lower, problem.upper, problem.objective, problem.slope)
