"""The running estimate of a tracked needle: derivatives, the posterior on a grid, recursion, priors."""

from dataclasses import replace

import numpy as np
import pytest

from needlefit.inference.compared_points import extrapolate_tip
from needlefit.inference.tracking import (
    TipNoise,
    TrackedNeedle,
    TrackingEstimate,
    _linearize,
    discount_estimate,
    estimate_parameters,
    make_prior_from_draws,
    make_prior_from_factors,
    set_parameters,
)
from needlefit.mechanics.control import Bevel, Controls, Guide, ModelOptions, Step
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.plan import Lattice
from needlefit.mechanics.simulate import simulate_steps
from needlefit.mechanics.tissue import Tissue

NOISE = TipNoise(0.1, 0.1, 0.05, 0.001)
OPTIONS = ModelOptions()


def tracked(depth: float = 60.0, layers: int = 1, options: ModelOptions = OPTIONS) -> TrackedNeedle:
    mu = np.array([0.05, 2.0, 0.1])[:layers]
    tissue = Tissue(mu, np.ones(layers), np.array([20.0, 30.0])[: layers - 1])
    angle = 0.05 if options.path_angle else 0.0
    bevel = Bevel(0.0 if angle else 0.08, 1, angle)
    guided = Controls(base_y=0.3, guides=(Guide(-20.0, 0.1),))
    steps = (Step(depth / 3, bevel, guided), Step(depth, replace(bevel, side=-1), guided))
    return TrackedNeedle(Needle(150.0, 10_000.0), tissue, steps, options, 1.0)


def read_tips(needle: TrackedNeedle, theta, depths) -> np.ndarray:
    changed = set_parameters(needle, theta)
    lattice = Lattice(changed.first_cell, changed.rules.spacing)
    shape = simulate_steps(changed.needle, changed.tissue, changed.steps, changed.rules, lattice)
    return extrapolate_tip(shape.constraints[:, 0], shape.tip_track[:, 0], depths)


def make_readings(needle, theta, seed, noise=NOISE) -> np.ndarray:
    rng, depths = np.random.default_rng(seed), np.arange(1.0, needle.steps[-1].depth + 1)
    off = noise.across * rng.standard_normal(len(depths)) + noise.shift * rng.standard_normal()
    return np.column_stack([depths, read_tips(needle, theta, depths) + off])


@pytest.mark.parametrize("options", [OPTIONS, ModelOptions(advance="path_angle")])
def test_derivatives_are_those_of_differences(options) -> None:
    needle = tracked(layers=3, options=options)
    state = np.append(np.log([0.06, 1.7, 0.09, 0.05]), [0.2, 0.003])
    depths = np.array([3.0, 19.5, 40.0, 59.7])
    found = _linearize(needle, state, depths)
    for n in range(len(state)):
        ends = [_linearize(needle, state + sign * 1e-4 * np.eye(6)[n], depths).tip for sign in (1, -1)]
        assert found.by_state[:, n] == pytest.approx((ends[0] - ends[1]) / 2e-4, abs=2e-6)
    assert found.by_state[:, 4:] == pytest.approx(np.column_stack([np.ones(4), depths]))


def test_the_estimate_is_the_posterior_on_a_grid() -> None:
    needle = tracked()
    prior = make_prior_from_factors(needle.tissue.mu, 0.08, (1.6, 1.3), NOISE)
    truth = prior.theta + np.array([0.3, 0.2])
    readings = make_readings(needle, truth, 1)
    found = estimate_parameters(needle, readings, prior, NOISE)
    slope = _linearize(needle, found.mean, readings[:, 0]).by_depth
    covariance = np.diag(NOISE.across**2 + (slope * NOISE.along) ** 2) + NOISE.shift**2
    covariance += NOISE.slope**2 * np.outer(readings[:, 0], readings[:, 0])
    inverse, apart = np.linalg.inv(covariance), np.linspace(-4.5, 4.5, 31)
    axes = np.linalg.cholesky(found.covariance[:2, :2])
    grid = found.theta + np.array([axes @ [x, y] for x in apart for y in apart])
    off = readings[:, 1] - np.array([read_tips(needle, one, readings[:, 0]) for one in grid])
    away = (grid - prior.theta) / prior.sd
    logs = -0.5 * (np.einsum("gi,ij,gj->g", off, inverse, off) + np.sum(away**2, axis=1))
    weights = np.exp(logs - logs.max()) / np.exp(logs - logs.max()).sum()
    mean = weights @ grid
    sd = np.sqrt(weights @ (grid - mean) ** 2)
    assert found.theta == pytest.approx(mean, abs=0.25 * sd.max())
    assert found.sd == pytest.approx(sd, rel=0.15)
    assert np.all(np.abs(found.theta - truth) < 3 * found.sd)
    assert found.readings == len(readings) == 60


