"""Two stages against the joint Gaussian model in closed form, where posteriors of specimens are Gaussian."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from needlefit.inference.specimens import (
    KERNELS_PER_SPECIMEN,
    Population,
    Specimen,
    best_determined,
    highest_density_interval,
    make_specimen,
)

RIDGE = np.array([[0.05, -0.024], [-0.024, 0.0144]])
BOUNDS = np.array([4.0, -7.0]), np.array([18.0, -0.5])
MEAN = np.array([10.0, -1.6])


def population(tau: float, count: int, seed: int) -> Population:
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        theta = MEAN + tau * rng.standard_normal(2)
        estimate = rng.multivariate_normal(theta, RIDGE)
        found.append(make_specimen(rng.multivariate_normal(estimate, RIDGE, size=KERNELS_PER_SPECIMEN)))
    return Population(tuple(found), BOUNDS, spread_sd=1.0)


def test_kernels_keep_mean_and_covariance_of_their_draws():
    draws = np.random.default_rng(1).multivariate_normal([1.0, 2.0], RIDGE, size=50)
    found = make_specimen(draws)
    assert found.mean == pytest.approx(draws.mean(axis=0))
    assert found.covariance == pytest.approx(np.cov(draws.T, bias=True))


@pytest.mark.parametrize("tau", [(0.0, 0.0), (0.3, 0.1)])
def test_density_is_that_of_gaussian_estimates_whose_variances_add(tau):
    """One kernel a specimen: estimates are N(m, S + T), and tau has a half-normal prior."""
    estimates = [np.array([10.2, -1.7]), np.array([9.7, -1.5])]
    one = Population(tuple(Specimen(at[None], RIDGE) for at in estimates), BOUNDS, spread_sd=0.5)
    spread = RIDGE + np.diag(np.square(tau))
    expected = sum(multivariate_normal.logpdf(at, MEAN, spread) for at in estimates)
    expected += 2 * np.log(2 * np.pi) - 0.5 * float(np.sum(np.square(tau))) / 0.5**2
    assert one.log_density(np.array([[*MEAN, *tau]])) == pytest.approx([expected])


def test_the_density_is_zero_outside_the_bounds():
    at = np.array([[*MEAN, -0.1, 0.1], [3.0, -1.6, 0.1, 0.1]])
    assert np.all(population(0.3, 3, 1).log_density(at) == -np.inf)


def test_a_spread_of_zero_is_found_to_reach_zero_and_a_large_one_is_not():
    intervals = {}
    for tau in (0.0, 0.6):
        found = population(tau, 10, 3).posterior(np.random.default_rng(4))
        assert found.certified
        weights = np.exp(found.log_weights)
        intervals[tau] = [
            highest_density_interval(column, weights, 0.95, 0.0) for column in found.thetas.T[2:]
        ]
    assert [low for low, _ in intervals[0.0]] == [0.0, 0.0]
    assert max(high for _, high in intervals[0.0]) < 0.2
    assert all(0.2 < low < 0.6 < high < 1.3 for low, high in intervals[0.6])


def test_one_specimen_leaves_the_spread_to_its_prior():
    found = population(0.6, 1, 5).posterior(np.random.default_rng(6))
    weights = np.exp(found.log_weights)
    assert np.sum(weights * found.thetas[:, 2] ** 2) == pytest.approx(1.0, abs=0.25)  # of a half-normal, sd 1


def test_the_best_determined_direction_is_the_stiff_one():
    draws = np.random.default_rng(7).multivariate_normal([0, 0], RIDGE, size=400)
    stiff = np.linalg.eigh(RIDGE)[1][:, 0]
    assert abs(best_determined([make_specimen(draws)]) @ stiff) == pytest.approx(1.0, abs=0.01)


def test_shortest_interval_of_a_half_normal_begins_at_its_end():
    values = np.abs(np.random.default_rng(8).standard_normal(4000))
    low, high = highest_density_interval(values, np.full(4000, 1 / 4000), 0.95, 0.0)
    assert low == 0.0
    assert high == pytest.approx(1.96, abs=0.1)
    low, high = highest_density_interval(values, np.full(4000, 1 / 4000), 0.5, 0.0)
    assert high == pytest.approx(0.674, abs=0.06)
