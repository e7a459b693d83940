"""Which model predicts best: densities with known values, who wins, and a base that moves."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad
from scipy.stats import multivariate_normal

from needlefit.errors import ConfigError
from needlefit.inference.baseline_fit import CurveDensity
from needlefit.inference.baselines import COEFFICIENT_LENGTH_MM
from needlefit.inference.forward_model import PreparedModel, make_batch, predict
from needlefit.inference.likelihood.observation import points_covariance
from needlefit.inference.parameters import BEVEL_SPREAD, NOISE_SCALE, Parameters
from needlefit.mechanics.batch import simulate_batches
from needlefit.mechanics.control import Bevel, Controls, ModelOptions, Step
from needlefit.mechanics.shape import compute_positions
from needlefit.mechanics.simulate import simulate_steps
from needlefit.mechanics.tissue import Tissue
from needlefit.schemas.recipe import LikelihoodRecord
from needlefit.schemas.study import FitRecord
from needlefit.studies.job import Fold, Job, Settings
from needlefit.studies.kinds.comparison import (
    MAX_NOISE_FACTOR,
    REPORT,
    ComparisonRecord,
    candidate_job,
    deal_folds,
    fit_candidate,
    monte_carlo_error,
    plan,
    sum_differences,
    verdict,
)
from needlefit.studies.runner import run_analysis
from needlefit.studies.simulated_data import simulate_measurement
from tests.inference_cases import NEEDLE, NOISE, dataset, insertion, measure, medium, squares_recipe

TRUTH = {"mu1_pa": 3e5, "alpha1": 1.0, "bevel_mm": 0.08}


def test_differences_are_summed_over_groups_and_their_error_is_that_of_the_groups():
    differences = pd.Series([0.5, 0.5, 2.0, 3.0])
    total, error, count = sum_differences(differences, pd.Series(["a", "a", "b", "c"]))
    assert (total, error, count) == pytest.approx((6.0, math.sqrt(3.0), 3))  # sums 1, 2, 3: sd 1
    assert [verdict(d, 1.0) for d in (6.0, 1.9, -1.9, -2.1)] == ["ahead", "tie", "tie", "behind"]
    assert verdict(-np.inf, np.nan) == "tie"  # nothing is known where a density is missing


def test_posterior_uncertainty_adds_up_over_needles_that_share_it():
    errors = {"log_density_se": [0.5, 0.5, 0.4], "shared_se": [0.3, 0.3, 0.0], "fold": ["1", "1", "2"]}
    # 0.4^2 + 0.4^2 + 0.4^2 of the needles, (2 * 0.3)^2 of the first fold
    assert monte_carlo_error(pd.DataFrame(errors)) == pytest.approx(math.sqrt(3 * 0.16 + 0.36))


def test_repeats_are_never_on_both_sides_and_there_are_no_more_folds_than_needles():
    many = tuple(replace(insertion(30.0 + k), specimen=f"hole {k % 5}") for k in range(15))
    for fold in deal_folds(many, 3):
        assert not {one.specimen for one in fold.tune} & {one.specimen for one in fold.validate}
        assert len(fold.tune) + len(fold.validate) == 15
    block = tuple(replace(insertion(30.0 + k), specimen="one block") for k in range(4))
    assert [len(fold.validate) for fold in deal_folds(block, 4)] == [1, 1, 1, 1]
    with pytest.raises(ConfigError, match=r"5 folds .*4 needles"):
        deal_folds(block, 5)


def _curved(depth, side=1):
    """A needle of curvature 0.001 / mm toward its bevel, with a bump that no curve of the family has."""
    s = np.linspace(0.0, depth, 31)
    planar = np.column_stack([s, side * 0.0005 * s**2 + 0.02 * np.sin(s / 4)])
    flat = np.zeros(len(s))
    return replace(insertion(depth, side=side), planar=planar, out_of_plane=flat)


def _curves(count=3):
    return tuple(_curved(30.0 + 5 * k, (1, -1)[k % 2]) for k in range(count))


def _log_density(off, one, scale, slope, s):
    """Return the Gaussian log density of deflections: errors of points, pose and registration."""
    x = one.planar[:, 0] - one.planar[0, 0]
    shift = NOISE.registration_mean / math.sqrt(8 / math.pi)
    modes = np.column_stack([shift * np.ones(len(x)), one.pose_angle_sd * x, -shift * slope])
    cov = scale**2 * points_covariance(s, NOISE) + modes @ modes.T
    return multivariate_normal.logpdf(off, cov=cov)


def _slope(one, degree):
    x = one.planar[:, 0] - one.planar[0, 0]
    return np.polynomial.Polynomial.fit(x, one.planar[:, 1], degree).deriv()(x)


def test_a_curves_density_is_the_gaussian_of_its_deflections():
    one = _curved(40.0)
    density = CurveDensity("constant_curvature", dataset([one]), (one,), LikelihoodRecord(), 1000.0)
    theta = np.array([0.0012 * COEFFICIENT_LENGTH_MM, math.log(1.7)])
    s = density.observations[0].nodes.s[0]
    off = density.curve(theta).curve(one)(s)[:, 1] - one.planar[:, 1]
    assert density(theta[None])[0] == pytest.approx(_log_density(off, one, 1.7, _slope(one, 3), s), rel=1e-6)
    assert density(np.array([[0.0, math.log(1e4)]]))[0] == -np.inf


def test_a_curves_peak_is_where_its_density_is_greatest():
    made = _curves()
    density = CurveDensity("constant_curvature", dataset(made), made, LikelihoodRecord(), 1000.0)
    peak = density.peak
    around = peak + 0.02 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    assert density(peak[None])[0] > density(around).max()
    assert density.curve(peak).coefficients[0] == pytest.approx(0.001, rel=0.2)


def test_a_straight_lines_density_is_that_of_the_noise_factor_alone():
    """Its one parameter can be integrated over by quadrature."""
    made = _curves()
    fold = Fold("all but one", made[:2], made[2:])
    found = fit_candidate("straight", candidate_job("straight", _job(made, (fold,))), fold, Settings())

    def log_evidence(insertions):
        density = CurveDensity("straight", dataset(made), insertions, LikelihoodRecord(), MAX_NOISE_FACTOR)
        top = density(density.peak[None])[0]
        scaled = quad(lambda at: np.exp(density(np.array([[at]]))[0] - top), *(density.peak[0] + [-2.0, 2.0]))
        return top + math.log(scaled[0])

    density = found.predict_density(made[2])
    assert density.log_density == pytest.approx(log_evidence(made) - log_evidence(made[:2]), abs=0.15)
    assert density.k < 0.7 and density.se < 0.1


@pytest.mark.sweep
def test_the_path_angle_is_a_candidate():
    made = tuple(measure(TRUTH, medium(layers=1), insertion(30.0 + 6 * k), points=31) for k in range(2))
    fold = Fold("one", made[:1], made[1:])
    job = candidate_job("path_angle", _job(made, (fold,)))
    assert job.medium.advance == "path_angle" and "cut_angle_deg" in job.parameters.free
    found = fit_candidate("path_angle", job, fold, Settings())
    (curve, *_) = found.predictor(made[1]).values()
    tip = curve(np.array([made[1].depth]))[0]
    assert tip[1] == pytest.approx(made[1].planar[-1, 1], abs=0.2)
    assert np.isfinite(found.predict_density(made[1]).log_density)


def test_further_points_add_their_whole_density():
    """Nothing that the likelihood drops is missing from the ratio of two posteriors."""
    made = [measure(TRUTH, medium(layers=1), insertion(30.0 + 6 * k), points=31) for k in range(2)]
    job = candidate_job("ogden", _job(tuple(made), ()))
    # all bevels are the same: a further one would change what b is the mean of
    theta = job.parameters.theta({**TRUTH, "bevel_mm": 0.1, NOISE_SCALE: 1.3, BEVEL_SPREAD: 1e-3})
    one, both = (job.problem(Fold("", tuple(some), ())) for some in (made[:1], made))
    s = both.density.observations[1].nodes.s[0]
    shape = predict(both.values(theta), medium(layers=1), NEEDLE, made[1])
    off = compute_positions(shape, s)[:, 1] - made[1].planar[:, 1]
    exact = _log_density(off, made[1], 1.3, _slope(made[1], 5), s)
    assert both.log_posterior(theta) - one.log_posterior(theta) == pytest.approx(exact, abs=0.02)


RECORD = {"schema": 1, "kind": "comparison", "dataset": "cases", "medium": "test", "folds": 2}


def _job(made, folds):
    fit = FitRecord.model_validate({"schema": 1, "dataset": "cases", "medium": "test"})
    parameters = Parameters.from_record(medium(layers=1))
    recipe = squares_recipe(starts=2)
    return Job("cases", fit, dataset(made), medium(layers=1), parameters, recipe, None, folds)


@pytest.fixture(scope="module")
def compared():
    candidates = ("ogden", "linear", "straight")
    record = ComparisonRecord.model_validate({**RECORD, "candidates": candidates, "positive_control": True})
    rng, made = np.random.default_rng(3), []
    for k in range(4):
        planned = measure(TRUTH, medium(layers=1), insertion(34.0 + 6 * k, side=(1, -1)[k % 2]), points=21)
        made.append(simulate_measurement(dataset([planned]), planned, TRUTH, medium(layers=1), rng))
    job = _job(tuple(made), deal_folds(tuple(made), 2))
    return run_analysis("cases", record, Settings(), plan(record, job, Settings()))


@pytest.mark.sweep
def test_laws_tie_where_strains_are_small_and_a_straight_line_loses(compared):
    scores, table = compared.frames["scores"], compared.frames["comparison"].set_index("method")
    assert table["verdict"].to_dict() == {"ogden": "reference", "linear": "tie", "straight": "behind"}
    assert abs(table.loc["linear", "difference"]) < 3.0 and table.loc["straight", "difference"] < -20.0
    assert 0.5 < table.loc["ogden", "noise_scale"] < 2.0
    # the error of draws is small, and part of the verdict
    assert scores["log_density_se"].max() < 0.2 and scores["pareto_k"].max() < 0.7
    own = compared.frames["differences"].query("method == 'linear'")
    scatter, drawn = sum_differences(own["difference"], own["group"])[1], table["draws_se"]
    error = math.hypot(scatter, drawn["linear"], drawn["ogden"])
    assert table["difference_se"][["linear", "ogden"]].tolist() == pytest.approx([error, 0.0])
    # a control that the comparison misses is a fault
    (fault,) = compared.faults
    assert "ahead of linear" in fault and "straight" not in fault
    assert "over 4 needles" in REPORT.summarize(compared)[1]
    grouped = compared.with_frames(differences=compared.frames["differences"].assign(group="one hole"))
    assert "repeats" in REPORT.summarize(grouped)[1]


@pytest.mark.parametrize(
    ("changed", "fault"),
    [({"dataset": None}, "neither dataset nor"), ({"candidates": ("linear", "straight")}, "candidates")],
)
def test_a_study_names_its_data_or_makes_them(changed, fault):
    with pytest.raises(ValueError, match=fault):
        ComparisonRecord.model_validate({**RECORD, **changed})


MOVED = replace(insertion(40.0), base_moved=8.0)
THIN = medium(layers=1).model_copy(update={"thickness_mm": 5.0})
SOFT = {"mu1_pa": 3e3, "alpha1": 1.0, "bevel_mm": 0.03}


def test_a_base_that_moves_does_so_once_the_needle_is_in():
    bevel = Bevel(0.03)
    tissue = Tissue(np.array([3e-3]), np.array([1.0]), np.empty(0), np.array([5.0]))
    steps = (Step(40.0, bevel), Step(40.0, bevel, Controls(base_y=8.0)))
    shape = predict(SOFT, THIN, NEEDLE, MOVED)
    assert shape.u == pytest.approx(
        simulate_steps(NEEDLE, tissue, steps, ModelOptions(tolerance=1e-9)).u, abs=1e-9
    )
    still = predict(SOFT, THIN, NEEDLE, replace(MOVED, base_moved=0.0))
    assert shape.constraints == pytest.approx(still.constraints, abs=1e-9)  # the cut stays where it was
    assert compute_positions(shape, np.array([0.0]))[0, 1] > 1.0  # the tissue gives way at the entry
    (lanes,) = simulate_batches([make_batch([SOFT], THIN, NEEDLE, MOVED)])
    assert lanes.u[0] == pytest.approx(shape.u, abs=1e-6)


def test_a_moved_bases_needle_has_exact_derivatives():
    parameters = Parameters.from_record(THIN)
    theta, s = parameters.theta(SOFT), np.linspace(0.0, 40.0, 9)
    _, ((slopes,),) = PreparedModel(THIN, NEEDLE, [MOVED]).differentiate([SOFT], parameters, [s])
    for k, move in enumerate(1e-4 * np.eye(len(theta))):
        ends = [predict(parameters.values(theta + sign * move), THIN, NEEDLE, MOVED) for sign in (1, -1)]
        by = (compute_positions(ends[0], s) - compute_positions(ends[1], s)) / 2e-4
        assert slopes[:, :, k] == pytest.approx(by, rel=1e-3, abs=1e-6)