def test_readings_narrow_the_estimate_and_predict_the_tip_ahead() -> None:
    """For truths drawn from the prior: the errors are as large as the standard deviations."""
    rng, needle = np.random.default_rng(5), tracked(layers=3)
    prior = make_prior_from_factors(needle.tissue.mu, 0.08, (1.8, 1.5), NOISE)
    ahead, scores, errors = tracked(80.0, layers=3), [], []
    ahead = ahead._replace(steps=(needle.steps[0], ahead.steps[1]))
    for _ in range(12):
        truth = np.log(prior.transform(rng.standard_normal((1, 4))))[0]
        found = estimate_parameters(needle, make_readings(needle, truth, rng.integers(99)), prior, NOISE)
        scores.append((found.theta - truth) / found.sd)
        tips = [read_tips(ahead, one, np.array([80.0]))[0] for one in (truth, prior.theta, found.theta)]
        errors.append(np.subtract(tips[1:], tips[0]))
    assert 0.6 < np.sqrt(np.mean(np.square(scores))) < 1.4
    without, updated = np.sqrt(np.mean(np.square(errors), axis=0))
    assert updated < 0.3 * without


def test_an_estimate_can_be_the_prior_of_further_readings() -> None:
    needle = tracked(40.0)
    prior = make_prior_from_factors(needle.tissue.mu, 0.08, (1.3, 1.2), NOISE)
    readings = make_readings(needle, prior.theta + np.array([0.1, -0.1]), 2)
    whole = estimate_parameters(needle, readings, prior, NOISE)
    first = estimate_parameters(needle, readings[:25], prior, NOISE)
    second = estimate_parameters(needle, readings[25:], first, NOISE)
    assert second.readings == whole.readings == 40
    assert second.theta == pytest.approx(whole.theta, abs=0.1 * whole.sd.max())
    assert second.sd == pytest.approx(whole.sd, rel=0.05)
    half = discount_estimate(whole, prior)
    assert np.all((whole.sd < half.sd) & (half.sd < prior.sd)) and half.mean is whole.mean
    assert discount_estimate(prior, prior).covariance == pytest.approx(prior.covariance)
    again = estimate_parameters(needle, readings, prior, NOISE, start=whole)
    assert again.theta == pytest.approx(whole.theta, abs=1e-3 * whole.sd.max())


def test_priors_from_draws_and_from_factors() -> None:
    rng = np.random.default_rng(0)
    logs = rng.multivariate_normal([0.0, -3.0], [[0.2, -0.1], [-0.1, 0.1]], 4000)
    tied = np.exp(np.column_stack([logs[:, 0], logs[:, 0]]))
    prior = make_prior_from_draws(tied, np.exp(logs[:, 1]), NOISE)
    assert prior.theta == pytest.approx([0.0, 0.0, -3.0], abs=0.03)
    assert prior.covariance[0, 2] == pytest.approx(-0.1, abs=0.01)
    assert prior.covariance[3, 3] == NOISE.shift**2 and np.linalg.eigvalsh(prior.covariance)[0] > 0
    drawn = np.log(prior.transform(rng.standard_normal((4000, 3))))
    assert np.cov(drawn.T) == pytest.approx(prior.covariance[:3, :3], abs=0.02)
    factors = make_prior_from_factors(np.array([0.1, 3.0]), 0.05, (2.0, 1.5), NOISE)
    low, median, high = factors.interval()
    assert median == pytest.approx([0.1, 3.0, 0.05])
    assert np.log(high / median) / 1.96 == pytest.approx(np.log([2.0, 2.0, 1.5]), rel=1e-4)
    assert isinstance(factors, TrackingEstimate) and np.all(low < median)


def test_no_estimate_where_no_needle_is_found() -> None:
    needle = tracked(options=replace(OPTIONS, max_iterations=1))
    prior = make_prior_from_factors(needle.tissue.mu, 0.08, (1.1, 1.1), NOISE)
    assert estimate_parameters(needle, np.array([[10.0, 0.1]]), prior, NOISE) is None
