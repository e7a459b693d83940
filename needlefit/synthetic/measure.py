"""What the scanner and the registration make of a true centreline."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from needlefit.datasets.insertion import Noise
from needlefit.geometry.curves import arc_length

Floats = NDArray[np.float64]

NOISE = Noise(registration_mean=0.19, point_sd=0.03, correlated_sd=0.1, correlation_length=10.0)
"""The paper states the first; the others are what voxels of 0.46 mm leave of a line drawn through them."""

CENTRE = np.array([40.0, 0.0, 0.0])
"""Registration turns about the middle of the box, where the markers' centre lies (world, mm)."""

TURN_PER_SHIFT = 0.01
"""Deviation of a registration's rotation, rad, per mm of deviation of its shift."""

TURN_SD = TURN_PER_SHIFT * NOISE.registration_mean / np.sqrt(8 / np.pi)
"""Deviation of a registration's rotation per axis, rad (to a few percent: `draw_registration` is exact)."""


@dataclass(frozen=True)
class Registration:
    """A small rigid motion: a turn (3,) (rad) about `CENTRE`, then a shift (3,) (mm)."""

    shift: Floats
    turn: Floats

    def move(self, points: ArrayLike) -> Floats:
        """Return world `points` (N, 3) where this registration puts them."""
        turned = Rotation.from_rotvec(self.turn).apply(np.asarray(points, dtype=np.float64) - CENTRE)
        moved: Floats = turned + CENTRE + self.shift
        return moved


def draw_registration(centerline: Floats, rng: np.random.Generator) -> Registration:
    """Draw a registration whose error has, in expectation, the stated mean over the needle's points."""
    shift_sd = NOISE.registration_mean / mean_error(centerline)
    return Registration(shift_sd * rng.normal(size=3), shift_sd * TURN_PER_SHIFT * rng.normal(size=3))


def mean_error(centerline: Floats) -> float:
    """Return the expected error, averaged over the points (N, 3), of registrations of shift deviation 1 mm.

    At distance r from the centre, the error is Gaussian with deviation 1 along r and sqrt(1 + (q r)^2)
    across, q = `TURN_PER_SHIFT`. With a and b these two and k^2 = b^2 - a^2, its mean length is
    sqrt(8 / pi) (a + b^2 / k asin(k / b)) / 2.
    """
    k = TURN_PER_SHIFT * np.linalg.norm(centerline - CENTRE, axis=1)  # a = 1
    b = np.sqrt(1 + k**2)
    # asin(k / b) / k -> 1 / b as k -> 0
    ratio = np.divide(np.arcsin(k / b), k, out=np.ones_like(k), where=k > 0)
    return float(np.mean(np.sqrt(8 / np.pi) * (1 + b**2 * ratio) / 2))


def measure(centerline: Floats, registration: Registration, rng: np.random.Generator) -> Floats:
    """Return the centreline (N, 3) as measured: registered, with correlated and independent noise."""
    independent = NOISE.point_sd * rng.normal(size=centerline.shape)
    return registration.move(centerline) + correlated(arc_length(centerline), rng) + independent


def correlated(arc: Floats, rng: np.random.Generator) -> Floats:
    """Draw noise (N, 3) at arc lengths (N,) with covariance sd^2 exp(-|ds| / l) per axis, mm.

    Exact from point to point (the process is Markovian): e' = rho e + sqrt(1 - rho^2) n, rho = exp(-ds / l).
    """
    fresh = NOISE.correlated_sd * rng.normal(size=(len(arc), 3))
    rho = np.exp(-np.diff(arc) / NOISE.correlation_length)
    noise = fresh.copy()
    for i, r in enumerate(rho, start=1):
        noise[i] = r * noise[i - 1] + np.sqrt(1 - r**2) * fresh[i]
    return noise
