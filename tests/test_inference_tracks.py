"""Fits to tip tracks: known truths found again, and what the tracker's frame may not change."""

from dataclasses import replace

import numpy as np
import pytest
from inference_cases import assert_one_density
from scipy.linalg import block_diag
from track_cases import (
    DEPTH,
    GUIDE,
    MEDIUM,
    NEEDLE,
    NOISE,
    TRUTH,
    dataset,
    measured,
    problem,
    simulate_tips,
    track,
    with_tip,
)

from needlefit.errors import ConfigError, DataError
from needlefit.inference.baselines import BASELINES
from needlefit.inference.baselines.guide_kernel import make_kernel_basis
from needlefit.inference.compared_points import find_end, share_simulations
from needlefit.inference.forward_model import simulate_deflections
from needlefit.inference.likelihood.observation import (
    HEADING_STEP_MM,
    SESSION_SD_RAD,
    Discrepancy,
    make_observation,
    whiten,
)
from needlefit.inference.optimize import minimize
from needlefit.inference.predict import Draws
from needlefit.inference.problem import Problem
from needlefit.inference.tracking import (
    SlopeMoments,
    TrackDraws,
    draw_baseline,
    estimate_slopes,
    predict_readings,
)
from needlefit.mechanics.control import Bevel, Guide, ModelOptions
from needlefit.mechanics.session import Session
from needlefit.mechanics.tissue import Tissue
from needlefit.schemas.recipe import RecipeRecord
from needlefit.studies.kinds import tracks
from needlefit.studies.kinds.tracks import TrackTask

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
    (found,) = simulate_tips([track("run", GUIDE, depth)])
    gel = Tissue(np.array([0.03]), np.array([1.0]), np.empty(0), np.array([40.0]))
    session = Session(NEEDLE, gel, Bevel(0.03), rules=ModelOptions())
    for n, more in enumerate(np.diff(depth), start=1):
        shape = session.step(insert=float(more), guides=(Guide(-20.0, float(GUIDE[n])),))
        assert found[0, n] == pytest.approx(shape.u[-1], abs=0.002)


def test_runs_under_a_resting_guide_are_one_insertion():
    tracks = [track("a", REST), track("b", REST, 0.9 * DEPTH), track("c", GUIDE)]
    sources = share_simulations(tracks, 1.0)
    assert [one.id for one in sources] == ["a", "a", "c"]
    assert find_end(track("d", REST, 0.997 * DEPTH), 1.0) == 60.0
    together = simulate_tips(tracks)
    alone = [simulate_tips([one])[0] for one in tracks]
    for one, other in zip(together, alone, strict=True):
        assert one == pytest.approx(other, abs=1e-9)
    with pytest.raises(DataError, match=r"run run .* 0\.5 mm"):
        share_simulations([track("run", GUIDE, 0.1 * DEPTH)], 1.0)
    table = {k: v for k, v in MEDIUM.model_dump()["parameters"].items() if k != "guide_distance_mm"}
    bare = MEDIUM.model_validate({"schema": 1, "layers": 1, "parameters": table})
    with pytest.raises(ConfigError, match="guide") as fault:
        problem([track("run", REST)], bare)
    assert fault.value.key == "parameters" and "guide_distance_mm" in fault.value.expected


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
    turned = [with_tip(one, one.tip - 40.0 + 0.1 * one.depths) for one in runs]
    here, there = problem(runs), problem(turned)
    assert there.log_posterior(THETA) == pytest.approx(here.log_posterior(THETA), abs=1e-6)
    assert there.residuals(THETA) == pytest.approx(here.residuals(THETA), abs=1e-8)
    here, there = problem(runs), problem([with_tip(one, one.tip + 5.0 - 0.1 * one.depths) for one in runs])
    at = THETA + 0.2
    value, slope = here.objective_gradient(at)
    assert there.objective(at) == pytest.approx(value, abs=1e-9) and here.objective(at) == value
    ends = [(here.objective(at + d) - here.objective(at - d)) / 2e-3 for d in 1e-3 * np.eye(3)]
    assert slope == pytest.approx(ends, rel=1e-4, abs=1e-5)
    # noise of 0.02 mm, from which each run's best shift and slope are taken
    assert all(0.005 < one.distances.mean() < 0.03 for one in here.compare(THETA))


def test_the_projection_is_the_limit_of_a_wide_prior(runs):
    known = make_observation(dataset(runs), runs[0])
    off = 0.1 * np.sin(DEPTH / 7)
    ours = known.log_norm - 0.5 * np.sum((known.whitening @ off) ** 2)
    wide = 30.0
    cov = known.covariance() + wide**2 * known.free @ known.free.T
    log_det = np.linalg.slogdet(cov)[1]
    full = -0.5 * off @ np.linalg.solve(cov, off) - 0.5 * log_det - 0.5 * len(off) * np.log(2 * np.pi)
    assert full + 2 * np.log(wide) + np.log(2 * np.pi) == pytest.approx(ours, abs=1e-4)


def in_session(runs):
    """The runs with headings, in frames of one slope."""
    ends = [np.gradient(one.tip, one.depths) - 0.03 for one in runs]
    return [replace(one, heading=np.arctan(end)) for one, end in zip(runs, ends, strict=True)]


