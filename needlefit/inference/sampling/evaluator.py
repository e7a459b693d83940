"""What can be sampled, and how it is asked so that the sampler never sees a NaN."""

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from needlefit.inference.goal import Bounded
from needlefit.inference.ledger import FAILURES, KEPT

Floats = NDArray[np.float64]


class Density(Bounded, Protocol):
    """What can be sampled; `Problem` is one."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates of theta."""

    def log_posteriors(self, thetas: Floats, jobs: int) -> Floats:
        """Return the log densities (W,) of `thetas` (W, P), not normalised.

        -inf where the density is 0, NaN where it cannot be computed. `jobs` threads may be used; the
        densities do not depend on it.
        """


@dataclass
class Evaluator:
    """The density of many thetas at once; whatever is no number or fails is counted and has density 0.

    Attributes
    ----------
    problem : Density
    jobs : int
        Threads.
    ensembles : int
        What is asked for belongs to as many ensembles, an equal part to each, one after the other.
    failures : int
        Evaluations that were no number, or raised.
    failed : list of lists of theta
        By ensemble the first of these.
    """

    problem: Density
    jobs: int
    ensembles: int = 1
    failures: int = 0
    failed: list[list[tuple[float, ...]]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.failed = [[] for _ in range(self.ensembles)]

    def __call__(self, thetas: Floats) -> Floats:
        """Return the log densities (W,) of `thetas` (W, P)."""
        inside = np.all((thetas >= self.problem.lower) & (thetas <= self.problem.upper), axis=1)
        density = np.full(len(thetas), -math.inf)
        if np.any(inside):
            found = self._guarded(thetas[inside])
            lost = np.isnan(found) | (found == math.inf)
            density[inside] = np.where(lost, -math.inf, found)
            self._note(thetas, np.flatnonzero(inside)[lost])
        return density

    def _note(self, thetas: Floats, lost: NDArray[np.intp]) -> None:
        self.failures += len(lost)
        for row in lost.tolist():
            failed = self.failed[row * self.ensembles // len(thetas)]
            if len(failed) < KEPT:
                failed.append(tuple(thetas[row].tolist()))

    def _guarded(self, thetas: Floats) -> Floats:
        """Return the densities, NaN for a theta that raises: it is looked for one by one."""
        try:
            return self.problem.log_posteriors(thetas, self.jobs)
        except FAILURES:
            if len(thetas) == 1:
                return np.array([math.nan])
            return np.concatenate([self._guarded(theta[None]) for theta in thetas])
