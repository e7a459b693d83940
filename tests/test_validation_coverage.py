"""Shares of intervals that held: repeats are no trials of their own."""

import numpy as np
import pytest

from needlefit.inference.predict import PredictiveMixture, simulate_shape_pit
from needlefit.inference.proportions import estimate_proportion, wilson_interval


def test_wilson_gives_the_textbook_interval():
    low, high = wilson_interval(0.5, 10)  # scipy.stats.binomtest(5, 10).proportion_ci(method="wilson")
    assert (low, high) == pytest.approx((0.236593, 0.763407), abs=1e-6)
    assert wilson_interval(1.0, 6)[1] == 1.0


def test_repeats_of_one_specimen_do_not_narrow_the_interval():
    alone = estimate_proportion([True, True, False], ["1", "2", "3"])
    repeated = estimate_proportion([True] * 8 + [False] * 4, [n for n in "123" for _ in range(4)])
    assert (repeated.hits, repeated.trials, repeated.groups) == (8, 12, 3)
    assert (repeated.low, repeated.high) == pytest.approx((alone.low, alone.high))


@pytest.mark.parametrize("length", [0.01, 5.0, 1e6])
def test_a_whole_curve_leaves_its_band_at_the_nominal_rate(length):
    """PIT values of curves drawn from the prediction are uniform, whether points are correlated or not."""
    rng, s = np.random.default_rng(3), np.arange(30.0)
    covariance = 0.04 * np.exp(-np.abs(s[:, None] - s) / length) + 1e-9 * np.eye(30)
    root = np.linalg.cholesky(covariance)
    means = 0.1 * rng.normal(size=(100, 1)) * s
    mixture = PredictiveMixture(means, np.sqrt(np.diag(covariance)))
    observed = means[rng.integers(100, size=300)] + rng.normal(size=(300, 30)) @ root.T
    levels = np.array([simulate_shape_pit(mixture, covariance, one, rng) for one in observed])
    for level in (0.5, 0.95):  # 300 trials: four standard deviations
        assert np.mean(levels <= level) == pytest.approx(level, abs=4 * np.sqrt(level * (1 - level) / 300))
