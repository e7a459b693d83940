"""Evaluate the density that is sampled, guarded against failures, and its Laplace approximation.

That is the Gaussian with the density's curvature at its peak. Where it is not finite the bounds decide.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from needlefit.arrays import Floats
from needlefit.inference.fit import EVALUATION_ERRORS
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.interpolated_density import InterpolatedDensity


@dataclass
class Evaluator:
    """Evaluate the density of many thetas at once; failures are counted and get density 0."""

    problem: Problem
    jobs: int  #: threads
    failures: int = 0  #: evaluations that were no number, or raised
    interpolated: InterpolatedDensity | None = None  #: in place of the problem's own

    def __call__(self, thetas: Floats) -> Floats:
        """Return the log densities (W,) of `thetas` (W, P)."""
        inside = np.all((thetas >= self.problem.lower) & (thetas <= self.problem.upper), axis=1)
        density = np.full(len(thetas), -math.inf)
        if np.any(inside):
            logs = self._guarded(thetas[inside])
            failed_rows = np.isnan(logs) | (logs == math.inf)
            density[inside] = np.where(failed_rows, -math.inf, logs)
            self.failures += int(failed_rows.sum())
        return density

    def _guarded(self, thetas: Floats) -> Floats:
        """Return the densities, NaN for a theta that raises: it is looked for one by one."""
        try:
            if self.interpolated is not None:
                return self.interpolated(thetas)
            return self.problem.log_posteriors(thetas, self.jobs)
        except EVALUATION_ERRORS:
            if len(thetas) == 1:
                return np.array([math.nan])
            return np.concatenate([self._guarded(theta[None]) for theta in thetas])


#: log densities (W,) of thetas (W, P), -inf where there is none
LogDensityFunction = Callable[[Floats], Floats]
UNIFORM_PRECISION = 12.0  #: precision of a uniform distribution, by its width squared
BOUND_MARGIN = 1e-3  #: a point at a bound is taken this part of the range inside
DIFFERENCE_STEP = 0.1  #: of coordinates in which densities are about one wide, for second differences


@dataclass(frozen=True)
class LaplaceApproximation:
    """The Gaussian at the peak: theta = centre + axes @ z, with z standard normal."""

    centre: Floats  #: (P,)
    axes: Floats  #: (P, P) columns: principal directions times their standard deviations, sloppiest first


def approximate_by_information(
    information: Floats, centre: Floats, lower: Floats, upper: Floats
) -> LaplaceApproximation:
    """Return the Laplace approximation at `centre` (P,) with its information (P, P), within the bounds (P,).

    It is no wider than a uniform distribution within them. Of a sum of squares the information is J^T J.
    """
    width = upper - lower
    inner = np.clip((centre - lower) / width, BOUND_MARGIN, 1 - BOUND_MARGIN)
    precisions, directions = np.linalg.eigh(information * np.outer(width, width))
    sds = 1.0 / np.sqrt(np.maximum(precisions, 0.0) + UNIFORM_PRECISION)
    return LaplaceApproximation(lower + inner * width, width[:, None] * directions * sds)


def difference_information(log_density: LogDensityFunction, theta: Floats) -> Floats:
    """Return the information (P, P) of a density at its peak (P,), by second differences; 0 where unknown."""
    from scipy.differentiate import hessian  # late: it takes 0.1 s to load

    def evaluate(points: Floats) -> Floats:  # (P, ...) -> (...)
        flat = np.moveaxis(points, 0, -1)
        return log_density(flat.reshape(-1, len(theta))).reshape(flat.shape[:-1])

    with np.errstate(invalid="ignore"):  # -inf less -inf: no curvature is known there
        information = hessian(evaluate, theta, maxiter=1, order=2, initial_step=DIFFERENCE_STEP).ddf
    return -np.nan_to_num(information, posinf=0.0, neginf=0.0)
