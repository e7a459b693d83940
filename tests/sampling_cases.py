"""Densities whose moments are known, evaluated many at a time, and the settings to sample them."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from needlefit.inference.sampling.posterior import Posterior
from needlefit.inference.sampling.sample import sample
from needlefit.schemas.recipe import SampleRecord


@dataclass(frozen=True)
class Known:
    """A log density of rows (W, P) on a box of half width `half` about 0."""

    log_density: Callable[[np.ndarray], np.ndarray]
    dimensions: int = 2
    half: float = 10.0

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"x{k}" for k in range(self.dimensions))

    @property
    def lower(self) -> np.ndarray:
        return np.full(self.dimensions, -self.half)

    @property
    def upper(self) -> np.ndarray:
        return np.full(self.dimensions, self.half)

    def log_posteriors(self, thetas: np.ndarray, jobs: int) -> np.ndarray:
        return self.log_density(thetas)

    def values(self, theta: np.ndarray) -> dict[str, float]:
        return dict(zip(self.names, theta.tolist(), strict=True))


def gaussian(covariance: np.ndarray, mean: np.ndarray | float = 0.0) -> Callable[[np.ndarray], np.ndarray]:
    precision = np.linalg.inv(covariance)
    return lambda x: -0.5 * np.sum(((x - mean) @ precision) * (x - mean), axis=1)


def banana(x: np.ndarray) -> np.ndarray:
    """x0 is normal with sd 1; x1 is normal with sd 0.5 about x0^2."""
    return -0.5 * x[:, 0] ** 2 - 0.5 * ((x[:, 1] - x[:, 0] ** 2) / 0.5) ** 2


def two_hills(x: np.ndarray) -> np.ndarray:
    """Of width 0.2 at -5 and 5 in the first coordinate: nothing walks from one to the other."""
    return np.logaddexp(
        -0.5 * np.sum(((x - [5.0, 0.0]) / 0.2) ** 2, axis=1),
        -0.5 * np.sum(((x - [-5.0, 0.0]) / 0.2) ** 2, axis=1),
    )


def settings(**changed: object) -> SampleRecord:
    return SampleRecord.model_validate({"steps": 8000, "check_interval": 100, **changed})


def draw(problem: Known, ends: object = None, seed: int = 1, **changed: object) -> Posterior:
    begin = np.zeros(problem.dimensions) if ends is None else ends
    return sample(problem, begin, settings(**changed), np.random.default_rng(seed))


def flat(posterior: Posterior) -> np.ndarray:
    return posterior.draws.reshape(-1, len(posterior.names))


def standard_errors(posterior: Posterior) -> np.ndarray:
    """Monte Carlo standard errors (P,) of the means, by the independent draws that the posterior claims."""
    draws = posterior.convergence.ess_bulk.sum(axis=0)[: len(posterior.names)]
    return flat(posterior).std(axis=0) / np.sqrt(draws)
