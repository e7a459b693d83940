"""A smooth random field: how the stiffness of one piece of chicken varies from place to place."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Field:
    """A stationary, isotropic field of mean 0, the sum of plane waves of random direction and phase.

    Wave vectors drawn from N(0, 1/l^2) give the covariance sd^2 exp(-r^2 / (2 l^2)).

    Attributes
    ----------
    waves : (n, 3) array
        Wave vectors, rad/mm.
    phases : (n,) array
        rad.
    sd : float
        Standard deviation over all fields.
    """

    waves: Floats
    phases: Floats
    sd: float

    @classmethod
    def draw(cls, rng: np.random.Generator, sd: float, length: float, waves: int = 64) -> Self:
        """Draw a field of deviation `sd` and correlation length `length` (mm)."""
        return cls(rng.normal(0, 1 / length, (waves, 3)), rng.uniform(0, 2 * np.pi, waves), sd)

    def at(self, points: ArrayLike) -> Floats:
        """Return the field (N,) at world `points` (N, 3)."""
        angles = np.asarray(points, dtype=np.float64) @ self.waves.T + self.phases  # (N, n)
        field: Floats = self.sd * np.sqrt(2 / len(self.phases)) * np.cos(angles).sum(axis=1)
        return field
