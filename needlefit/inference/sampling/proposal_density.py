"""Independent proposals: a mixture of Student's t, fitted to the points that an ensemble visited.

A walker that accepts one is independent of its last place, so a good fit mixes in a few steps. At first it is
one Student-t, the Laplace approximation's; later many narrow ones about visited points, and a wide one about
all of them, so that every place is proposed often enough.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cholesky

from needlefit.arrays import Floats

RandomState = np.random.RandomState

DEGREES_OF_FREEDOM = 5.0
"""Degrees of freedom: tails heavier than those of most posteriors."""

MAX_CENTRES = 400
"""Most points that a proposal density is fitted to."""

WIDE_SCALE, WIDE_FRACTION = 1.5, 0.2
"""Scale of the wide Student-t in standard deviations, and the part of the proposals drawn from it."""

MIN_VARIANCE = 1e-8
"""Added to the variances of whitened places: walkers that stood still have none."""


@dataclass(frozen=True)
class ProposalDensity:
    """A mixture of Student's t in P dimensions, all of one shape.

    Attributes
    ----------
    mean : (P,) array
        Middle of the wide one.
    factor : (P, P) array
        Lower Cholesky factor of the covariance that gives them their shape.
    centres : (K, P) array
        Middles of the narrow ones; none before anything is learned.
    width : float
        Scale of the narrow ones.
    """

    mean: Floats
    factor: Floats
    centres: Floats
    width: float

    @property
    def dimensions(self) -> int:
        """P: the number of dimensions."""
        return len(self.mean)

    def draw(self, count: int, random: RandomState) -> Floats:
        """Return `count` independent points (count, P)."""
        steps = random.normal(size=(count, self.dimensions)) @ self.factor.T
        steps = (
            steps * np.sqrt(DEGREES_OF_FREEDOM / random.chisquare(DEGREES_OF_FREEDOM, size=count))[:, None]
        )
        # drawn even if there are no centres: the random numbers used do not depend on what was learned
        wide, chosen = random.uniform(size=(2, count))
        found: Floats = self.mean + WIDE_SCALE * steps
        if len(self.centres):
            around_centres = self.centres[(chosen * len(self.centres)).astype(int)] + self.width * steps
            found = np.where(wide[:, None] < WIDE_FRACTION, found, around_centres)
        return found

    def log_density(self, points: Floats) -> Floats:
        """Return the logarithm (N,) of the density at points (N, P), up to a constant."""
        found = self._density(points, self.mean[None], WIDE_SCALE)
        if len(self.centres):
            found = WIDE_FRACTION * found + (1 - WIDE_FRACTION) * self._density(
                points, self.centres, self.width
            )
        logarithm: Floats = np.log(found)  # tails of powers: never 0
        return logarithm

    def _density(self, points: Floats, about: Floats, scale: float) -> Floats:
        """Return the mean (N,) over the Student-t's about some places (K, P), but for a constant."""
        apart = (points @ self._whitening - (about @ self._whitening)[:, None]) / scale  # (K, N, P)
        squares = np.einsum("knp,knp->kn", apart, apart)
        powers = (1.0 + squares / DEGREES_OF_FREEDOM) ** (-0.5 * (DEGREES_OF_FREEDOM + self.dimensions))
        found: Floats = powers.mean(axis=0) / scale**self.dimensions
        return found

    @cached_property
    def _whitening(self) -> Floats:
        """Whitening matrix (P, P) of the shape, applied from the right."""
        return np.asarray(np.linalg.inv(self.factor).T, dtype=np.float64)


def make_initial_proposal(dimensions: int) -> ProposalDensity:
    """Return the proposal before any adaptation: one Student's t in whitened coordinates."""
    return ProposalDensity(np.zeros(dimensions), np.eye(dimensions), np.empty((0, dimensions)), 1.0)


def fit_proposal(visited: Floats) -> ProposalDensity:
    """Fit a proposal density to points (N, P) where an ensemble has been.

    Scott's width; the places are drawn towards their mean so that the mixture of narrow ones is not wider for
    it (West, J. R. Stat. Soc. B 55 (1993) 409): the more dimensions, the more it is a single one.
    """
    chosen = visited[np.linspace(0, len(visited) - 1, min(MAX_CENTRES, len(visited))).round().astype(int)]
    count, dimensions = chosen.shape
    mean, width = visited.mean(axis=0), count ** (-1 / (dimensions + 4))
    covariance: Floats = np.atleast_2d(np.cov(visited.T)) + MIN_VARIANCE * np.eye(dimensions)
    factor = cholesky(covariance, lower=True)
    return ProposalDensity(mean, factor, mean + math.sqrt(1 - width**2) * (chosen - mean), width)
