"""Needles simulated in memory: measured as the likelihood says, of the truth that is stated."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from inference_cases import NEEDLE, insertion, measure, medium
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from pytest import approx
from research.simulated_data import simulate_from_prior, simulate_measurement
from track_cases import DEPTH, GUIDE, MEDIUM, TRUTH, track
from track_cases import dataset as tracks
from track_cases import problem as track_problem

from needlefit import Bevel, Controls, ModelOptions, Problem, Step, Tissue, compute_positions, simulate_steps
from needlefit.datasets.insertion import Dataset, Noise
from needlefit.inference.forward_model import PreparedModel, predict
from needlefit.inference.parameters import Parameters
from needlefit.schemas.recipe import RecipeRecord

SEEN = {"mu1_pa": 3e5, "alpha1": 1.0, "bevel_mm": 0.08}


def small_problem(scale=1.0, **changed):
    """Two short needles in one layer whose depths are certain, mu and b free."""
    record = medium(1, mu1_pa={"bounds": [1e4, 1e7]}, bevel_mm={"bounds": [0.02, 0.3]})
    made = tuple(
        replace(measure(SEEN, record, insertion(depth), points=21), **changed) for depth in (13.0, 19.0)
    )
    noise = Noise(registration_mean=0.19, point_sd=0.02, correlated_sd=0.02)
    data = Dataset("small", "small", "synthetic", made, ("test",), noise, "known", 0.0, Path(), "0")
    recipe = RecipeRecord.model_validate({"schema": 1, "likelihood": {"noise_scale": scale}})
    parameters = Parameters.from_record(record)
    return Problem(data, made, record, parameters, recipe.weights, likelihood=recipe.likelihood)


@pytest.mark.parametrize("pose", ["known", "free"])
def test_without_errors_a_measured_needle_is_the_likelihood_s_own(pose):
    """Its residuals are 0: arc lengths and deflections are what the likelihood takes them for."""
    problem = small_problem()
    noise = replace(problem.dataset.noise, registration_mean=0.0)
    still = replace(problem.dataset, noise=noise, pose=pose)
    for one in problem.insertions:
        sure = replace(one, pose_angle_sd=0.0)
        quiet = {**SEEN, "noise_scale": 1e-9}
        seen = simulate_measurement(still, sure, quiet, problem.medium, default_rng(2))
        assert seen.measure_arc("plane") == approx(one.measure_arc("plane"), rel=1e-6)
        known = replace(problem, dataset=still, insertions=(seen,))
        residuals = known.compute_misfits(known.parameters.theta(SEEN))
        assert np.abs(residuals).max() < (1e-3 if pose == "known" else 0.05)


def test_depths_err_as_stated_and_the_noise_s_scale_is_drawn_too():
    problem = small_problem(scale="estimated", depth_sd=0.4)
    one = problem.insertions[0]
    quiet = replace(problem.dataset, noise=Noise(point_sd=1e-6))
    sure = replace(one, pose_angle_sd=0.0)
    rng = default_rng(5)
    ends = [simulate_measurement(quiet, sure, SEEN, problem.medium, rng).points[0, 0] for _ in range(300)]
    assert np.std(ends) == approx(0.4, rel=0.15)  # the entry's place moves along


def test_a_truth_from_the_prior_differs_by_seed_and_keeps_the_design():
    problem = small_problem()
    drawn = [simulate_from_prior(problem, seed) for seed in (1, 1, 2)]
    (one, first), (again, same), (other, second) = drawn
    assert one.tolist() == again.tolist() != other.tolist()
    assert np.all((problem.lower <= one) & (one <= problem.upper))
    for ours, theirs, planned in zip(first.insertions, same.insertions, problem.insertions, strict=True):
        assert_array_equal(ours.points, theirs.points)
        assert ours.depth == planned.depth and ours.pose_angle_sd == planned.pose_angle_sd
    assert first.insertions[0].deflection != second.insertions[0].deflection


def test_readings_of_tips_err_as_the_likelihood_of_their_session_states():
    """The squares of residuals at the truth, marginal over what runs share, are chi-squared."""
    runs = [
        replace(track(name, GUIDE * sign), headings=(0.0 * DEPTH,)) for name, sign in (("a", 0.0), ("b", 1.0))
    ]
    noise, rng, squares = Noise(point_sd=0.1, slope_sd=0.02, heading_sd=0.03), default_rng(4), []
    data = replace(tracks(runs), noise=noise)
    for _ in range(200):
        shared = {}
        seen = [simulate_measurement(data, run, TRUTH, MEDIUM, rng, shared) for run in runs]
        asked = replace(track_problem(seen), dataset=data)
        misfits = asked.compute_misfits(asked.parameters.theta(TRUTH))
        squares.append(misfits @ misfits)
    rows = sum(known.rows for known in asked.density.observations)
    assert rows == 2 * (2 * len(DEPTH) - 2)  # tips and headings but the first, less a shift of each run
    assert np.mean(squares) == approx(rows, abs=4 * np.sqrt(2 * rows / 200))


MOVED = replace(insertion(40.0), base_moved=8.0)
THIN = medium(layers=1).model_copy(update={"thickness_mm": 5.0})
SOFT = {"mu1_pa": 3e3, "alpha1": 1.0, "bevel_mm": 0.03}


def test_a_base_that_moves_does_so_once_the_needle_is_in():
    bevel = Bevel(0.03)
    tissue = Tissue(np.array([3e-3]), np.array([1.0]), np.empty(0), np.array([5.0]))
    steps = (Step(40.0, bevel), Step(40.0, bevel, Controls(base_y=8.0)))
    shape = predict(SOFT, THIN, MOVED)
    assert shape.u == approx(simulate_steps(NEEDLE, tissue, steps, ModelOptions(tolerance=1e-9)).u, abs=1e-9)
    still = predict(SOFT, THIN, replace(MOVED, base_moved=0.0))
    assert shape.constraints == approx(still.constraints, abs=1e-9)  # the cut stays where it was
    assert compute_positions(shape, np.array([0.0]))[0, 1] > 1.0  # the tissue gives way at the entry
    (lanes,) = PreparedModel(THIN, [MOVED]).simulate([SOFT])
    assert lanes.u[0] == approx(shape.u, abs=1e-6)


def test_a_moved_bases_needle_has_exact_derivatives():
    parameters = Parameters.from_record(THIN)
    theta, s = parameters.theta(SOFT), np.linspace(0.0, 40.0, 9)
    ((_, (slopes,)),) = PreparedModel(THIN, [MOVED]).differentiate([SOFT], parameters, [s])
    for k, move in enumerate(1e-4 * np.eye(len(theta))):
        ends = [predict(parameters.values(theta + sign * move), THIN, MOVED) for sign in (1, -1)]
        by = (compute_positions(ends[0], s) - compute_positions(ends[1], s)) / 2e-4
        assert slopes[:, :, k] == approx(by, rel=1e-3, abs=1e-6)
