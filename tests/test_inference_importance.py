"""Importance sampling about modes: densities known in closed form come back, or k says that they do not."""

import numpy as np
import pytest
from numpy.random import default_rng
from pytest import approx
from sampling_cases import Known, banana, gaussian, two_hills, weighted
from scipy.stats import genpareto

from needlefit.inference.identifiability.profile import minimize_squares
from needlefit.inference.sampling.importance import Effort, WeightedDraws, resample, sample_about_modes
from needlefit.inference.sampling.pareto_smoothing import smooth_weights


def moments(found):
    """Mean, covariance, and the mean's Monte Carlo errors."""
    weights = np.exp(found.log_weights)
    mean = weights @ found.thetas
    away = found.thetas - mean
    return mean, (away * weights[:, None]).T @ away, np.sqrt((weights**2) @ away**2)


def test_a_banana_is_recovered():
    # E x1 = 1, var x1 = 2.25; x0 is normal; from its Laplace approximation alone k says that it does not.
    once = weighted(Known(banana, half=40.0), effort=Effort(rounds=1, min_ess=1))
    effort = Effort(draws=1000, min_ess=2000.0)
    many = [weighted(Known(banana, half=40.0), None, effort, seed) for seed in range(8)]
    assert all(found.certified and once.k > found.k for found in many)
    # What no draw comes near is missed: the ends of the banana, which have much of the variance.
    means, covariances, _ = (np.mean(part, axis=0) for part in zip(*map(moments, many), strict=True))
    assert means == approx([0.0, 1.0], abs=0.08)
    assert covariances[1, 1] == approx(2.25, rel=0.17)


def test_a_density_at_a_bound_and_two_equal_modes_are_recovered():
    # exp(x) on [-10, 10]: 10 - x is exponential, its mean 1.
    found = weighted(Known(lambda x: x[:, 0], 1), [10.0])
    mean, covariance, errors = moments(found)
    assert found.certified
    assert abs(mean[0] - 9.0) < 4 * errors[0] and covariance[0, 0] == approx(1.0, rel=0.2)
    assert found.log_evidence == approx(10.0, abs=4 * found.log_evidence_se)
    found = weighted(Known(two_hills), [[5.0, 0.0], [-5.0, 0.0]])
    assert found.certified
    assert np.exp(found.log_weights)[found.thetas[:, 0] > 0].sum() == approx(0.5, abs=0.06)


def test_parameters_without_information_are_proposed_uniformly():
    """x2 has no part in the density: it is drawn from its flat prior."""
    mean, covariance = np.array([1.0, -2.0]), np.array([[0.5, 0.3], [0.3, 0.4]])
    known = Known(lambda x: gaussian(covariance, mean)(x[:, :2]), 3)
    found = weighted(known, [1.0, -2.0, 0.0], uniform=[False, False, True])
    centre, spread, errors = moments(found)
    assert found.certified and found.k < 0.5
    assert np.all(np.abs(centre - [*mean, 0.0]) < 4 * errors)
    assert spread[:2, :2] == approx(covariance, rel=0.15)
    assert spread[2, 2] == approx(20**2 / 12, rel=0.1) and abs(spread[0, 2]) < 0.3
    exact = np.log(2 * np.pi) + 0.5 * np.log(np.linalg.det(covariance)) + np.log(20.0)
    assert found.log_evidence == approx(exact, abs=4 * found.log_evidence_se)


class Plateau(Known):
    """A peak of x0 at 5, SD 0.2, on a plateau e^-2.88 as high; x1 is normal with SD 0.05 about 4 sin x0."""

    def __init__(self):
        super().__init__(
            lambda x: np.array([-0.5 * self.jacobian(one)[0] @ self.jacobian(one)[0] for one in x])
        )

    def near(self, theta):
        return self

    def jacobian(self, theta):
        u, v = theta
        hill = np.exp(-2 * (u - 5) ** 2)
        residuals = np.array([2.4 * (1 - hill), (v - 4 * np.sin(u)) / 0.05])
        return residuals, np.array([[9.6 * hill * (u - 5), 0.0], [-80 * np.cos(u), 20.0]])


def test_a_plateau_at_the_end_of_a_winding_valley_is_found_along_the_profile():
    """By quadrature 0.2994 of it lies at x0 < 2."""
    mode = minimize_squares(Plateau(), np.array([5.0, 4 * np.sin(5.0)]))
    alone, found = (
        sample_about_modes(Plateau(), [mode], default_rng(1), efforts=(effort,))
        for effort in (Effort(profiles=False), Effort(draws=1000, min_ess=250.0))
    )
    assert not alone.certified and found.certified
    assert np.exp(found.log_weights)[found.thetas[:, 0] < 2].sum() == approx(0.2994, abs=0.05)


@pytest.mark.filterwarnings(r"ignore:\sArviZ is:FutureWarning")  # once a day
@pytest.mark.parametrize(("shape", "size"), [(-0.3, 1500), (0.2, 100), (0.9, 1500), (1.5, 20_000)])
def test_smoothed_weights_are_arviz_s(shape, size):
    log_weights = np.log(genpareto.rvs(shape, size=size, random_state=5))
    ours, k = smooth_weights(log_weights)
    import arviz  # takes seconds, and every process of a parallel run imports this file

    theirs, their_k = arviz.psislw(log_weights.copy())
    assert k == approx(float(their_k), abs=1e-10)
    assert ours == approx(np.asarray(theirs), abs=1e-10)


def test_resampled_draws_stand_once_and_by_their_weight():
    rng = default_rng(7)
    known = WeightedDraws(np.zeros((400, 1)), np.zeros(400), np.log(np.full(400, 1 / 400)), 0.0, 1.0, 0.0)
    assert len(set(resample(known, 79, rng).tolist())) == 79
    few = np.log(np.array([0.8, 0.2]))
    drawn = resample(WeightedDraws(np.zeros((2, 1)), np.zeros(2), few, 0.0, 1.0, 0.0), 4000, rng)
    assert np.mean(drawn == 0) == approx(0.8, abs=0.03)
