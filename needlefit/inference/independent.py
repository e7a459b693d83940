"""Proposals that do not depend on where a walker stands: drawn from a picture of the density.

A walker that takes one has forgotten its place, so that a density of which the picture is good is walked in
a few steps. It is at first one Student-t, the Laplace approximation's; later many narrow ones about places
where the ensemble has been, and a wide one about them all, lest a walker stand where hardly any is proposed.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky
from scipy.special import logsumexp

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
        inverse = np.linalg.inv(self.factor).T
        wide = _log_t((points - self.mean) @ inverse, WIDE)
        if not len(self.places):
            return wide
        near = logsumexp(_log_t((points - self.places[:, None]) @ inverse, self.width), axis=0)
        near = near - math.log(len(self.places))
        found: Floats = np.logaddexp(math.log(PART) + wide, math.log1p(-PART) + near)
        return found


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


def _log_t(points: Floats, scale: float) -> Floats:
    """Return the logarithm (...,) of a round Student-t's density at points (..., P), but for a constant."""
    dimensions, squares = points.shape[-1], np.sum(points**2, axis=-1) / scale**2
    found: Floats = -0.5 * (FREEDOM + dimensions) * np.log1p(squares / FREEDOM) - dimensions * math.log(scale)
    return found
