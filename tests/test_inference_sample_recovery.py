"""Posteriors known in closed form come back within Monte Carlo error."""

import numpy as np
import pytest
from pytest import approx
from sampling_cases import Known, draw, flat, gaussian, standard_errors, weighted
from scipy.stats import truncnorm

pytestmark = pytest.mark.sweep

#: the draws that are asked for decide the Monte Carlo error
MANY = {"independent_draws": 4000, "densities": 200_000}


@pytest.mark.parametrize("seed", [1, 2])
def test_a_correlated_gaussian(seed):
    """Of five parameters whose correlations are 0.9."""
    sds = np.array([0.1, 0.3, 1.0, 2.0, 0.5])
    covariance = np.outer(sds, sds) * (0.9 + 0.1 * np.eye(5))
    mean = np.array([1.0, -2.0, 0.0, 3.0, 0.5])
    known = Known(gaussian(covariance, mean), 5, half=20.0)
    got = draw(known, weighted(known, mean, seed=seed), seed=seed, **MANY)
    assert got.faults == ()
    assert np.all(np.abs(flat(got).mean(axis=0) - mean) < 4 * standard_errors(got))
    # the SD of an SD is itself over sqrt(2 n)
    assert flat(got).std(axis=0) == approx(sds, rel=5 / np.sqrt(2 * got.ess.min()))
    assert np.corrcoef(flat(got).T)[0, 1:] == approx(np.full(4, 0.9), abs=0.02)


def test_a_gaussian_that_bounds_cut():
    """Its peak lies in a corner outside; of each coordinate a tail that falls from the bound is left."""
    known = Known(gaussian(np.eye(3), 1.5), 3, half=1.0)
    got = draw(known, weighted(known, np.ones(3)), **MANY)
    x, tail = flat(got), truncnorm(-2.5, -0.5, loc=1.5)
    assert got.faults == () and np.all(np.abs(x) <= 1)
    assert np.all(np.abs(x.mean(axis=0) - tail.mean()) < 4 * standard_errors(got))
    assert x.std(axis=0) == approx(np.full(3, tail.std()), rel=0.05)
    levels = np.quantile(x, [0.05, 0.5, 0.95], axis=0).T
    assert levels == approx(np.tile(tail.ppf([0.05, 0.5, 0.95]), (3, 1)), abs=0.06)
