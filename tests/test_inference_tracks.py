"""Fits to tip tracks: known truths found again, and what the tracker's frame may not change."""

from dataclasses import replace

import numpy as np
import pytest
from track_cases import DEPTH, GUIDE, MEDIUM, NEEDLE, NOISE, TRUTH, measured, problem, track

from needlefit.errors import ConfigError, DataError
from needlefit.inference.optimize import minimize
from needlefit.inference.tracks.prediction import (
    SlopeMoments,
    TrackDraws,
    estimate_slopes,
    fit_curve,
    predict_readings,
)
from needlefit.inference.tracks.problem import make_track_observation
from needlefit.inference.tracks.simulation import group_tracks, simulate_tips
from needlefit.mechanics.control import Bevel, Guide, ModelOptions
from needlefit.mechanics.session import Session
from needlefit.mechanics.tissue import Tissue
from needlefit.schemas.recipe import RecipeRecord

REST = np.zeros(len(DEPTH))
THETA = np.log([TRUTH["mu1_pa"], TRUTH["bevel_mm"], TRUTH["guide_distance_mm"]])


@pytest.fixture(scope="module")
def runs():
    moves = (GUIDE, -0.5 * GUIDE, REST)
    return [measured(track(f"run{n}", guide), 3.0 * n, 0.02 * n, n) for n, guide in enumerate(moves)]


@pytest.mark.parametrize("beyond", [0.0, 0.4, 0.9])
def test_a_track_is_where_a_stepwise_insertion_has_its_tip(beyond):
    """The session moves the needle the same way; asked on constraint points, and between them."""
    depth = DEPTH + beyond * (DEPTH > 0)
    (found,) = simulate_tips([TRUTH], MEDIUM, NEEDLE, [track("run", GUIDE, depth)])
    gel = Tissue(np.array([0.03]), np.array([1.0]), np.empty(0), np.array([40.0]))
    session = Session(NEEDLE, gel, Bevel(0.03), rules=ModelOptions())
    for n, more in enumerate(np.diff(depth), start=1):
        shape = session.step(insert=float(more), guides=(Guide(-20.0, float(GUIDE[n])),))
        assert found[0, n] == pytest.approx(shape.deflection, abs=0.002)


def test_runs_under_a_resting_guide_are_one_insertion():
    tracks = [track("a", REST), track("b", REST, 0.9 * DEPTH), track("c", GUIDE)]
    found = group_tracks(tracks, 1.0)
    assert [(one.depth, one.track_numbers) for one in found] == [(60.0, (0, 1)), (60.0, (2,))]
    together = simulate_tips([TRUTH], MEDIUM, NEEDLE, tracks)
    alone = [simulate_tips([TRUTH], MEDIUM, NEEDLE, [one])[0] for one in tracks]
    for one, other in zip(together, alone, strict=True):
        assert one == pytest.approx(other, abs=1e-9)


def test_readings_closer_than_constraint_points_are_refused():
    with pytest.raises(DataError, match=r"run run .* 0\.5 mm"):
        group_tracks([track("run", GUIDE, 0.1 * DEPTH)], 1.0)


def test_the_true_parameters_are_recovered(runs):
    recipe = RecipeRecord.model_validate({"schema": 1, "starts": 3, "algorithm": "leastsquares"})
    asked = problem(runs)
    fit = minimize(asked, recipe, np.random.default_rng(1))
    assert fit.failures == 0
    _, slope = asked.jacobian(np.array(fit.theta))
    sd = np.sqrt(np.diag(np.linalg.inv(slope.T @ slope)))
    assert np.all(np.abs(np.array(fit.theta) - THETA) < 3.5 * sd)
    assert np.all(sd < (0.15, 0.6, 0.15))  # a moved guide tells all three


def test_shift_and_slope_of_the_frame_change_nothing(runs):
    turned = [replace(one, tip=one.tip - 40.0 + 0.1 * one.depth) for one in runs]
    here, there = problem(runs), problem(turned)
    assert there.log_posterior(THETA) == pytest.approx(here.log_posterior(THETA), abs=1e-6)
    assert there.residuals(THETA) == pytest.approx(here.residuals(THETA), abs=1e-8)


def test_the_projection_is_the_limit_of_a_wide_prior(runs):
    known = make_track_observation(runs[0], NOISE)
    off = 0.1 * np.sin(DEPTH / 7)
    ours = known.log_norm - 0.5 * np.sum((known.whitening @ off) ** 2)
    wide = 30.0
    cov = known.covariance + wide**2 * known.frame @ known.frame.T
    log_det = np.linalg.slogdet(cov)[1]
    full = -0.5 * off @ np.linalg.solve(cov, off) - 0.5 * log_det - 0.5 * len(off) * np.log(2 * np.pi)
    assert full + 2 * np.log(wide) + np.log(2 * np.pi) == pytest.approx(ours, abs=1e-4)


