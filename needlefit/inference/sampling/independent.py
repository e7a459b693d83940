"""Proposals that do not depend on where a walker stands: drawn from a picture of the density.

A walker that takes one has forgotten its place, so that a density of which the picture is good is walked in
a few steps. It is at first one Student-t, the Laplace approximation's; later many narrow ones about places
where the ensemble has been, and a wide one about them all, lest a walker stand where hardly any is proposed.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky

Floats = NDArray[np.float64]
Random = np.random.RandomState

FREEDOM = 5.0
"""Degrees of freedom: tails heavier than those of most posteriors."""

PLACES = 400
"""Places at most that a picture is made of."""

WIDE, PART = 1.5, 0.2
"""Scale of the wide Student-t in standard deviations, and the part of the proposals drawn from it."""

LEAST = 1e-8
"""Added to the variances of whitened places: walkers that stood still have none."""


@dataclass(frozen=True)
class Picture:
    """A mixture of Student-t's in P dimensions, all of one shape.

    Attributes
    ----------
    mean : (P,) array
        Middle of the wide one.
    factor : (P, P) array
        Lower Cholesky factor of the covariance that gives them their shape.
    places : (K, P) array
        Middles of the narrow ones; none before anything is learned.
    width : float
        Scale of the narrow ones.
    """

    mean: Floats
    factor: Floats
    places: Floats
    width: float

    @property
    def dimensions(self) -> int:
        """P."""
        return len(self.mean)

    def draw(self, count: int, random: Random) -> Floats:
        """Return as many independent points (count, P)."""
        steps = random.normal(size=(count, self.dimensions)) @ self.factor.T
        steps = steps * np.sqrt(FREEDOM / random.chisquare(FREEDOM, size=count))[:, None]
        wide, chosen = random.uniform(size=(2, count))
        found: Floats = self.mean + WIDE * steps
        if len(self.places):
            near = self.places[(chosen * len(self.places)).astype(int)] + self.width * steps
            found = np.where(wide[:, None] < PART, found, near)
        return found

    def log_density(self, points: Floats) -> Floats:
        """Return the logarithm (N,) of the density at points (N, P), but for a constant."""
        found = self._density(points, self.mean[None], WIDE)
        if len(self.places):
            found = PART * found + (1 - PART) * self._density(points, self.places, self.width)
        logarithm: Floats = np.log(found)  # tails of powers: never 0
        return logarithm

    def _density(self, points: Floats, about: Floats, scale: float) -> Floats:
        """Return the mean (N,) over the Student-t's about some places (K, P), but for a constant."""
        apart = (points @ self._round - (about @ self._round)[:, None]) / scale  # (K, N, P)
        squares = np.einsum("knp,knp->kn", apart, apart)
        powers = (1.0 + squares / FREEDOM) ** (-0.5 * (FREEDOM + self.dimensions))
        found: Floats = powers.mean(axis=0) / scale**self.dimensions
        return found

    @cached_property
    def _round(self) -> Floats:
        """What makes the shape round (P, P), from the right."""
        return np.asarray(np.linalg.inv(self.factor).T, dtype=np.float64)


def unlearned(dimensions: int) -> Picture:
    """Return the picture before anything is learned, of whitened coordinates."""
    return Picture(np.zeros(dimensions), np.eye(dimensions), np.empty((0, dimensions)), 1.0)


def learned(seen: Floats) -> Picture:
    """Return the picture of a density from places (N, P) where an ensemble has been.

    Scott's width; the places are drawn towards their mean so that the mixture of narrow ones is not wider for
    it (West, J. R. Stat. Soc. B 55 (1993) 409): the more dimensions, the more it is a single one.
    """
    chosen = seen[np.linspace(0, len(seen) - 1, min(PLACES, len(seen))).round().astype(int)]
    count, dimensions = chosen.shape
    mean, width = seen.mean(axis=0), count ** (-1 / (dimensions + 4))
    covariance: Floats = np.atleast_2d(np.cov(seen.T)) + LEAST * np.eye(dimensions)
    factor = cholesky(covariance, lower=True)
    return Picture(mean, factor, mean + math.sqrt(1 - width**2) * (chosen - mean), width)
