"""Importance sampling about modes: densities known in closed form come back, or k says that they do not."""

import arviz
import numpy as np
import pytest
from sampling_cases import Known, banana, gaussian, two_hills
from scipy.stats import genpareto, norm

from needlefit.inference.importance.pareto import fit_pareto, smooth_weights
from needlefit.inference.importance.sampler import (
    Effort,
    StudentMixture,
    WeightedDraws,
    resample,
    sample_by_importance,
)
from needlefit.inference.sampling.log_density import Evaluator, approximate_by_laplace

EFFORT = Effort(draws=1000, min_ess=1000)


def weighted(known: Known, modes: object = None, effort: Effort = EFFORT, seed: int = 1) -> WeightedDraws:
    ends = np.atleast_2d(np.zeros(known.dimensions) if modes is None else modes)
    evaluator = Evaluator(known, 1)
    about = [approximate_by_laplace(evaluator, end, known.lower, known.upper) for end in ends]
    return sample_by_importance(
        evaluator, about, (known.lower, known.upper), np.random.default_rng(seed), effort
    )


def moments(found: WeightedDraws) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean, covariance, and the mean's Monte Carlo errors."""
    weights = np.exp(found.log_weights)
    mean = weights @ found.thetas
    away = found.thetas - mean
    return mean, (away * weights[:, None]).T @ away, np.sqrt((weights**2) @ away**2)


def test_a_gaussian_is_recovered():
    found = weighted(
        Known(gaussian(np.diag([1.0, 4.0, 0.01]), np.array([1.0, 0.0, -1.0])), 3), [1.0, 0.0, -1.0]
    )
    mean, covariance, errors = moments(found)
    assert found.certified and found.k < 0.5
    assert np.all(np.abs(mean - [1.0, 0.0, -1.0]) < 4 * errors)
    assert np.diag(covariance) == pytest.approx([1.0, 4.0, 0.01], rel=0.15)


def test_a_correlated_gaussian_of_twenty_dimensions():
    rng = np.random.default_rng(4)
    factor = rng.normal(size=(20, 20))
    covariance = factor @ factor.T / 20 + 0.05 * np.eye(20)
    found = weighted(Known(gaussian(covariance), 20), effort=Effort(draws=2000, rounds=1, min_ess=300))
    mean, got, errors = moments(found)
    assert found.certified
    assert np.all(np.abs(mean) < 5 * errors)
    assert got == pytest.approx(covariance, abs=8 * errors.max())


def test_a_banana_is_recovered():
    """E x1 = 1, var x1 = 2.25; x0 is normal; from its Laplace approximation alone k says that it does not."""
    once = weighted(Known(banana, half=40.0), effort=Effort(rounds=1, min_ess=1))
    found = weighted(Known(banana, half=40.0))
    mean, covariance, errors = moments(found)
    assert found.certified and once.k > found.k
    assert np.all(np.abs(mean - [0.0, 1.0]) < 4 * errors)
    assert covariance[1, 1] == pytest.approx(2.25, rel=0.15)
    order = np.argsort(found.thetas[:, 0])
    below = np.cumsum(np.exp(found.log_weights[order]))
    at = np.interp([0.05, 0.5, 0.95], below, found.thetas[order, 0])
    assert at == pytest.approx(norm.ppf([0.05, 0.5, 0.95]), abs=0.15)


def test_horns_of_a_banana_are_seen_with_the_default_effort_too():
    """Of weights that looked certified after one round, at the density itself, the mean was 0.5."""
    found = [weighted(Known(banana, half=40.0), effort=Effort(), seed=seed) for seed in range(6)]
    assert np.mean([moments(one)[0][1] for one in found if one.certified]) == pytest.approx(1.0, abs=0.2)


def test_a_density_at_a_bound_is_recovered():
    """exp(x) on [-10, 10]: 10 - x is exponential, its mean 1."""
    found = weighted(Known(lambda x: x[:, 0], 1), [10.0])
    mean, covariance, errors = moments(found)
    assert found.certified
    assert abs(mean[0] - 9.0) < 4 * errors[0] and covariance[0, 0] == pytest.approx(1.0, rel=0.2)


def test_two_equal_modes_have_equal_weight():
    found = weighted(Known(two_hills), [[5.0, 0.0], [-5.0, 0.0]])
    assert found.certified
    assert np.exp(found.log_weights)[found.thetas[:, 0] > 0].sum() == pytest.approx(0.5, abs=0.06)


def test_heavy_tails_are_not_certified():
    """Weights of a Pareto law with k = 1.5 have no mean; k is drawn to 0.5, by ten weights."""
    heavy = np.log(genpareto.rvs(1.5, size=20000, random_state=3))
    found = WeightedDraws(
        np.zeros((20000, 1)), np.zeros(20000), *smooth_weights(heavy), min_ess=1.0, log_evidence=0.0
    )
    assert found.k == pytest.approx(1.5, abs=0.4) and not found.certified


@pytest.mark.filterwarnings("ignore:.*ArviZ.*:FutureWarning")  # once a day
@pytest.mark.parametrize("shape", [-0.3, 0.2, 0.9])
def test_smoothed_weights_are_arviz_s(shape):
    log_weights = np.log(genpareto.rvs(shape, size=1500, random_state=5))
    ours, k = smooth_weights(log_weights)
    theirs, their_k = arviz.psislw(log_weights.copy())
    assert k == pytest.approx(float(their_k), abs=1e-10)
    assert ours == pytest.approx(np.asarray(theirs), abs=1e-10)


def test_the_fit_finds_a_pareto_law():
    shape, scale = fit_pareto(np.sort(genpareto.rvs(0.4, scale=2.0, size=4000, random_state=1)))
    assert (shape, scale) == (pytest.approx(0.4, abs=0.06), pytest.approx(2.0, rel=0.08))


def test_a_mixture_is_fitted_to_its_own_draws():
    rng = np.random.default_rng(2)
    true = StudentMixture(
        np.array([0.7, 0.3]), np.array([[0.0, 0.0], [6.0, 1.0]]), np.array([np.eye(2), 0.5 * np.eye(2)])
    )
    draws = true.draw(4000, rng)
    start = StudentMixture(
        np.array([0.5, 0.5]), np.array([[1.0, 1.0], [4.0, 0.0]]), np.array([np.eye(2)] * 2)
    )
    even = np.full(4000, 1 / 4000)
    for _ in range(15):
        start = start.refit(draws, even, 1e-9 * np.eye(2))
    assert start.weights == pytest.approx(true.weights, abs=0.03)
    assert start.centres == pytest.approx(true.centres, abs=0.12)
    assert np.exp(true.log_density(draws[:1])) > 0


def test_resampled_draws_stand_once_and_by_their_weight():
    rng = np.random.default_rng(7)
    known = WeightedDraws(np.zeros((400, 1)), np.zeros(400), np.log(np.full(400, 1 / 400)), 0.0, 1.0, 0.0)
    assert len(set(resample(known, 79, rng).tolist())) == 79
    few = np.log(np.array([0.8, 0.2]))
    drawn = resample(WeightedDraws(np.zeros((2, 1)), np.zeros(2), few, 0.0, 1.0, 0.0), 4000, rng)
    assert np.mean(drawn == 0) == pytest.approx(0.8, abs=0.03)
