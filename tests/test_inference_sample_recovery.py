"""Posteriors known in closed form come back within Monte Carlo error; another sampler agrees."""

import dynesty
import numpy as np
import pytest
from inference_cases import TRUTH, insertion, measure, medium, problem
from sampling_cases import Known, draw, flat, gaussian, settings, standard_errors, two_hills
from scipy.stats import truncnorm

from needlefit.inference.sampling.posterior import autocorrelation_times
from needlefit.inference.sampling.sample import fit_proposal, make_initial_proposal, sample
from needlefit.schemas.recipe import SampleRecord

pytestmark = pytest.mark.sweep

MOVES = ["stretch", "de", "independent", SampleRecord().moves]


@pytest.mark.parametrize("moves", MOVES)
def test_a_gaussian_of_five_dimensions_by_every_move(moves):
    got = draw(Known(gaussian(np.eye(5)), 5), moves=moves, steps=2000)
    assert flat(got).mean(axis=0) == pytest.approx(np.zeros(5), abs=4 * standard_errors(got).max())
    squares = np.sqrt(2 / got.convergence.ess_bulk.sum(axis=0)[:5])
    assert np.all(np.abs(flat(got).var(axis=0) - 1) < 5 * squares)


@pytest.mark.parametrize("moves", ["independent", SampleRecord().moves])
def test_a_gaussian_that_bounds_cut(moves):
    """Its peak lies in a corner outside; of each coordinate a tail that falls from the bound is left."""
    got = draw(Known(gaussian(np.eye(3), 1.5), 3, half=1.0), moves=moves, steps=600, check_interval=300)
    x, tail = flat(got), truncnorm(-2.5, -0.5, loc=1.5)
    assert x.mean(axis=0) == pytest.approx(np.full(3, tail.mean()), abs=4 * standard_errors(got).max())
    assert x.var(axis=0) == pytest.approx(np.full(3, tail.var()), rel=0.1)
    levels = np.quantile(x, [0.05, 0.5, 0.95], axis=0).T
    assert levels == pytest.approx(np.tile(tail.ppf([0.05, 0.5, 0.95]), (3, 1)), abs=0.03)


def test_independent_proposals_follow_their_density():
    """Weighed by a known density over theirs, they have its moments."""
    random, seen = np.random.RandomState(1), np.random.default_rng(1).exponential(size=(60, 2))
    for picture in (fit_proposal(seen), make_initial_proposal(2)):
        points = picture.draw(20000, random)
        weights = np.exp(gaussian(0.5 * np.eye(2), 1.0)(points) - picture.log_density(points))
        mean = weights @ points / weights.sum()
        assert mean == pytest.approx(np.ones(2), abs=0.03)
        assert weights @ (points - mean) ** 2 / weights.sum() == pytest.approx(np.full(2, 0.5), rel=0.05)


def test_modes_without_exchange_are_reported():
    got = draw(Known(two_hills), ends=[[5.0, 0.0], [-5.0, 0.0]], steps=1000)
    assert not got.converged
    assert got.convergence.r_hat[0] > 1.5
    assert any(fault.startswith("R-hat of") for fault in got.faults)
    assert set(np.sign(got.draws[:, :, 0].mean(axis=1))) == {-1.0, 1.0}
    # Each walker alone looks independent: about the mean of all of them it is not.
    rng = np.random.default_rng(2)
    parted = rng.normal(size=(1, 500, 16)) + np.where(np.arange(16) < 8, -20.0, 20.0)
    assert autocorrelation_times(parted)[0] > 100


def test_another_sampler_finds_the_same_posterior_of_a_needle():
    """Nested sampling shares neither moves nor convergence with ours."""
    record = medium(1, mu1_pa={"bounds": [1e4, 1e7]}, bevel_mm={"bounds": [0.02, 0.3]})
    made = [measure(TRUTH, record, insertion(depth)) for depth in (14.0, 18.0)]
    needle = problem(record, made)
    ours = sample(needle, needle.parameters.theta(TRUTH), settings(), np.random.default_rng(3))
    assert ours.converged
    width = needle.upper - needle.lower
    nested = dynesty.NestedSampler(
        needle.log_posterior,
        lambda cube: needle.lower + cube * width,
        2,
        nlive=150,
        rstate=np.random.default_rng(5),
    )
    nested.run_nested(print_progress=False, dlogz=0.1)
    theirs = nested.results.samples_equal(rstate=np.random.default_rng(6))
    mine = np.log(flat(ours))
    assert mine.mean(axis=0) == pytest.approx(theirs.mean(axis=0), abs=0.15 * mine.std(axis=0).max())
    assert mine.std(axis=0) == pytest.approx(theirs.std(axis=0), rel=0.15)
    for q in (0.05, 0.95):
        spread = mine.std(axis=0)
        apart = np.abs(np.quantile(mine, q, axis=0) - np.quantile(theirs, q, axis=0))
        assert np.all(apart < 0.25 * spread)
