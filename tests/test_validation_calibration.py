"""Calibration: right posteriors pass, wrong ones are noticed, bands err as often as they say."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy
from inference_cases import insertion, measure, medium
from track_cases import GUIDE, track

from needlefit.datasets.folds import Fold
from needlefit.datasets.insertion import Dataset, Noise
from needlefit.errors import ConfigError
from needlefit.inference.parameters import Parameters
from needlefit.inference.predict import Draws, draw_from_prior, wilson_interval
from needlefit.inference.problem import Problem
from needlefit.inference.rank_statistics import (
    RANK_DRAWS,
    ecdf_band,
    estimate_share,
    find_covered,
    find_failing,
    probability_inside,
    rank_truth,
    share_by_truth,
    tabulate_covered_shares,
    tabulate_ecdfs,
)
from needlefit.project.locate import find_file
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.study import FitRecord
from needlefit.studies.job import Job, Settings
from needlefit.studies.kind import find_kind
from needlefit.studies.kinds import calibration
from needlefit.studies.kinds.calibration import (
    HELD_OUT_TIP,
    CalibrationRecord,
    design_synthetic,
    find_stiff_direction,
    infer_posterior,
    is_inside_bounds,
    replicate,
)
from needlefit.studies.load import load_study
from needlefit.studies.simulated_data import find_true_value, simulate_measurement
from needlefit.studies.study_files import load_study_file
from needlefit.synthetic.design import POPULATION, draw_deviations, draw_specimen, list_designs

STIFF = {"mu1_pa": 0.3, "bevel_mm": 0.95}

SEEN = {"mu1_pa": 3e5, "alpha1": 1.0, "bevel_mm": 0.08}


def small_job(count: int = 2, scale: float | str = 1.0, **changed: object) -> Job:
    """One or two short needles in one layer whose depths are certain, mu and b free."""
    record = medium(1, mu1_pa={"bounds": [1e4, 1e7]}, bevel_mm={"bounds": [0.02, 0.3]})
    made = tuple(
        replace(measure(SEEN, record, insertion(depth), points=21), **changed)
        for depth in (13.0, 19.0)[:count]
    )
    noise = Noise(registration_mean=0.19, point_sd=0.02, correlated_sd=0.02)
    data = Dataset("small", "small", "synthetic", made, ("test",), noise, "known", 0.0, Path(), "0")
    fit = FitRecord.model_validate({"schema": 1, "dataset": "small", "medium": "test"})
    recipe = RecipeRecord.model_validate({"schema": 1, "likelihood": {"noise_scale": scale}})
    return Job(
        "small",
        fit,
        data,
        record,
        Parameters.from_record(record),
        recipe,
        None,
        (Fold("all", made, ()),),
        data,
    )


def run(job: Job, count: int) -> dict[str, np.ndarray]:
    rows = [row for number in range(count) for row in replicate(number, job, STIFF)["replicates"]]
    names = [name for name in rows[0] if name.startswith("rank_")]
    return {name.removeprefix("rank_"): np.array([row[name] for row in rows]) for name in names}


def failures(found: dict[str, np.ndarray]) -> list[str]:
    return find_failing(tabulate_covered_shares(found), tabulate_ecdfs(found))


@pytest.mark.parametrize("count", [60, 100, 200, 400])
def test_the_limits_of_ten_quantities_share_one_percent(count):
    ranks = {f"q{number}": np.zeros(count, dtype=np.int64) for number in range(10)}
    limits = tabulate_covered_shares(ranks)[["count_low", "count_high"]].to_numpy()
    # 0.01 over ten quantities, of each four levels and an ECDF: half of it at either end
    error = 0.01 / (10 * 5)
    levels = np.tile([0.5, 0.8, 0.9, 0.95], 10)
    expected = [scipy.stats.binom.ppf(end, count, levels) for end in (error / 2, 1 - error / 2)]
    np.testing.assert_array_equal(limits, np.transpose(expected))


@pytest.mark.sweep
def test_needles_of_the_model_itself_are_calibrated():
    found = run(small_job(), 25)
    assert set(found) == {"mu1_pa", "bevel_mm", "stiff_design", "stiff_fit", "tip_mm", "log_likelihood"}
    assert failures(found) == []


def infer_with_understated_errors(problem, recipe, count, rng):
    noise = replace(problem.dataset.noise, registration_mean=0.7 * problem.dataset.noise.registration_mean)
    sure = tuple(replace(one, pose_angle_sd=0.7 * one.pose_angle_sd) for one in problem.insertions)
    likelihood = problem.likelihood.model_copy(update={"noise_scale": 0.7})
    wrong = replace(problem, dataset=replace(problem.dataset, noise=noise), insertions=sure)
    return infer_posterior(replace(wrong, likelihood=likelihood), recipe, count, rng)


def take_the_prior(problem, recipe, count, rng):
    thetas = draw_from_prior(problem.parameters, 2 * count, rng)
    thetas = thetas[np.isfinite(problem.log_posteriors(thetas))][:count]
    return Draws(thetas, "importance"), thetas[0]


@pytest.mark.sweep
@pytest.mark.parametrize(("wrong", "count"), [(infer_with_understated_errors, 80), (take_the_prior, 20)])
def test_a_wrong_posterior_is_noticed(wrong, count, monkeypatch):
    monkeypatch.setattr(calibration, "infer_posterior", wrong)
    assert failures(run(small_job(), count))


def test_the_rank_is_the_number_of_smaller_draws():
    draws = np.array([[1.0, 7.0], [2.0, 7.0], [3.0, 7.0]])
    assert rank_truth(np.array([2.5, 6.0]), draws, np.random.default_rng(0)).tolist() == [2, 0]
    ties = [rank_truth(np.array([2.5, 7.0]), draws, np.random.default_rng(n))[1] for n in range(40)]
    assert {*ties} == {0, 1, 2, 3}


def test_exact_posteriors_pass_and_narrow_ones_fail():
    """A Gaussian toy: data with sd 1 about a truth with sd 1, the posterior known exactly."""
    rng = np.random.default_rng(3)
    truth = rng.normal(size=500)
    middle = 0.5 * (truth + rng.normal(size=500))

    def ranked(width: float) -> dict[str, np.ndarray]:
        draws = middle[:, None] + width * np.sqrt(0.5) * rng.normal(size=(500, RANK_DRAWS))
        placed = [rank_truth(t[None], d[:, None], rng)[0] for t, d in zip(truth, draws, strict=True)]
        return {"x": np.array(placed)}

    assert failures(ranked(1.0)) == []
    assert failures(ranked(0.7)) == ["x"] and failures(ranked(1.4)) == ["x"]


def test_a_simultaneous_band_covers_its_nominal_fraction():
    low, high = ecdf_band(60, 80, 0.1)
    drawn = np.random.default_rng(1).integers(0, 80, (10000, 60))
    below = np.stack([(drawn < place).sum(axis=1) for place in range(1, 80)], axis=1)
    held = np.mean(np.all((below >= low) & (below <= high), axis=1))
    assert 0.9 <= probability_inside(60, low, high) < 0.92
    assert held == pytest.approx(probability_inside(60, low, high), abs=0.01)


@pytest.mark.parametrize("pose", ["known", "free"])
def test_without_errors_a_measured_needle_is_the_likelihood_s_own(pose):
    """Its residuals are 0: arc lengths and deflections are what the likelihood takes them for."""
    job = small_job()
    still = replace(job.dataset, noise=replace(job.dataset.noise, registration_mean=0.0), pose=pose)
    for one in job.folds[0].tune:
        sure = replace(one, pose_angle_sd=0.0)
        quiet = {**SEEN, "noise_scale": 1e-9}
        seen = simulate_measurement(still, sure, quiet, job.medium, np.random.default_rng(2))
        problem = Problem(still, (seen,), job.medium, job.parameters, job.recipe.weights)
        residuals = problem.compute_misfits(problem.parameters.theta(SEEN))
        assert np.abs(residuals).max() < (1e-3 if pose == "known" else 0.05)


def test_depths_err_as_stated_and_the_noise_s_scale_is_drawn_too():
    job = small_job(scale="estimated", depth_sd=0.4)
    one = job.folds[0].tune[0]
    quiet = replace(job.dataset, noise=Noise(point_sd=1e-6))
    sure = replace(one, pose_angle_sd=0.0)
    rng = np.random.default_rng(5)
    ends = [simulate_measurement(quiet, sure, SEEN, job.medium, rng).points[0, 0] for _ in range(300)]
    assert np.std(ends) == pytest.approx(0.4, rel=0.15)  # the entry's place moves along


def test_tip_tracks_are_refused():
    job = small_job()
    held = replace(job.dataset, insertions=(track("run", GUIDE),))
    with pytest.raises(ConfigError, match="tip tracks"):
        find_stiff_direction(replace(job, dataset=held, folds=(Fold("all", held.insertions, ()),)))


STUDY = """
schema = 2
dataset = "twin"
medium = "chicken"
recipe = "quick"
[tune]
insertions = ["chicken-01"]
[[validate]]
insertions = ["chicken-03", "chicken-02"]
"""


def prepare_study(name: str):
    record = load_study_file(find_file("study", name))
    assert record is not None
    return load_study(name, record, Settings())


@pytest.fixture
def small(tmp_path, monkeypatch):
    """A study of three insertions, in the folder that it is run in."""
    (tmp_path / "studies").mkdir()
    (tmp_path / "studies/small.toml").write_text(STUDY)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_tips_of_one_replicate_count_as_one_trial():
    """Copies of the same ranks change no count; half of each replicate covered is half of the replicates."""
    alone = np.random.default_rng(1).integers(0, RANK_DRAWS + 1, 60)
    copies = {"a": alone, "b": np.column_stack([alone] * 7)}
    for table, keys in ((tabulate_covered_shares(copies), ["covered"]), (tabulate_ecdfs(copies), ["below"])):
        one, other = (table[table["quantity"] == name] for name in ("a", "b"))
        for key in [*keys, "count_low", "count_high"]:
            assert one[key].to_numpy(dtype=float) == pytest.approx(other[key].to_numpy(dtype=float))
    assert share_by_truth(find_covered(np.array([[40, 0], [0, 40]]), 0.5)).tolist() == [0.5, 0.5]


def test_the_interval_of_a_share_has_truths_as_trials():
    """Tips that agree within a truth are one trial, those that do not are several."""
    covered = np.arange(40) < 30
    alone = estimate_share(share_by_truth(covered))
    assert alone == pytest.approx(wilson_interval(0.75, 40))
    assert estimate_share(share_by_truth(np.column_stack([covered] * 7))) == pytest.approx(alone)
    mixed = np.random.default_rng(2).random((40, 7)) < 0.75
    low, high = estimate_share(share_by_truth(mixed))
    assert low < mixed.mean() < high and high - low < 0.6 * (alone[1] - alone[0])
    assert estimate_share(np.ones(40)) == pytest.approx(wilson_interval(1.0, 40))


def test_the_true_value_of_a_tied_modulus_is_that_of_its_own_layers():
    job = prepare_study("study1")
    mu = 1e6 * draw_specimen(7, "phantom2", "phantom2").mu
    assert find_true_value(job.problem(job.folds[0]), "mu1_pa", 7) == pytest.approx(mu[0])
    assert find_true_value(job.problem(job.folds[0]), "mu4_pa", 7) == pytest.approx(mu[3])
    assert find_true_value(job.problem(job.folds[0]), "bevel_mm", 7) == pytest.approx(0.103)
    assert np.isnan(find_true_value(job.problem(job.folds[0]), "bevel_spread", 7))


def test_the_true_bevel_offset_of_a_drawn_truth_is_the_mean_of_the_insertions_fitted_to():
    job = prepare_study("study1")
    (fold,) = job.folds
    specimen = draw_specimen(9, "phantom2", "phantom2", POPULATION)
    planned = {one.id: one for one in list_designs()}
    deviations = [draw_deviations(9, planned[one.id]).bevel for one in fold.tune]
    expected = specimen.bevel * np.exp(specimen.insertion_bevel_sd * np.mean(deviations))
    found = find_true_value(job.problem(fold), "bevel_mm", 9, POPULATION)
    assert found == pytest.approx(expected) and found != pytest.approx(specimen.bevel, rel=1e-4)
    found = find_true_value(job.problem(fold), "mu2_pa", 9, POPULATION)
    assert found == pytest.approx(1e6 * specimen.mu[1])


def test_truths_outside_the_bounds_of_the_medium_are_drawn_again():
    job = load_study("study5", load_study_file(find_file("study", "study5")), Settings())
    plan, bounds = design_synthetic(job), job.parameters.bounds
    record = job.medium.model_dump(by_alias=True, exclude_unset=True)
    record["parameters"]["bevel_mm"] = {"bounds": [1e-3, 0.25]}
    narrow = Parameters.from_record(type(job.medium).model_validate(record))
    for each, limit in ((bounds, 0.5), (narrow.bounds, 0.25)):
        drawn = []
        for seed in range(40):
            pieces = [draw_specimen(seed, "chicken", f"chicken-piece{n}", POPULATION) for n in (1, 2, 3)]
            stiff = min(1e6 * one.mu[0] for one in pieces) >= 1e2  # the medium's lower bound, Pa
            drawn.append(stiff and max(one.bevel for one in pieces) <= limit)
            assert is_inside_bounds(seed, each, plan) == drawn[-1]
        assert True in drawn and False in drawn


@pytest.mark.sweep
def test_two_replicates_have_their_own_truths(small):
    record = CalibrationRecord(schema=2, kind="calibration", target="small", replicates=2, truth="synthetic")
    calibration = find_kind("calibration")
    whole = calibration.run("one", record, Settings())
    frames = whole.frames
    assert set(frames["coverage"]["quantity"]) == {HELD_OUT_TIP, "mu1_pa", "bevel_mm"}
    assert len(frames["predictions"]) == 4 and whole.metadata.not_predicted == 0
    assert frames["predictions"]["tip_pit"].between(0, 1).all()
    seeds = frames["replicates"]["seed"].unique()
    truths = frames["parameters"].query("parameter == 'mu1_pa'")["truth"]
    drawn = [1e6 * draw_specimen(int(seed), "chicken", "chicken-piece1", POPULATION).mu[0] for seed in seeds]
    assert len(seeds) == 2 and truths.to_numpy() == pytest.approx(drawn, rel=1e-6)
