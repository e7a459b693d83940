"""Predictive mixtures against closed forms and integrals."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import ndtr, ndtri
from scipy.stats import norm

from needlefit.inference.predict import PredictiveMixture, cdf, crps, interval, quantile


def one(mean, sd):
    return PredictiveMixture(np.full((3, 1), float(mean)), np.array([float(sd)]))


def test_equal_draws_are_one_gaussian():
    low, high = interval(one(2.0, 0.5), 0.95)
    assert low == pytest.approx(2.0 - 1.959964 * 0.5, abs=1e-6)
    assert high == pytest.approx(2.0 + 1.959964 * 0.5, abs=1e-6)
    assert cdf(one(2.0, 0.5), [2.5]) == pytest.approx(ndtr(1.0))
    assert quantile(one(2.0, 0.5), 0.9) == pytest.approx(2.0 + 0.5 * ndtri(0.9))
    # of a standard Gaussian at its mean: (sqrt(2) - 1) / sqrt(pi)
    assert crps(one(0.0, 1.0), [0.0]) == pytest.approx((np.sqrt(2) - 1) / np.sqrt(np.pi))


def test_a_point_prediction_scores_its_absolute_error():
    assert crps(one(1.0, 0.0), [3.5]) == pytest.approx(2.5)
    spread = PredictiveMixture(np.array([[0.0], [1.0], [2.0], [3.0]]), np.zeros(1))
    # sum over i of |y - x_i| / n - sum over pairs of |x_i - x_j| / (2 n^2)
    assert crps(spread, [1.0]) == pytest.approx(
        (1 + 0 + 1 + 2) / 4 - (2 * (3 * 1 + 2 * 2 + 1 * 3)) / (2 * 16)
    )


def test_the_score_is_the_integral_that_defines_it():
    rng = np.random.default_rng(3)
    mixture, y = PredictiveMixture(rng.normal(size=(7, 1)), np.array([0.4])), 0.3

    def squared(x):
        return float(cdf(mixture, [x])[0] - (x >= y)) ** 2

    integral = quad(squared, -8, y)[0] + quad(squared, y, 8)[0]
    assert crps(mixture, [y]) == pytest.approx(integral, rel=1e-6)


@pytest.mark.parametrize("sd", [0.0, 0.05, 1.0])
def test_crps_of_many_draws_with_heavy_tails_is_that_of_all_pairs(sd):
    draws = np.random.default_rng(3).standard_t(2, size=1039)
    found = crps(PredictiveMixture(draws[:, None], np.array([sd])), [0.3])[0]

    def mean_absolute(means, width):
        z = means / max(width, 1e-12)
        return np.mean(2 * width * norm.pdf(z) + means * (2 * norm.cdf(z) - 1))

    pairs = mean_absolute(draws[:, None] - draws, np.sqrt(2) * sd)
    assert found == pytest.approx(mean_absolute(0.3 - draws, sd) - pairs / 2, rel=3e-3)


def test_intervals_cover_their_nominal_fraction():
    """Draws of the same distribution as the truth: 50 and 95 % of truths lie within."""
    rng = np.random.default_rng(4)
    mixture = PredictiveMixture(rng.normal(size=(400, 1)), np.array([0.5]))
    truths = rng.normal(size=4000) + 0.5 * rng.normal(size=4000)
    for level in (0.5, 0.95):
        low, high = interval(mixture, level)
        assert np.mean((truths > low) & (truths < high)) == pytest.approx(level, abs=0.03)


def test_each_quantity_by_itself():
    both = PredictiveMixture(np.column_stack([np.zeros(3), np.full(3, 5.0)]), np.array([1.0, 2.0]))
    assert quantile(both, 0.5) == pytest.approx([0.0, 5.0], abs=1e-9)
    assert crps(both, [0.0, 5.0]) == pytest.approx((np.sqrt(2) - 1) / np.sqrt(np.pi) * np.array([1.0, 2.0]))
