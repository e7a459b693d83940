"""Densities whose moments are known, evaluated many at a time, and how to weigh and sample them."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from inference_cases import NothingHeld
from numpy.random import default_rng

from needlefit.inference.sampling.importance import (
    Effort,
    Evaluator,
    approximate_by_information,
    difference_information,
    sample_by_importance,
)
from needlefit.inference.sampling.sample import sample
from needlefit.schemas.recipe import SampleRecord

EFFORT = Effort(draws=1000, min_ess=1000)


@dataclass(frozen=True)
class Known(NothingHeld):
    """A log density of rows (W, P) on a box of half width `half` about 0."""

    log_density: Callable[[np.ndarray], np.ndarray]
    dimensions: int = 2
    half: float = 10.0

    @property
    def names(self):
        return tuple(f"x{k}" for k in range(self.dimensions))

    @property
    def lower(self):
        return np.full(self.dimensions, -self.half)

    @property
    def upper(self):
        return np.full(self.dimensions, self.half)

    def log_posteriors(self, thetas, jobs):
        return self.log_density(thetas)

    plain = None  # there are no nodes to interpolate

    def tabulate_values(self, thetas):
        return thetas


def gaussian(covariance, mean=0.0):
    precision = np.linalg.inv(covariance)
    return lambda x: -0.5 * np.sum(((x - mean) @ precision) * (x - mean), axis=1)


def banana(x):
    """x0 is normal with sd 1; x1 is normal with sd 0.5 about x0^2."""
    return -0.5 * x[:, 0] ** 2 - 0.5 * ((x[:, 1] - x[:, 0] ** 2) / 0.5) ** 2


def two_hills(x):
    """Of width 0.2 at -5 and 5 in the first coordinate: nothing walks from one to the other."""
    return np.logaddexp(
        -0.5 * np.sum(((x - [5.0, 0.0]) / 0.2) ** 2, axis=1),
        -0.5 * np.sum(((x - [-5.0, 0.0]) / 0.2) ** 2, axis=1),
    )


def weighted(known, modes=None, effort=EFFORT, seed=1, uniform=None):
    ends = np.atleast_2d(np.zeros(known.dimensions) if modes is None else modes)
    evaluator, bounds = Evaluator(known, 1), (known.lower, known.upper)
    about = [approximate_by_information(difference_information(evaluator, end), end, *bounds) for end in ends]
    marked = None if uniform is None else np.asarray(uniform)
    return sample_by_importance(evaluator, about, bounds, default_rng(seed), (effort,), marked)


def draw(
    known,
    begin,
    callbacks=None,
    seed=1,
    **changed,
):
    settings = SampleRecord.model_validate(changed)
    found = sample(known, begin, settings, default_rng(seed), callbacks)
    assert found is not None
    return found


def flat(posterior):
    return posterior.draws.reshape(-1, len(posterior.names))


def standard_errors(posterior):
    """Monte Carlo standard errors (P,) of the means, by the independent draws that the posterior claims."""
    return flat(posterior).std(axis=0) / np.sqrt(posterior.ess[:-1])