SESSION_NOISE = replace(NOISE, heading_sd=0.01, slope_sd=0.005)


def test_a_session_is_one_gaussian_of_all_readings_and_headings(runs):
    """The marginal over what runs share is the density of all their readings together."""
    tracks = in_session(runs)
    asked = problem(tracks)
    asked = replace(asked, dataset=replace(asked.dataset, noise=SESSION_NOISE))
    n, off, cov, columns = len(DEPTH), [], [], []
    for one, tip in zip(tracks, simulate_tips(tracks), strict=True):
        before = simulate_deflections([TRUTH], MEDIUM, NEEDLE, [one], [DEPTH - HEADING_STEP_MM])[0]
        path = (tip[0] - before[0])[1:] / HEADING_STEP_MM
        off.append(np.append(tip[0] - one.tip, path - np.tan(one.heading[1:])))
        turn = np.append(DEPTH, np.ones(n - 1))
        columns.append([np.append(np.ones(n), np.zeros(n - 1)), turn, np.append(np.zeros(n), np.ones(n - 1))])
        own = np.diag(np.append(np.full(n, NOISE.point_sd**2), np.full(n - 1, 0.01**2)))
        cov.append(own + 0.005**2 * np.outer(turn, turn))
    whole = block_diag(*cov)
    for part in (1, 2):
        shared = SESSION_SD_RAD * np.concatenate([one[part] for one in columns])
        whole += np.outer(shared, shared)
    shifts, residual = block_diag(*[one[0][:, None] for one in columns]), np.concatenate(off)
    whitening, log_norm = whiten(whole, shifts)
    expected = log_norm - 0.5 * np.sum((whitening @ residual) ** 2)
    assert asked.log_posterior(THETA) == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("headings", [False, True])
def test_a_model_error_enters_the_covariance_of_tips_and_headings(runs, headings):
    (run,) = in_session(runs[:1]) if headings else runs[:1]
    known = replace(dataset([run]), noise=SESSION_NOISE if headings else NOISE)
    error = Discrepancy(5.0, 15.0)
    plain, wide = (make_observation(known, run, model_error=one) for one in (None, error))
    added = wide.point_covariance - plain.point_covariance
    count = len(DEPTH)
    assert added[:count, :count] == pytest.approx(error.covariance(DEPTH), rel=1e-9)
    # a heading is a derivative: the process' slope has deviation sd / length
    assert np.sqrt(np.diag(added)[count:]) == pytest.approx(np.full(len(added) - count, 5 / 15), rel=1e-3)
    assert len(added) == (2 * count - 1 if headings else count)
    assert wide.whitening.shape == plain.whitening.shape
    assert np.abs(wide.whitening - plain.whitening).max() > 1
    assert wide.log_norm < plain.log_norm - 5


@pytest.mark.parametrize("together", [False, True])
def test_log_posterior_residuals_and_gradient_are_one_density(runs, together):
    asked, other = problem(runs), THETA + np.array([0.3, -0.2, 0.1])
    if together:
        asked = problem(in_session(runs))
        asked = replace(asked, dataset=replace(asked.dataset, noise=SESSION_NOISE))
    assert_one_density(asked, other, rtol=5e-4)
    assert asked.log_posteriors(np.array([THETA, other, other + 50.0]))[2] == -np.inf


def test_predictions_ahead_cover_their_nominal_fraction():
    """Shift free, slope as its prior says: 95 % intervals of the last reading hold in 95 % of runs."""
    rng, blank = np.random.default_rng(5), make_observation(dataset([]), track("run", REST))
    slope, hits = SlopeMoments(np.full(200, 0.03), np.full(200, 0.01**2)), 0
    for _ in range(200):
        noise = NOISE.point_sd * rng.normal(size=len(DEPTH))
        tip = rng.normal(0, 20) + rng.normal(0.03, 0.01) * DEPTH + noise
        known = replace(blank, measured=np.column_stack([DEPTH, tip]))
        draws = predict_readings(known, np.zeros((200, len(DEPTH))), np.ones(200), slope, 5, rng)
        low, high = np.quantile(draws[:, -1], (0.025, 0.975))
        hits += low <= tip[-1] <= high
    assert 0.9 <= hits / 200 <= 0.985  # 0.95 +- 3 deviations


def test_later_readings_do_not_enter_the_prediction(runs):
    known = make_observation(dataset(runs), runs[0])
    later = runs[0].tip.copy()
    later[5:] += 9.0
    other = replace(known, measured=np.column_stack([DEPTH, later]))
    slope = SlopeMoments(np.zeros(8), np.ones(8))
    one, two = (
        predict_readings(at, np.zeros((8, len(DEPTH))), np.ones(8), slope, 5, np.random.default_rng(1))
        for at in (known, other)
    )
    assert np.array_equal(one, two)


