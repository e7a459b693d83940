"""Evaluate the density that is sampled, guarded against failures, and its Laplace approximation.

That is the Gaussian with the density's curvature at its peak. Curvatures are differences of the log density
over adaptive steps: in each parameter the longest of a list over which it falls by at most
`MAX_LOG_DENSITY_DROP`. Where it is not finite the bounds decide.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

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
            found = self._guarded(thetas[inside])
            failed_rows = np.isnan(found) | (found == math.inf)
            density[inside] = np.where(failed_rows, -math.inf, found)
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
#: largest fall of the log density over one step: one standard deviation, if all other parameters are held
MAX_LOG_DENSITY_DROP = 0.5
STEP_FRACTIONS = 0.25 * 0.5 ** np.arange(0, 16)  #: steps that are tried, as parts of the range
UNIFORM_PRECISION = 12.0  #: precision of a uniform distribution, by its width squared
BOUND_MARGIN = 1e-3  #: a point at a bound is taken this part of the range inside: differences need both sides


@dataclass(frozen=True)
class LaplaceApproximation:
    """The Gaussian at the peak: theta = centre + axes @ z, with z standard normal."""

    centre: Floats  #: (P,)
    axes: Floats  #: (P, P) columns: principal directions times their standard deviations, sloppiest first


def approximate_by_laplace(
    log_density: LogDensityFunction, centre: Floats, lower: Floats, upper: Floats
) -> LaplaceApproximation:
    """Return the Laplace approximation at `centre` (P,), no wider than uniform within the bounds (P,)."""
    width = upper - lower
    inner = np.clip((centre - lower) / width, BOUND_MARGIN, 1 - BOUND_MARGIN)  # in the unit cube

    def at(points: Floats) -> Floats:
        return log_density(lower + points * width)

    with np.errstate(invalid="ignore"):  # -inf less -inf: no curvature is known there
        steps = _choose_steps(at, inner)
        information = _difference_information(at, inner, steps) / np.outer(steps, steps)
    return _approximate(information, lower + inner * width, width)


def approximate_by_information(
    information: Floats, centre: Floats, lower: Floats, upper: Floats
) -> LaplaceApproximation:
    """Return the Laplace approximation at `centre` (P,) whose information (P, P) is known.

    Of a sum of squares that is J^T J: no density has to be evaluated.
    """
    width = upper - lower
    inner = np.clip((centre - lower) / width, BOUND_MARGIN, 1 - BOUND_MARGIN)
    return _approximate(information * np.outer(width, width), lower + inner * width, width)


def _approximate(information: Floats, centre: Floats, width: Floats) -> LaplaceApproximation:
    """Return the approximation with this information in the unit cube, no wider than uniform in it."""
    precisions, directions = np.linalg.eigh(information)
    sds = 1.0 / np.sqrt(np.maximum(precisions, 0.0) + UNIFORM_PRECISION)
    return LaplaceApproximation(centre, width[:, None] * directions * sds)


def _choose_steps(at: LogDensityFunction, centre: Floats) -> Floats:
    """Return the step (P,) of each parameter."""
    steps = np.minimum(STEP_FRACTIONS[:, None], np.minimum(centre, 1 - centre))  # (L, P), within the cube
    moves = steps[:, :, None] * np.eye(len(centre))  # (L, P, P)
    ends = np.concatenate([[centre], *(centre + sign * moves.reshape(-1, len(centre)) for sign in (1, -1))])
    found = at(ends)
    falls = (found[0] - np.min(found[1:].reshape(2, *steps.shape), axis=0)) <= MAX_LOG_DENSITY_DROP  # (L, P)
    # argmax finds the first True, the longest step; without any, the shortest is taken
    chosen = np.where(falls.any(axis=0), np.argmax(falls, axis=0), len(STEP_FRACTIONS) - 1)
    return steps[chosen, np.arange(len(centre))]


def _difference_information(at: LogDensityFunction, centre: Floats, steps: Floats) -> Floats:
    """Return the negative second differences (P, P) over one step of each parameter."""
    moves, dimensions = np.diag(steps), len(steps)
    pairs = list(combinations(range(dimensions), 2))
    signs = ((1, 1), (-1, -1), (1, -1), (-1, 1))
    corners = [a * moves[i] + b * moves[j] for i, j in pairs for a, b in signs]
    found = at(centre + np.array([np.zeros(dimensions), *moves, *-moves, *corners]))
    plus, minus, four = np.split(found[1:], [dimensions, 2 * dimensions])
    information = np.diag(2 * found[0] - plus - minus)
    for (i, j), (pp, mm, pm, mp) in zip(pairs, four.reshape(-1, 4), strict=True):
        # mixed second difference; its sign is that of the negative log density
        information[i, j] = information[j, i] = (pm + mp - pp - mm) / 4
    return np.where(np.isfinite(information), information, 0.0)
