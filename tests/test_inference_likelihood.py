import math
from dataclasses import replace

import numpy as np
import pytest
from inference_cases import TRUTH, dataset, insertion, measure, medium, problem
from scipy.stats import multivariate_normal, norm

from needlefit.datasets.insertion import Noise
from needlefit.datasets.noise import displace_by_pose
from needlefit.errors import DataError
from needlefit.inference.likelihood.observation import (
    make_observation,
    points_covariance,
    pose_modes,
    pose_sds,
    whiten,
    whiten_residuals,
)
from needlefit.schemas.recipe import LikelihoodRecord

STRAIGHT = np.column_stack([np.linspace(0, 40, 41), np.zeros(41)])


def straight(angle_sd=0.0, depth=40.0):
    return replace(insertion(depth, angle_sd=angle_sd), planar=STRAIGHT)


def along(shift=(0.0, 0.0), angle=0.0, bump=0.0):
    """The straight needle, shifted, turned about the entry, and with one point displaced."""

    def curve(s):
        x, y = s * math.cos(angle) + shift[0], s * math.sin(angle) + shift[1]
        y[len(y) // 2] += bump
        return np.column_stack([x, y])

    return curve


def log_likelihood(known, curve):
    white = whiten_residuals(known, curve(known.nodes.s[0]))
    return known.log_norm - 0.5 * white @ white


def test_independent_noise_gives_the_textbook_density():
    known = make_observation(dataset([], Noise(point_sd=0.2)), straight())
    got = log_likelihood(known, along(shift=(0.0, 0.1)))
    n = 41
    expected = -0.5 * 41 * (0.1 / 0.2) ** 2 - n * math.log(0.2) - 0.5 * n * math.log(2 * math.pi)
    assert got == pytest.approx(expected, rel=1e-12)


def test_the_density_is_that_of_the_stated_covariance():
    noise, measured = Noise(0.19, 0.05, 0.1, 5.0), straight(angle_sd=0.01)
    known = make_observation(dataset([], noise), measured)
    spread = pose_modes(STRAIGHT) * pose_sds(measured, noise)
    cov = points_covariance(STRAIGHT[:, 0], noise) + spread @ spread.T
    curve = along(shift=(0.02, -0.1), angle=0.003, bump=0.07)
    residual = curve(STRAIGHT[:, 0])[:, 1]
    assert log_likelihood(known, curve) == pytest.approx(multivariate_normal(cov=cov).logpdf(residual))
    assert np.linalg.inv(known.whitening) @ whiten_residuals(known, curve(STRAIGHT[:, 0])) == pytest.approx(
        residual
    )


def test_the_covariance_of_two_points_by_hand():
    noise = Noise(point_sd=0.3, correlated_sd=0.4, correlation_length=10.0)
    cov = points_covariance(np.array([0.0, 10.0]), noise)
    shared = 0.16 * math.exp(-1)
    assert cov == pytest.approx(np.array([[0.25, shared], [shared, 0.25]]))
    own = points_covariance(np.array([0.0, 10.0]), noise, np.array([0.1, 0.5]))
    assert own == pytest.approx(np.array([[0.1, 0.05 / math.e], [0.05 / math.e, 0.34]]))


def test_smooth_errors_are_correlated_by_materns_function():
    noise = Noise(correlated_sd=0.2, correlation_length=10.0, correlation="matern32")
    cov = points_covariance(np.array([0.0, 1.0, 10.0]), noise)
    z = math.sqrt(3)
    assert cov[0, 2] == pytest.approx(0.04 * (1 + z) * math.exp(-z))
    assert 1 - cov[0, 1] / 0.04 == pytest.approx(0.5 * (z / 10) ** 2, rel=0.15)  # smooth: no first order


def test_the_deviations_of_points_replace_the_datasets():
    noise, sd = Noise(point_sd=0.01, correlated_sd=0.3), np.linspace(0.1, 0.2, 41)
    known = make_observation(dataset([], noise), replace(straight(), sd=sd))
    inverse = np.linalg.inv(points_covariance(STRAIGHT[:, 0], noise, sd))
    assert known.whitening.T @ known.whitening == pytest.approx(inverse)


def test_a_pose_moves_a_parabola_by_its_modes():
    x = np.linspace(0.0, 40.0, 81)
    parabola = np.column_stack([x, 1e-3 * x**2])
    across, turn, along_axis = pose_modes(parabola).T
    assert across == pytest.approx(1.0) and turn == pytest.approx(x)
    assert along_axis == pytest.approx(-2e-3 * x, abs=1e-9)  # y(x - d) = y(x) - d y'(x)


def test_a_pose_turns_about_the_entry_where_the_curve_begins_4_mm_in():
    """0.01 rad about the entry moves a point by 0.01 of its depth: 0.04 mm at 4 mm, 0.4 mm at 40 mm."""
    begun = STRAIGHT[4:]
    assert pose_modes(begun)[[0, -1], 1] == pytest.approx([4.0, 40.0], abs=1e-12)
    known = make_observation(
        dataset([], Noise(point_sd=0.1)), replace(straight(angle_sd=0.01, depth=36.0), planar=begun)
    )
    cov = np.linalg.inv(known.whitening.T @ known.whitening)
    assert cov[0, 0] == pytest.approx(0.1**2 + 0.04**2)
    assert cov[-1, -1] == pytest.approx(0.1**2 + 0.4**2)
    assert cov[0, -1] == pytest.approx(0.04 * 0.4)


def test_the_noise_floor_and_the_likelihood_turn_a_pose_alike():
    begun = STRAIGHT[4:]
    normal = np.array([[0.0, 0.0, 1.0]])
    moved = displace_by_pose(begun, np.zeros(2), 0.01, normal)[0, :, 1]
    assert moved == pytest.approx(0.01 * pose_modes(begun)[:, 1], abs=1e-12)


def test_pose_deviations_are_the_larger_of_two_statements():
    noise = Noise(registration_mean=0.2 * math.sqrt(8 / math.pi))
    assert pose_sds(straight(angle_sd=0.01), noise) == pytest.approx([0.2, 0.01, 0.2])
    assert pose_sds(replace(straight(), pose_shift_sd=0.5), noise) == pytest.approx([0.5, 0.0, 0.5])


def test_a_very_wide_pose_prior_tends_to_the_projected_pose_up_to_its_constant():
    """N(r; 0, C + M S^2 M^T) (2 pi)^(f / 2) det S tends to the density of what M leaves of r."""
    rng, s = np.random.default_rng(7), STRAIGHT[:, 0]
    cov = points_covariance(s, Noise(point_sd=0.05, correlated_sd=0.1))
    free = pose_modes(np.column_stack([s, 1e-3 * s**2]))[:, :2]
    whitening, log_norm = whiten(cov, free)
    assert whitening.shape == (39, 41)
    for residual in rng.normal(0, 0.2, (3, 41)):
        white = whitening @ residual
        wide = np.diag([100.0, 3.0])  # mm, rad
        proper = multivariate_normal(cov=cov + free @ wide**2 @ free.T).logpdf(residual)
        constant = math.log(2 * math.pi) + math.log(100.0 * 3.0)
        assert log_norm - 0.5 * white @ white == pytest.approx(proper + constant, abs=1e-4)
        moved = whitening @ (residual + free @ [5.0, -0.1])
        assert moved == pytest.approx(white, abs=1e-9)


def test_the_projected_density_is_the_integral_over_all_poses():
    """By hand: two points that share a shift of any size leave their difference, of deviation sd sqrt 2.

    The integral over d of N(r1 - d) N(r2 - d) is N(r1 - r2; 0, 2 sd^2).
    """
    whitening, log_norm = whiten(0.3**2 * np.eye(2), np.ones((2, 1)))
    for residual in ([0.1, 0.5], [2.0, 2.4]):
        white = whitening @ residual
        assert log_norm - 0.5 * white @ white == pytest.approx(norm(scale=0.3 * math.sqrt(2)).logpdf(0.4))


def test_independent_noise_keeps_each_points_whole_deviation():
    noise, measured = Noise(0.19, 0.05, 0.1, 5.0), straight(angle_sd=0.01)
    known = make_observation(dataset([], noise), measured, likelihood=LikelihoodRecord(noise="independent"))
    shift = 0.19 / math.sqrt(8 / math.pi)
    sd = np.sqrt(0.05**2 + 0.1**2 + shift**2 + (0.01 * STRAIGHT[:, 0]) ** 2)
    assert known.whitening == pytest.approx(np.diag(1 / sd))


def test_a_wrong_pose_within_its_prior_costs_little_and_a_wrong_shape_much():
    noise = Noise(registration_mean=0.2 * math.sqrt(8 / math.pi), point_sd=0.05)  # 0.2 mm per axis
    known = make_observation(dataset([], noise), straight(angle_sd=0.01))
    best = log_likelihood(known, along())
    assert best - log_likelihood(known, along(shift=(0.0, 0.2))) == pytest.approx(0.5, rel=0.1)
    assert best - log_likelihood(known, along(angle=0.01)) == pytest.approx(0.5, rel=0.1)
    assert best - log_likelihood(known, along(bump=0.25)) > 10
    without = make_observation(dataset([], Noise(point_sd=0.05)), straight())
    assert log_likelihood(without, along()) - log_likelihood(without, along(shift=(0.0, 0.2))) > 300


def test_correlated_noise_forgives_a_long_wave_more_than_a_jump():
    known = make_observation(
        dataset([], Noise(point_sd=0.02, correlated_sd=0.2, correlation_length=20.0)), straight()
    )
    smooth = log_likelihood(known, lambda s: np.column_stack([s, 0.2 * np.sin(s / 10)]))
    jumping = log_likelihood(known, lambda s: np.column_stack([s, 0.2 * (-1.0) ** np.arange(len(s))]))
    assert smooth - jumping > 100


def test_a_free_pose_costs_nothing():
    record = medium(1)
    made = measure(TRUTH, record, insertion(50.0), 201)
    turned = replace(made, planar=made.planar @ np.array([[0.6, 0.8], [-0.8, 0.6]]) + [30.0, 7.0])
    p, q = (problem(record, [i], pose="free", drop=5.0) for i in (made, turned))
    theta = p.parameters.theta(TRUTH)
    assert p.log_posterior(theta) == pytest.approx(q.log_posterior(theta), abs=1e-3)


def test_a_centreline_of_many_points_is_thinned_and_keeps_its_tip():
    dense = measure(TRUTH, medium(1), insertion(50.0), 2001)
    known = make_observation(dataset([], Noise(point_sd=0.1)), dense)
    assert 100 < len(known.measured) <= 200
    assert known.measured[-1] == pytest.approx(dense.planar[-1]) and known.nodes.s[0, -1] == pytest.approx(
        50.0
    )


def test_missing_noise_is_an_error_that_names_the_key():
    with pytest.raises(DataError, match="point_sd_mm"):
        make_observation(dataset([], Noise()), straight())


def test_the_whitened_residuals_of_noisy_data_have_unit_variance():
    rng, noise, record = np.random.default_rng(3), Noise(0.19, 0.05, 0.1, 5.0), medium(1)
    shift_sd = 0.19 / math.sqrt(8 / math.pi)

    def noisy(xy):
        s = np.linspace(0, 50, len(xy))
        root = np.linalg.cholesky(np.exp(-np.abs(s[:, None] - s) / 5.0))
        moved = xy + 0.05 * rng.normal(size=xy.shape) + 0.1 * root @ rng.normal(size=xy.shape)
        turn = 0.004 * rng.normal()
        return moved + shift_sd * rng.normal(size=2) + turn * np.column_stack([-xy[:, 1], xy[:, 0]])

    made = [measure(TRUTH, record, insertion(50.0), 101, noisy) for _ in range(12)]
    p = problem(record, made, noise=noise)
    white = p.residuals(p.parameters.theta(TRUTH)).reshape(12, -1)
    assert np.mean(white**2) == pytest.approx(1.0, abs=0.15)


def test_outside_the_bounds_the_posterior_is_zero():
    record = medium(1)
    p = problem(record, [measure(TRUTH, record, insertion(50.0))])
    theta = p.parameters.theta(TRUTH)
    assert math.isfinite(p.log_posterior(theta))
    assert p.log_posterior(p.upper + 1e-9) == -math.inf
    assert p.log_posterior(np.array([theta[0], np.nan])) == -math.inf


def test_many_thetas_at_once_have_the_densities_that_each_has_alone():
    """Also outside the bounds."""
    record = medium(1)
    p = problem(record, [measure(TRUTH, record, one) for one in (insertion(12.4), insertion(17.0))])
    thetas = p.lower + (p.upper - p.lower) * np.random.default_rng(3).uniform(size=(40, len(p.names)))
    thetas[3] = p.upper + 1.0
    alone = np.array([p.log_posterior(theta) for theta in thetas])
    together = p.log_posteriors(thetas, jobs=2)
    assert together[3] == -math.inf and np.sum(np.isfinite(alone)) > 20
    np.testing.assert_allclose(together, alone, rtol=1e-5)
