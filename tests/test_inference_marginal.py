"""Uncertain depths: closed forms, and brute force."""

import math
from dataclasses import replace

import numpy as np
import pytest
from inference_cases import TRUTH, insertion, measure, medium, problem
from scipy.stats import multivariate_normal, norm

from needlefit.datasets.insertion import Noise
from needlefit.inference.identifiability.information import difference_jacobian
from needlefit.inference.likelihood.depths import NODE_POSITIONS_SD, Nodes, log_means, make_nodes, make_rule
from needlefit.inference.likelihood.marginal import (
    linear_residual_derivatives,
    linear_residuals,
    log_marginals,
    mixing_matrix,
)
from needlefit.schemas.recipe import LikelihoodRecord

LINE = np.linspace(0.0, 40.0, 41)
LAYERED = replace(insertion(40.0, (12.0, 20.0), (1, 2, 1)), boundary_sd=0.15, depth_sd=0.1)


def white_of(curve, depths, axes=3):
    """Residuals (m, R) at the nodes of a function of t (d,)."""
    points = [np.zeros(axes), *(x * np.eye(axes)[j] for j in range(axes) for x in NODE_POSITIONS_SD[depths])]
    return np.array([curve(t) for t in points])


def one(white, made, scale=1.0):
    return log_marginals(white[None], made, np.array([scale]))[0]


@pytest.mark.parametrize("depths", ["linear", "quadrature"])
@pytest.mark.parametrize("scale", [1.0, 1.7])
def test_a_linear_dependence_gives_the_gaussian_of_the_summed_covariances(depths, scale):
    rng = np.random.default_rng(1)
    first, slopes = rng.normal(size=8), 0.4 * rng.normal(size=(8, 3))
    made = make_nodes(LAYERED, LINE, depths)
    got = one(white_of(lambda t: first + slopes @ t, depths), made, scale)
    exact = multivariate_normal(cov=scale**2 * np.eye(8) + slopes @ slopes.T).logpdf(first)
    assert got - 4 * math.log(2 * math.pi) == pytest.approx(exact, abs=1e-9 if depths == "linear" else 2e-3)


def test_quadrature_follows_what_is_not_linear():
    """One residual that saturates, against the integral by a fine sum; the spline errs by 0.02."""
    made = make_nodes(replace(LAYERED, depth_sd=0.0, boundaries=np.array([12.0])), LINE, "quadrature")
    got = one(white_of(lambda t: np.array([np.tanh(1.5 * t[0]) - 0.5]), "quadrature", 1), made)
    t = np.linspace(-8, 8, 4001)
    exact = np.log(np.sum(norm.pdf(t) * np.exp(-0.5 * (np.tanh(1.5 * t) - 0.5) ** 2)) * (t[1] - t[0]))
    assert got == pytest.approx(exact, abs=0.03)


def test_nothing_uncertain_is_the_density_as_measured():
    certain = replace(LAYERED, boundary_sd=0.0, depth_sd=0.0)
    for made in (make_nodes(certain, LINE, "quadrature"), make_nodes(LAYERED, LINE, "fixed")):
        assert made.axes == 0 and len(made.insertions) == 1
        white = np.arange(5.0)[None]
        assert one(white, made, 2.0) == pytest.approx(-0.5 * 30 / 4 - 5 * math.log(2))
        assert linear_residuals(white, made, 2.0)[0] == pytest.approx(white[0] / 2)


def test_nodes_move_one_boundary_or_the_entry():
    made = make_nodes(LAYERED, LINE, "linear")
    moved = [(i.boundaries.tolist(), i.depth) for i in made.insertions]
    assert moved == [
        ([12.0, 20.0], 40.0),
        (pytest.approx([11.9, 19.9]), pytest.approx(39.9)),
        (pytest.approx([12.1, 20.1]), pytest.approx(40.1)),
        (pytest.approx([11.85, 20.0]), 40.0),
        (pytest.approx([12.15, 20.0]), 40.0),
        (pytest.approx([12.0, 19.85]), 40.0),
        (pytest.approx([12.0, 20.15]), 40.0),
    ]
    assert made.s[2] == pytest.approx(LINE + 0.1) and made.s[3] == pytest.approx(LINE)


def test_thin_layers_stay_in_order():
    thin = replace(LAYERED, boundaries=np.array([0.1, 0.2]), boundary_sd=0.5)
    for moved in make_nodes(thin, LINE, "quadrature").insertions:
        assert moved.boundaries[0] > 0 and np.all(np.diff(moved.boundaries) > 0)


