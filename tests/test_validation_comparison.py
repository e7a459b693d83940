"""Which model foretells best: densities with known values, who wins, and a base that moves."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.stats import multivariate_normal, norm

from needlefit.inference.baselines import LENGTH, curve_for
from needlefit.inference.curve_density import CurveDensity
from needlefit.inference.likelihood.covariance import points_covariance
from needlefit.inference.parameters import Parameters
from needlefit.inference.predict import predict, predict_each
from needlefit.inference.slopes import predict_with_slopes
from needlefit.mechanics.control import Bevel, Controls, Rules, Step
from needlefit.mechanics.lanes import follow_batches
from needlefit.mechanics.shape import positions
from needlefit.mechanics.simulate import follow
from needlefit.mechanics.tissue import Tissue
from needlefit.project.records.comparison import ComparisonRecord
from needlefit.project.records.fit import FitRecord
from needlefit.project.records.recipe import LikelihoodRecord
from needlefit.validation.calibration.measured import measured
from needlefit.validation.inquiries.answered import answered
from needlefit.validation.inquiries.comparison.against import summed, verdict
from needlefit.validation.inquiries.comparison.verb import dealt, log_mean, plan
from needlefit.validation.job import Job, Settings
from tests.inference_cases import NEEDLE, NOISE, dataset, insertion, measure, medium, squares_recipe

TRUTH = {"mu1_pa": 3e5, "alpha1": 1.0, "bevel_mm": 0.08}


def test_the_mean_density_of_a_conjugate_case_is_the_predictive_one():
    # theta ~ N(1, 0.5^2), y ~ N(theta, 0.3^2): y ~ N(1, 0.5^2 + 0.3^2)
    draws = np.random.default_rng(1).normal(1.0, 0.5, size=20000)
    value, error = log_mean(norm.logpdf(1.7, draws, 0.3))
    assert value == pytest.approx(norm.logpdf(1.7, 1.0, math.hypot(0.5, 0.3)), abs=3 * error)
    assert error < 0.02


def test_a_mean_of_densities_forgives_failed_draws_and_knows_when_there_is_none():
    assert log_mean(np.array([-np.inf, math.log(4.0)]))[0] == pytest.approx(math.log(2.0))
    assert log_mean(np.array([-800.0, -800.0]))[0] == pytest.approx(-800.0)  # no underflow
    assert log_mean(np.array([-np.inf, -np.inf]))[0] == -np.inf


def test_differences_are_summed_over_groups_and_their_error_is_that_of_the_groups():
    differences = pd.Series([0.5, 0.5, 2.0, 3.0])
    total, error, count = summed(differences, pd.Series(["a", "a", "b", "c"]))
    assert (total, error, count) == pytest.approx((6.0, math.sqrt(3.0), 3))  # sums 1, 2, 3: sd 1
    assert [verdict(d, 1.0) for d in (6.0, 1.9, -1.9, -2.1)] == ["ahead", "tie", "tie", "behind"]
    assert verdict(-np.inf, np.nan) == "tie"  # nothing is known where a density is missing


def test_repeats_are_never_on_both_sides():
    many = [replace(insertion(30.0 + k), specimen=f"hole {k % 5}") for k in range(15)]
    for fold in dealt(tuple(many), 3):
        assert not {one.specimen for one in fold.tune} & {one.specimen for one in fold.validate}
        assert len(fold.tune) + len(fold.validate) == 15


def _curved(depth, side=1):
    """A needle of curvature 0.001 / mm toward its bevel, with a bump that no curve of the family has."""
    s = np.linspace(0.0, depth, 31)
    planar = np.column_stack([s, side * 0.0005 * s**2 + 0.02 * np.sin(s / 4)])
    flat = np.zeros(len(s))
    return replace(insertion(depth, side=side), planar=planar, out_of_plane=flat)


def test_a_curves_density_is_the_gaussian_of_its_deflections():
    one = _curved(40.0)
    density = CurveDensity("constant_curvature", dataset([one]), (one,), LikelihoodRecord(), 1000.0)
    theta = np.array([0.0012 * LENGTH, math.log(1.7)])
    s = density.known[0].nodes.s[0]
    x = one.planar[:, 0] - one.planar[0, 0]
    slope = np.polynomial.Polynomial.fit(x, one.planar[:, 1], 3).deriv()(x)
    shift = NOISE.registration_mean / math.sqrt(8 / math.pi)
    modes = np.column_stack([shift * np.ones(len(x)), one.pose_angle_sd * x, -shift * slope])
    cov = 1.7**2 * (points_covariance(s, NOISE) + modes @ modes.T)
    off = curve_for(density.curve(theta), one)(s)[:, 1] - one.planar[:, 1]
    assert density(theta[None])[0] == pytest.approx(multivariate_normal.logpdf(off, cov=cov), rel=1e-6)
    assert density(np.array([[0.0, math.log(1e4)]]))[0] == -np.inf


def test_a_curves_peak_is_where_its_density_is_greatest():
    made = tuple(_curved(30.0 + 5 * k, (1, -1)[k % 2]) for k in range(3))
    density = CurveDensity("constant_curvature", dataset(made), made, LikelihoodRecord(), 1000.0)
    peak = density.peak
    around = peak + 0.02 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    assert density(peak[None])[0] > density(around).max()
    assert density.curve(peak).coefficients[0] == pytest.approx(0.001, rel=0.2)


RECORD = {"schema": 1, "kind": "comparison", "dataset": "cases", "medium": "test", "folds": 2}


def _answer(**changed):
    record = ComparisonRecord.model_validate(
        {**RECORD, "candidates": ("ogden", "linear", "straight"), **changed}
    )
    rng, made = np.random.default_rng(2), []
    for k in range(4):
        planned = measure(TRUTH, medium(layers=1), insertion(34.0 + 6 * k, side=(1, -1)[k % 2]), points=31)
        made.append(measured(dataset([planned]), planned, TRUTH, medium(layers=1), rng))
    fit = FitRecord.model_validate({"schema": 1, "dataset": "cases", "medium": "test"})
    parameters = Parameters.from_record(medium(layers=1))
    recipe = squares_recipe(starts=2)
    folds = dealt(tuple(made), 2)
    job = Job("cases", fit, dataset(made), medium(layers=1), parameters, recipe, None, folds)
    return answered("cases", record, Settings(), plan(record, job, Settings()))


@pytest.fixture(scope="module")
def compared():
    return _answer(must_win=True)


def test_laws_tie_where_strains_are_small_and_a_straight_line_loses(compared):
    table = compared.frames["against"].set_index("candidate")
    assert table["verdict"].to_dict() == {"ogden": "reference", "linear": "tie", "straight": "behind"}
    assert abs(table.loc["linear", "difference"]) < 3.0
    assert table.loc["straight", "difference"] < -20.0
    assert 0.5 < table.loc["ogden", "noise_scale"] < 2.0


def test_a_control_that_the_comparison_misses_is_a_fault(compared):
    (fault,) = compared.faults
    assert "not found ahead of linear" in fault
    assert "straight" not in fault


def test_a_study_names_its_data_or_makes_them():
    with pytest.raises(ValueError, match="neither dataset nor"):
        ComparisonRecord.model_validate({**RECORD, "dataset": None})
    with pytest.raises(ValueError, match="not among the candidates"):
        ComparisonRecord.model_validate({**RECORD, "candidates": ("linear", "straight")})


MOVED = replace(insertion(40.0), base_moved=8.0)
THIN = medium(layers=1).model_copy(update={"thickness_mm": 5.0})
SOFT = {"mu1_pa": 3e3, "alpha1": 1.0, "bevel_mm": 0.03}


def test_a_base_that_moves_does_so_once_the_needle_is_in():
    bevel = Bevel(0.03)
    tissue = Tissue(np.array([3e-3]), np.array([1.0]), np.empty(0), np.array([5.0]))
    steps = (Step(40.0, bevel), Step(40.0, bevel, Controls(base_y=8.0)))
    shape = predict(SOFT, THIN, NEEDLE, MOVED)
    assert shape.u == pytest.approx(follow(NEEDLE, tissue, steps, Rules(tolerance=1e-9)).u, abs=1e-9)
    still = predict(SOFT, THIN, NEEDLE, replace(MOVED, base_moved=0.0))
    assert shape.constraints == pytest.approx(still.constraints, abs=1e-9)  # the cut stays where it was
    assert positions(shape, np.array([0.0]))[0, 1] > 1.0  # the tissue gives way at the entry
    (lanes,) = follow_batches([predict_each([SOFT], THIN, NEEDLE, MOVED)])
    assert lanes.u[0] == pytest.approx(shape.u, abs=1e-6)


def test_a_moved_bases_needle_has_exact_derivatives():
    parameters = Parameters.from_record(THIN)
    theta, s = parameters.theta(SOFT), np.linspace(0.0, 40.0, 9)
    _, slopes = predict_with_slopes(SOFT, parameters, THIN, NEEDLE, MOVED, s)
    for k, move in enumerate(1e-4 * np.eye(len(theta))):
        ends = [predict(parameters.values(theta + sign * move), THIN, NEEDLE, MOVED) for sign in (1, -1)]
        by = (positions(ends[0], s) - positions(ends[1], s)) / 2e-4
        assert slopes[:, :, k] == pytest.approx(by, rel=1e-3, abs=1e-6)
