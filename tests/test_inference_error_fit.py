"""The error-minimising fit: the tolerance of its objective, and the ranges of parameters within it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from inference_cases import NOISE, TRUTH, dataset, insertion, measure, medium, problem, two_layers
from numpy.random import default_rng
from problem_cases import make_problem
from pytest import approx

from needlefit.datasets.insertion import Noise
from needlefit.datasets.read import read
from needlefit.datasets.select import MIN_GROUPS
from needlefit.inference import error_fit
from needlefit.inference.error_fit import estimate_tolerance, examine_errors, find_error_ranges
from needlefit.inference.fit import Fit
from needlefit.inference.forward_model import predict
from needlefit.inference.parameters import without_prior
from needlefit.mechanics.shape import sample_inserted_points
from needlefit.project.callbacks import never_stop
from needlefit.project.locate import find_file
from needlefit.project.toml import load
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import WeightsRecord


def at_truth(p):
    theta = p.parameters.theta(TRUTH)
    return Fit(tuple(theta.tolist()), p.values(theta), p.objective(theta), (), 0, 0, False, "metric")


def examine(p):
    nothing = np.empty((0, len(p.names)))
    return examine_errors(p, at_truth(p), nothing, p.parameters, default_rng(3))


def test_without_noise_and_with_few_insertions_the_tolerance_is_the_smallest():
    p = problem(medium(), two_layers().insertions, noise=Noise())
    p = replace(p, insertions=tuple(replace(one, pose_angle_sd=0.0) for one in p.insertions))
    found = examine(p)
    assert found.tolerance.value == 0.002 and found.fit == at_truth(p)


# ---- known answers: of one tip error, which one free parameter takes off along one direction

TIP_ALONE = WeightsRecord(ipe=0.0, te=1.0, edp=0.0)
QUANTILE_95 = 1.96
"""Of the absolute value of a standard normal variable."""


def bevel_alone(made, noise, compared="plane"):
    """A problem of the tip errors alone, in which b alone is free."""
    record = medium(mu1_pa={"fixed": TRUTH["mu1_pa"]}, mu2_pa={"fixed": TRUTH["mu2_pa"]})
    data = replace(dataset(made, noise=noise), compared=compared)
    return make_problem(data, made, record, weights=TIP_ALONE)


def one_needle(**changed):
    planned = replace(insertion(36.0, (14.0,), (1, 2)), pose_angle_sd=0.0, roll_sd=0.0, **changed)
    return measure(TRUTH, medium(), planned)


def estimate(p, theta=None, seed=5):
    at = np.array(p.parameters.theta(TRUTH)) if theta is None else theta
    return estimate_tolerance(p, p.parameters, at, default_rng(seed))


def find_taken_off(p):
    """Return the unit vector along which b moves the tip."""
    slope = p.distances(np.array(p.parameters.theta(TRUTH))).slopes[-1, :, 0]
    return slope / np.linalg.norm(slope)


@pytest.mark.parametrize(("compared", "roll_sd"), [("plane", 0.0), ("space", 0.0), ("space", 0.1)])
def test_the_tolerance_by_noise_is_the_quantile_of_what_a_free_parameter_takes_off(compared, roll_sd):
    made, sd = replace(one_needle(), roll_sd=roll_sd), 0.1
    p = bevel_alone([made], Noise(0.0, sd, 0.0, 5.0), compared)
    along = find_taken_off(p)
    rng = default_rng(1)
    errors = sd * rng.standard_normal((100_000, len(along)))
    if compared == "space":  # the roll turns the tip out of the plane
        errors[:, 2] += roll_sd * made.points[-1, 1] * rng.standard_normal(len(errors))
    size, taken = np.linalg.norm(errors, axis=1), errors @ along
    known = np.quantile(size - np.sqrt(np.maximum(size**2 - taken**2, 0.0)), 0.95)
    found = [estimate(p, seed=seed).by_noise for seed in range(4)]  # of 200 replicates each
    assert np.mean(found) == approx(known, rel=0.08)


@pytest.mark.parametrize(("shared_sd", "factor"), [(0.0, 1.0), (0.5, QUANTILE_95)])
def test_an_error_of_a_surface_is_taken_off_whole_where_insertions_share_it(shared_sd, factor):
    # of two errors of their own z1, z2 a shift takes off min(|z1|, |z2|) where the signs are alike
    depths = {"boundary_sd": 0.5, "boundary_shared_sd": shared_sd, "specimen": "one"}
    first, second = one_needle(**depths), replace(one_needle(**depths), id="second")
    p = bevel_alone([first, second], Noise(0.0, 1e-6, 0.0, 5.0))
    deeper, shallower = (
        predict(TRUTH, p.medium, replace(first, boundaries=np.array([14.0 + step]))) for step in (0.5, -0.5)
    )
    effect = np.diff([sample_inserted_points(one, 2)[-1, 1] for one in (shallower, deeper)])[0] / 2
    assert estimate(p).by_noise == approx(factor * abs(effect), rel=0.15)


def test_insertions_that_are_alike_give_one_excess_however_often_each_is_drawn():
    one = one_needle()
    made = [replace(one, id=str(k), specimen=str(k // 2)) for k in range(2 * MIN_GROUPS)]
    p = bevel_alone(made, Noise(0.0, 1e-6, 0.0, 5.0))
    theta = np.array(p.parameters.theta(TRUTH)) + 0.2
    off = p.distances(theta)
    tip = off.off[off.weights > 0][0]
    along = find_taken_off(p)
    excess = np.linalg.norm(tip) - math.sqrt(max(tip @ tip - (tip @ along) ** 2, 0.0))
    assert estimate(p, theta).by_insertions == approx(excess, rel=0.01)
    fewer = replace(p, insertions=tuple(made[: MIN_GROUPS - 1]))
    assert math.isnan(estimate(fewer, theta).by_insertions)


def test_the_tolerance_by_insertions_is_the_quantile_over_groups_drawn_again(monkeypatch):
    monkeypatch.setattr(error_fit, "REPLICATES", 1000)
    made = [
        measure(TRUTH | {"bevel_mm": b}, medium(), replace(one_needle(), id=str(k), specimen=str(k)))
        for k, b in enumerate((0.055, 0.065, 0.089, 0.106, 0.118))
    ]
    p = bevel_alone(made, Noise())
    theta = np.array(p.parameters.theta(TRUTH))
    at = p.distances(theta)
    off, slope = at.off[at.weights > 0], at.slopes[at.weights > 0, :, 0]
    steps = np.linspace(-1.0, 1.0, 2001)
    tips = np.linalg.norm(off + steps[:, None, None] * slope, axis=2)  # (steps, insertions)
    times = default_rng(1).multinomial(5, np.full(5, 0.2), size=20_000)
    errors = times @ tips.T / 5
    known = np.quantile(errors[:, 1000] - errors.min(axis=1), 0.95)
    assert estimate(p, theta).by_insertions == approx(known, rel=0.02)


def test_the_smallest_tolerance_is_a_hundredth_of_the_objective():
    p = bevel_alone([one_needle()], Noise())
    theta = np.array(p.parameters.theta(TRUTH)) + 1.0
    assert estimate(p, theta).value == approx(0.01 * p.objective(theta)) and p.objective(theta) > 0.2


def test_the_ranges_end_where_the_errors_exceed_the_least_ones_by_the_tolerance():
    # of one tip and one parameter the error is the distance that b moves the tip
    made = [one_needle()]
    p, tolerance = bevel_alone(made, NOISE), 0.5
    theta = np.array(p.parameters.theta(TRUTH))
    (found,) = find_error_ranges(p, theta, tolerance, np.empty((0, 1)), 1, never_stop)
    excess = [p.objective(np.array([end])) - p.objective(theta) for end in (found.low, found.high)]
    assert excess == approx([tolerance, tolerance], rel=0.03)
    assert p.lower[0] < found.low < theta[0] < found.high < p.upper[0]
    (wide,) = find_error_ranges(p, theta, 100.0, np.empty((0, 1)), 1, never_stop)
    assert (wide.low, wide.high) == (p.lower[0], p.upper[0])
    # b moves the tip in proportion: from a bound the errors fall to the truth, and rise again as far
    (from_bound,) = find_error_ranges(p, p.lower, 0.01, np.empty((0, 1)), 1, never_stop)
    assert from_bound.low == p.lower[0]
    assert math.exp(from_bound.high) == approx(2 * TRUTH["bevel_mm"] - 1e-3, rel=0.05)


def test_steps_that_lead_out_of_the_limit_turn_back():
    """Errors of the thin gel are far from linear in alpha: long steps lead from one side to the other.

    By scipy's SLSQP and COBYQA mu reaches 6402 Pa. Its low end lies in a valley at negative alpha, where a
    grid finds errors within the limit down to 3023 Pa; in the valley of the least errors mu ends at 4574 Pa.
    """
    data = read(find_file("dataset", "thin_gel"))
    record = load(find_file("medium", "thin_gel"), MediumRecord)
    p = make_problem(data, data.insertions, record).holding(())
    least = p.parameters.theta({"mu1_pa": 5764.51, "alpha1": 3.08068, "bevel_mm": 0.0320374})
    nothing = np.empty((0, len(least)))
    found = find_error_ranges(p, least, 0.0262705, nothing, 1, never_stop)
    ends = {one.name: (math.exp(one.low), math.exp(one.high)) for one in found}
    assert ends["mu1_pa"] == approx((3023.0, 6402.0), rel=0.01)


def test_valleys_are_followed_to_the_bound():
    """With mu of either layer of phantom 3 at a bound scipy's L-BFGS-B finds errors within the limit.

    Where mu of the second layer is least, mu of the first is large: not in the valley of the least errors.
    """
    data = read(find_file("dataset", "twin"))
    made = tuple(one for one in data.insertions if one.medium == "phantom3")
    record = load(find_file("medium", "phantom3"), MediumRecord)
    p = make_problem(data, made, record)
    p = p.with_parameters(without_prior(p.parameters))
    least, tolerance = np.array([6.90775528, 15.5795441, -2.78893071]), 0.06482
    found = find_error_ranges(p, least, tolerance, np.empty((0, 3)), 1, never_stop)
    assert [(one.low, one.high) for one in found[:2]] == list(zip(p.lower[:2], p.upper[:2], strict=True))