def test_log_posterior_residuals_and_gradient_are_one_density(runs):
    asked, other = problem(runs), THETA + np.array([0.3, -0.2, 0.1])
    falls = [asked.log_posterior(at) + 0.5 * np.sum(asked.residuals(at) ** 2) for at in (THETA, other)]
    assert falls[0] == pytest.approx(falls[1], abs=1e-8)
    value, slope = asked.gradient(other)
    step = 1e-4 * np.eye(3)
    differences = [(asked.log_posterior(other + d) - asked.log_posterior(other - d)) / 2e-4 for d in step]
    assert value == asked.log_posterior(other)
    assert slope == pytest.approx(differences, rel=1e-3, abs=1e-2)
    assert asked.log_posteriors(np.array([THETA, other, other + 50.0]))[2] == -np.inf


def test_predictions_ahead_cover_their_nominal_fraction():
    """Shift free, slope as its prior says: 95 % intervals of the last reading hold in 95 % of runs."""
    rng, blank = np.random.default_rng(5), make_track_observation(track("run", REST), NOISE)
    slope, hits = SlopeMoments(np.full(200, 0.03), np.full(200, 0.01**2)), 0
    for _ in range(200):
        noise = NOISE.point_sd * rng.normal(size=len(DEPTH))
        tip = rng.normal(0, 20) + rng.normal(0.03, 0.01) * DEPTH + noise
        known = replace(blank, track=replace(blank.track, tip=tip))
        draws = predict_readings(known, np.zeros((200, len(DEPTH))), np.ones(200), slope, 5, rng)
        low, high = np.quantile(draws[:, -1], (0.025, 0.975))
        hits += low <= tip[-1] <= high
    assert 0.9 <= hits / 200 <= 0.985  # 0.95 +- 3 deviations


def test_later_readings_do_not_enter_the_prediction(runs):
    known = make_track_observation(runs[0], NOISE)
    later = runs[0].tip.copy()
    later[5:] += 9.0
    other = replace(known, track=replace(runs[0], tip=later))
    slope = SlopeMoments(np.zeros(8), np.ones(8))
    one, two = (
        predict_readings(at, np.zeros((8, len(DEPTH))), np.ones(8), slope, 5, np.random.default_rng(1))
        for at in (known, other)
    )
    assert np.array_equal(one, two)


def test_slopes_of_further_runs_are_predicted_from_the_fitted_ones():
    frames = (0.01, 0.02, 0.03, 0.04, 0.05)
    bent = [measured(track(f"run{n}", REST), n, one) for n, one in enumerate(frames)]
    seen = [make_track_observation(one, NOISE) for one in bent]
    (y,) = simulate_tips([TRUTH], MEDIUM, NEEDLE, bent[:1])
    drawn = TrackDraws((y,) * 5, (), np.ones(1))
    found = estimate_slopes(drawn, seen)
    assert found.mean[0] == pytest.approx(0.03)
    assert found.variance[0] == pytest.approx(0.00025 * 1.2 * 4 / 2)  # scatter, one more run, Student
    with pytest.raises(ConfigError, match="3 runs"):
        estimate_slopes(TrackDraws((y,) * 3, (), np.ones(1)), seen[:3])


def test_a_parabola_is_fitted_toward_the_bevel():
    bow = 4e-4 * DEPTH**2 / 2
    tracks = [replace(track(f"run{s}", REST, side=s), tip=s * bow + 0.01 * DEPTH) for s in (1, -1)]
    noisy = [
        replace(one, tip=one.tip + 0.02 * np.random.default_rng(n).normal(size=len(DEPTH)))
        for n, one in enumerate(tracks)
    ]
    seen = [make_track_observation(one, NOISE) for one in noisy]
    found = fit_curve("constant_curvature", seen, tracks, 500, np.random.default_rng(2))
    ends = found.held_out[0][:, -1], found.held_out[1][:, -1]
    assert np.median(ends[0]) == pytest.approx(bow[-1], abs=3 * np.std(ends[0]))
    assert np.std(ends[0]) < 0.05 and np.allclose(ends[0], -ends[1])
    assert np.median(found.scale) == pytest.approx(1.0, abs=0.35)
    assert not fit_curve("straight", seen, tracks, 5, np.random.default_rng(2)).held_out[0].any()


def test_a_medium_without_a_guide_is_refused():
    from needlefit.inference.parameters import Parameters
    from needlefit.inference.tracks.problem import TrackProblem

    table = {k: v for k, v in MEDIUM.model_dump()["parameters"].items() if k != "guide_distance_mm"}
    bare = MEDIUM.model_validate({"schema": 1, "layers": 1, "parameters": table})
    with pytest.raises(ConfigError, match="guide") as fault:
        TrackProblem(NEEDLE, (track("run", REST),), bare, Parameters.from_record(bare), NOISE)
    assert fault.value.key == "parameters" and "guide_distance_mm" in fault.value.expected
