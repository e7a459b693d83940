"""How probable further data are: evidences of linear Gaussian data, known in closed form."""

import math

import numpy as np
import pytest
from sampling_cases import Known
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from needlefit.inference.sampling.importance import (
    WeightedDraws,
    compute_predictive_density,
    sample_by_importance,
)
from needlefit.inference.sampling.log_density import approximate_by_laplace

SD, FREE = 0.02, 4


def _case():
    """Four numbers of which some points tell a little, and sixty further points much more."""
    rng = np.random.default_rng(5)
    few, many = rng.normal(size=(8, FREE)), rng.normal(size=(60, FREE))
    truth = np.array([0.5, -0.3, 0.2, 0.1])
    return [(a, a @ truth + sd * rng.normal(size=len(a)), sd) for a, sd in ((few, 0.3), (many, SD))]


def _log_density(data):
    def log_density(x):
        return sum(
            -0.5 * np.sum(((x @ a.T - y) / sd) ** 2, axis=1) - len(y) * math.log(sd * math.sqrt(2 * math.pi))
            for a, y, sd in data
        )

    return log_density


def _weighted(data, seed) -> WeightedDraws:
    known = Known(_log_density(data), FREE)
    rows = np.concatenate([a / sd for a, _, sd in data]), np.concatenate([y / sd for _, y, sd in data])
    peak = np.linalg.lstsq(*rows)[0]
    bounds = known.lower, known.upper
    about, rng = [approximate_by_laplace(known.log_density, peak, *bounds)], np.random.default_rng(seed)
    return sample_by_importance(known.log_density, about, bounds, rng)


def _posterior(first):
    a, y, sd = first
    covariance = sd**2 * np.linalg.inv(a.T @ a)
    return covariance @ a.T @ y / sd**2, covariance


def _predictive(first, second):
    (a, y, sd), (mean, covariance) = second, _posterior(first)
    return multivariate_normal.logpdf(y, a @ mean, a @ covariance @ a.T + sd**2 * np.eye(len(y)))


def test_the_density_of_further_data_is_the_ratio_of_evidences():
    first, second = _case()
    exact = _predictive(first, second)
    densities = [
        compute_predictive_density(_weighted([first, second], s), _weighted([first], 100 + s))
        for s in range(8)
    ]
    errors = np.array([one.log_density - exact for one in densities])
    assert np.all(np.abs(errors) < 0.1)
    assert np.sqrt(np.mean(errors**2)) < 1.5 * densities[0].se < 0.2  # the stated error is the error
    assert (
        max(one.k for one in densities) < 0.7 and min(one.effective_sample_size for one in densities) >= 250
    )


def test_a_mean_over_a_hundred_draws_would_miss_it():
    """So the case is one that tells the two apart: too low by nats, and no longer than its own error says."""
    first, second = _case()
    draws = np.random.default_rng(1).multivariate_normal(*_posterior(first), size=(20, 100))
    logs = np.array([_log_density([second])(batch) for batch in draws])
    means = logsumexp(logs, axis=1) - math.log(100)
    assert np.median(means) < _predictive(first, second) - 2.0


def test_the_evidence_of_a_density_is_its_integral():
    """A Gaussian, half of it beyond a bound."""
    known = Known(lambda x: -0.5 * np.sum((x - 10.0) ** 2, axis=1) + 3.0, 1)
    about = [approximate_by_laplace(known.log_density, np.array([9.9]), known.lower, known.upper)]
    bounds, rng = (known.lower, known.upper), np.random.default_rng(2)
    found = sample_by_importance(known.log_density, about, bounds, rng)
    exact = 3.0 + math.log(0.5 * math.sqrt(2 * math.pi))
    assert found.log_evidence == pytest.approx(exact, abs=4 * found.log_evidence_se)
