"""Objective functions of a search: the negative log posterior, or the metric objective.

Both offer a value, a value with its exact gradient, and, where the value is half a sum of squares but for a
constant, the residuals and their exact Jacobian.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

from needlefit.arrays import Floats
from needlefit.errors import ConfigError
from needlefit.schemas.recipe import ObjectiveName


class SupportsBounds(Protocol):
    """Interface of anything with bounds on theta."""

    @property
    def lower(self) -> Floats:
        """Lower bounds of theta: (P,)."""

    @property
    def upper(self) -> Floats:
        """Upper bounds of theta: (P,)."""


class SupportsValues(SupportsBounds, Protocol):
    """Interface of anything that turns theta into parameter values."""

    def values(self, theta: Floats) -> dict[str, float]:
        """Return the value of every parameter (Pa, mm) at theta."""


class SupportsApproach(SupportsValues, Protocol):
    """Interface of a problem that may offer an easier problem with nearby minima."""

    def approach(self, minimized: ObjectiveName) -> "SupportsPosterior | None":
        """Return an easier problem whose minima lead to those of this one; None if there is none."""


class SupportsPosterior(SupportsApproach, Protocol):
    """Interface of a problem with a posterior; `Problem` is one."""

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
class SupportsMetric(SupportsApproach, Protocol):
    """Interface of a problem with a metric objective; `Problem` is one, an empirical curve is not."""

    def objective(self, theta: Floats) -> float:
        """Return the metric objective, mm; not finite where it cannot be computed."""

    def objective_gradient(self, theta: Floats) -> tuple[float, Floats]:
        """Return the metric objective and its gradient (P,)."""


@dataclass(frozen=True)
class ObjectiveFunction:
    """A function on a box, to be minimised; any evaluation may fail or not be finite.

    Attributes
    ----------
    lower, upper : (P,) array
        Of theta; infinite bounds are for searches that need no box (gradients, least squares).
    value : callable
        theta (P,) -> the value to minimise.
    gradient : callable or None
        theta -> the value and its exact gradient (P,).
    residuals : callable or None
        theta -> (R,); the value is half their sum of squares but for a constant.
    jacobian : callable or None
        theta -> the residuals and their exact Jacobian (R, P).
    absolute_tolerance : float
        Absolute change of the value under which a search may end; 0 leaves it to relative changes.
    approach : ObjectiveFunction or None
        An easier one with its minima next to this one's; a search minimises that first.
    """

    lower: Floats
    upper: Floats
    value: Callable[[Floats], float]
    gradient: Callable[[Floats], tuple[float, Floats]] | None = None
    residuals: Callable[[Floats], Floats] | None = None
    jacobian: Callable[[Floats], tuple[Floats, Floats]] | None = None
    absolute_tolerance: float = 0.0
    approach: "ObjectiveFunction | None" = None


POSTERIOR_TOLERANCE = 1e-9
"""Change of the log posterior under which a search for its peak ends."""

APPROACH_TOLERANCES: dict[ObjectiveName, float] = {"posterior": 1e-6, "metric": 1e-3}
"""The same on the way to where a search begins, by what it minimises.

For a posterior it is small enough to see which starts met. The minima of a metric objective lie elsewhere, so
that a closer approach is lost work.
"""


def make_objective(problem: SupportsPosterior, minimized: ObjectiveName) -> ObjectiveFunction:
    """Return the objective function that a recipe's `minimize` names, with an easier one to start from.

    Raises
    ------
    ConfigError
        If the problem has no metric objective.
    """
    if minimized == "posterior":
        objective_function = make_posterior_objective(problem)
    elif isinstance(problem, SupportsMetric):
        objective_function = make_metric_objective(problem)
    else:
        raise ConfigError("there is no metric objective of this fit", expected='minimize = "posterior"')
    easier = problem.approach(minimized)
    return (
        objective_function
        if easier is None
        else replace(
            objective_function, approach=make_posterior_objective(easier, APPROACH_TOLERANCES[minimized])
        )
    )


def make_posterior_objective(
    problem: SupportsPosterior, absolute_tolerance: float = POSTERIOR_TOLERANCE
) -> ObjectiveFunction:
    """Return the negative log posterior density in theta as an objective function."""

    def value(theta: Floats) -> float:
        return -problem.log_posterior(theta)

    def gradient(theta: Floats) -> tuple[float, Floats]:
        density, slope = problem.gradient(theta)
        return -density, -slope

    objective_function = ObjectiveFunction(
        problem.lower, problem.upper, value, gradient, absolute_tolerance=absolute_tolerance
    )
    return (
        replace(objective_function, residuals=problem.residuals, jacobian=problem.jacobian)
        if problem.squares
        else objective_function
    )


def make_metric_objective(problem: SupportsMetric) -> ObjectiveFunction:
    """Return the metric objective, a weighted mean of IPE, TE and EDP (mm), as an objective function."""
    return ObjectiveFunction(problem.lower, problem.upper, problem.objective, problem.objective_gradient)