def test_slopes_of_further_runs_are_predicted_from_the_fitted_ones():
    frames = (0.01, 0.02, 0.03, 0.04, 0.05)
    bent = [measured(track(f"run{n}", REST), n, one) for n, one in enumerate(frames)]
    seen = [make_observation(dataset([]), one) for one in bent]
    (y,) = simulate_tips(bent[:1])
    drawn = TrackDraws((y,) * 5, (), np.ones(1))
    found = estimate_slopes(drawn, seen)
    assert found.mean[0] == pytest.approx(0.03)
    assert found.variance[0] == pytest.approx(0.00025 * 1.2 * 4 / 2)  # scatter, one more run, Student
    with pytest.raises(ConfigError, match="3 runs"):
        estimate_slopes(TrackDraws((y,) * 3, (), np.ones(1)), seen[:3])


def test_a_line_takes_its_slope_from_runs_alike():
    frames = ((REST, 0.01), (REST, 0.02), (REST, 0.03), (GUIDE, 0.07), (GUIDE, 0.08), (GUIDE, 0.09))
    tracks = [with_tip(track(f"run{n}", guide), one * DEPTH) for n, (guide, one) in enumerate(frames)]
    seen = [make_observation(dataset([]), one) for one in tracks]
    rng = np.random.default_rng(1)
    drawn = draw_baseline(BASELINES["steered_line"], seen, tracks[-1:], 3, rng)
    for further, mean in ((tracks[0], 0.02), (tracks[-1], 0.08)):
        found = estimate_slopes(drawn, seen, further)
        assert found.mean == pytest.approx(np.full(3, mean))
        assert found.variance == pytest.approx(np.full(3, 1e-4 * (1 + 1 / 3) * 4 / 2))
    few = estimate_slopes(TrackDraws(drawn.tuned[2:], (), drawn.scale, True), seen[2:], tracks[-1])
    assert few.mean == pytest.approx(np.full(3, 0.0675))


def test_the_kernel_recovers_a_response_to_the_guide():
    truth = np.array([3e-4, 0.4, 0.02, 0.005])
    tracks = [track(f"run{n}", one) for n, one in enumerate((GUIDE, -GUIDE, REST, GUIDE[::-1]))]
    noise = np.random.default_rng(3).normal(0, 0.02, (4, len(DEPTH)))
    bent = [
        with_tip(one, make_kernel_basis(one) @ truth + 0.03 * DEPTH + n + err)
        for n, (one, err) in enumerate(zip(tracks, noise, strict=True))
    ]
    seen = [make_observation(dataset([]), one) for one in bent]
    further = track("further", 2 * GUIDE)
    found = draw_baseline(BASELINES["guide_kernel"], seen, [further], 300, np.random.default_rng(1))
    ahead = make_kernel_basis(further) @ truth + 0.03 * DEPTH
    assert np.median(found.held_out[0], axis=0) == pytest.approx(ahead, abs=0.15)
    assert np.ptp(ahead) > 3
    rest = draw_baseline(BASELINES["guide_kernel"], seen[2:3], [further], 3, np.random.default_rng(1))
    assert rest.held_out[0].shape == (3, len(DEPTH))  # nothing is known of the guide's effects: none


def test_a_parabola_is_fitted_toward_the_bevel():
    bow = 4e-4 * DEPTH**2 / 2
    tracks = [with_tip(track(f"run{s}", REST, side=s), s * bow + 0.01 * DEPTH) for s in (1, -1)]
    noisy = [
        with_tip(one, one.tip + 0.02 * np.random.default_rng(n).normal(size=len(DEPTH)))
        for n, one in enumerate(tracks)
    ]
    seen = [make_observation(dataset([]), one) for one in noisy]
    found = draw_baseline(BASELINES["constant_curvature"], seen, tracks, 500, np.random.default_rng(2))
    ends = found.held_out[0][:, -1], found.held_out[1][:, -1]
    assert np.median(ends[0]) == pytest.approx(bow[-1], abs=3 * np.std(ends[0]))
    assert np.std(ends[0]) < 0.05 and np.allclose(ends[0], -ends[1])
    assert np.median(found.scale) == pytest.approx(1.0, abs=0.35)
    assert (
        not draw_baseline(BASELINES["straight"], seen, tracks, 5, np.random.default_rng(2)).held_out[0].any()
    )


def test_each_predicted_run_has_a_bevel_of_its_own(monkeypatch, runs):
    """Deflections of small needles are proportional to b, so that they spread as ln b does."""
    one = problem(runs[:1])
    task = TrackTask("one", one, tuple(runs[1:]), RecipeRecord(schema_=1))
    sets = [{**TRUTH, "bevel_spread": 0.1}] * 300
    draws = Draws(np.zeros((300, 0)), "posterior")
    monkeypatch.setattr(Problem, "values", lambda *_: sets[0])
    drawn = tracks._draw_model_tips(task, draws, 1, np.random.default_rng(1))
    (bent,) = simulate_deflections([TRUTH], MEDIUM, NEEDLE, [runs[2]], [DEPTH])
    assert np.ptp(drawn.tuned[0], axis=0).max() < 1e-9
    ends = [held[:, -1] for held in drawn.held_out]
    assert np.std(ends[1] / bent[0, -1]) == pytest.approx(0.1, rel=0.15)
    assert abs(np.corrcoef(ends)[0, 1]) < 0.2