@pytest.mark.parametrize("size", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("axes", [1, 2, 4])
def test_what_acts_linearly_is_integrated_exactly(axes, size):
    """`size` is the whitened length of what one standard deviation does."""
    rng = np.random.default_rng(axes)
    slopes = rng.normal(size=(20, axes))
    slopes *= size / np.linalg.norm(slopes, axis=0)
    first = slopes @ rng.normal(size=axes) + rng.normal(size=20)
    white = white_of(lambda t: first + slopes @ t, "quadrature", axes)
    got = log_means((white @ white.T)[None], make_rule(axes))[0]
    stiff = np.eye(20) + slopes @ slopes.T
    exact = -0.5 * first @ np.linalg.solve(stiff, first) - 0.5 * np.linalg.slogdet(stiff)[1]
    assert got == pytest.approx(exact, abs=0.01)


@pytest.mark.parametrize("depths", ["linear", "quadrature"])
def test_the_mixing_is_the_densitys_derivative(depths):
    rng = np.random.default_rng(4)
    made = make_nodes(LAYERED, LINE, depths)
    white, step = rng.normal(size=(len(made.insertions), 6)), rng.normal(size=(len(made.insertions), 6))
    slope = (one(white + 1e-5 * step, made, 1.3) - one(white - 1e-5 * step, made, 1.3)) / 2e-5
    assert -np.sum(mixing_matrix(white, made, 1.3) @ white * step) == pytest.approx(slope, rel=1e-6)


def test_the_residuals_of_the_linear_density_and_their_slopes():
    rng = np.random.default_rng(5)
    made = make_nodes(LAYERED, LINE, "linear")
    white, by = rng.normal(size=(7, 6)), rng.normal(size=(7, 6, 2))

    def both(theta):
        return np.append(*linear_residuals(white + by @ theta, made, 1.3))

    found, log_det = linear_residuals(white, made, 1.3)
    shrunk = one(white, made, 1.3) + 6 * math.log(1.3)
    assert -0.5 * (found @ found + log_det) == pytest.approx(shrunk)
    exact = np.vstack(linear_residual_derivatives(white, by, made, 1.3))
    np.testing.assert_allclose(exact, difference_jacobian(both, np.zeros(2), np.full(2, 1e-5)), atol=1e-7)


def layered(depths, noise_scale=1.0, pose="known"):
    record = medium()
    made = [
        replace(
            measure(TRUTH, record, insertion(d, (9.2, 17.0), (1, 2, 1), side)), boundary_sd=0.15, depth_sd=0.1
        )
        for d, side in ((32.3, 1), (38.0, -1))
    ]
    how = LikelihoodRecord(depths=depths, noise_scale=noise_scale)
    return problem(record, made, how=how, pose=pose, noise=Noise(0.19, 0.02, 0.05, 5.0))


@pytest.mark.parametrize("noise_scale", [0.8, "estimated"])
@pytest.mark.parametrize("depths", ["fixed", "linear", "quadrature"])
def test_every_gradient_is_exact_and_many_thetas_give_what_each_gives_alone(depths, noise_scale):
    p = layered(depths, noise_scale)
    theta = p.parameters.theta({**TRUTH, "noise_scale": 1.2}) + 0.05
    value, gradient = p.gradient(theta)
    assert value == pytest.approx(p.log_posterior(theta), rel=1e-6)
    assert p.log_posteriors(theta[None])[0] == pytest.approx(value, rel=1e-6)
    for along in np.eye(len(theta)):
        ends = [p.log_posterior(theta + h * along) for h in (-2e-3, -1e-3, 1e-3, 2e-3)]
        slope = (8 * (ends[2] - ends[1]) - (ends[3] - ends[0])) / 12e-3
        assert gradient @ along == pytest.approx(slope, rel=1e-5, abs=1e-5 * np.linalg.norm(gradient))


@pytest.mark.parametrize("noise_scale", [0.8, "estimated"])
@pytest.mark.parametrize("depths", ["fixed", "linear"])
def test_the_density_is_a_constant_less_half_the_squared_residuals(depths, noise_scale):
    p = layered(depths, noise_scale, "free")
    theta = p.parameters.theta({**TRUTH, "noise_scale": 1.2})
    constants = [p.log_posterior(t) + 0.5 * np.sum(p.residuals(t) ** 2) for t in (theta, theta - 0.1)]
    assert constants[0] == pytest.approx(constants[1], rel=1e-10)
    found, exact = p.jacobian(theta)
    differences = difference_jacobian(p.residuals, theta, np.full(len(theta), 1e-3))
    assert found == pytest.approx(p.residuals(theta), abs=1e-3)
    assert np.linalg.norm(exact - differences) < 1e-4 * np.linalg.norm(exact)
    assert -(found @ exact) == pytest.approx(p.gradient(theta)[1], rel=1e-6)


def test_a_scale_of_the_noise_is_normalised():
    """Without misfit the density of n residuals falls as scale^-n, and is flat in nothing else."""
    low, high = (layered("fixed", scale) for scale in (0.5, 2.0))
    theta = low.parameters.theta(TRUTH)
    n = sum(known.rows for known in low.density.observations)
    fell = low.log_posterior(theta) - high.log_posterior(theta)
    assert fell == pytest.approx(n * math.log(4), rel=1e-3)


def test_a_failed_node_fails_the_density():
    made = Nodes((LAYERED, LAYERED, LAYERED), np.zeros((3, 1)), np.array([[1, 0, 0], [0, -0.5, 0.5]]), None)
    white = np.ones((3, 4))
    white[2] = np.nan
    assert math.isnan(one(white, made))


def test_many_sets_are_integrated_as_each_alone():
    rng = np.random.default_rng(6)
    many = rng.normal(size=(90, 1 + 4 * 4, 3))
    products = many @ many.transpose(0, 2, 1)
    alone = [log_means(one[None], make_rule(4))[0] for one in products]
    assert log_means(products, make_rule(4)).tolist() == alone
