"""The quantities that are ranked: functions of parameters and data, compared with the truth."""

from dataclasses import dataclass

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion
from needlefit.inference.forward_model import simulate_deflections
from needlefit.inference.identifiability.precision import linearize
from needlefit.inference.problem import Problem

DESIGN, FIT, TIP, LIKELIHOOD = "stiff_design", "stiff_fit", "tip_mm", "log_likelihood"
"""Beside the parameters: the combination that the design determines best, the one that the data determine
best at the fitted values, the tip of the deepest insertion, and the log likelihood, without which the prior
itself would pass for a posterior."""


@dataclass(frozen=True)
class RankedQuantities:
    """The ranked functions of theta under one problem.

    Attributes
    ----------
    problem : Problem
    directions : (2, P) array
        Unit vectors of `DESIGN` and `FIT`.
    tip : Insertion
        As planned.
    """

    problem: Problem
    directions: Floats
    tip: Insertion

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the Q quantities; with a single parameter no combination is added."""
        free = self.problem.names
        return (*free, *((DESIGN, FIT) if len(free) > 1 else ()), TIP, LIKELIHOOD)

    def __call__(self, thetas: Floats, log_posterior: Floats) -> Floats:
        """Return the quantities (N, Q) at thetas (N, P)."""
        combined = thetas @ self.directions.T if thetas.shape[1] > 1 else thetas[:, :0]
        sets = [self.problem.values(theta) for theta in thetas]
        prior = self.problem.parameters.prior
        likelihood = log_posterior - [prior.log_density(values) for values in sets]
        medium, needle = self.problem.medium, self.problem.dataset.needle
        (tips,) = simulate_deflections(sets, medium, needle, [self.tip], [np.array([self.tip.depth])])
        return np.column_stack([thetas, combined, tips, likelihood])


def best_determined_direction(problem: Problem, theta: Floats) -> Floats:
    """Return the combination (P,), of length 1, that the insertions determine best at theta."""
    if len(theta) == 0:
        return np.zeros(0)
    _, slope, _ = linearize(problem, theta)
    vector: Floats = np.linalg.svd(slope, full_matrices=False)[2][0]
    upright: Floats = vector * np.sign(vector[np.argmax(np.abs(vector))])
    return upright
