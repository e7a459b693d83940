"""Predictions of planned insertions: what draws and measurement make of them, and what is refused."""

import json
from dataclasses import replace

import numpy as np
import pytest
from made_again import assert_made_again
from test_cli import run

import needlefit
from needlefit.errors import ConfigError, DataError
from needlefit.inference.draws import Draws, thin_posterior
from needlefit.inference.optimize import minimize
from needlefit.inference.sampling.convergence import Convergence
from needlefit.inference.sampling.posterior import Posterior
from needlefit.inference.sampling.sample import sample
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.shape import compute_positions
from needlefit.project.load import load
from needlefit.project.locate import find_file
from needlefit.reporting.forecast import lay_out_forecast, summarize_tip, tabulate_forecast
from needlefit.reporting.table_files import write_json
from needlefit.schemas.recipe import LikelihoodRecord, SampleRecord
from needlefit.schemas.study import FitRecord
from needlefit.validation.forecast import draw_parameters, forecast, require_same_configuration
from needlefit.validation.job import Settings, prepare
from needlefit.validation.provenance import describe_configuration

SCENE = needlefit.open_scene("study2")


@pytest.fixture(scope="module")
def job():
    record = load(find_file("fit", "phantom2"), FitRecord).model_copy(update={"recipe": "quick"})
    small = record.tune.model_copy(update={"insertions": ("phantom2-15", "phantom2-16")})
    return prepare("small", record.model_copy(update={"tune": small}), Settings())


def planned(job, thetas, scene=SCENE):
    return forecast(scene, Draws(np.array(thetas), "importance"), job)


def sure(job):
    """The same, its depths of layers and tip known exactly."""
    exact = tuple(replace(one, depth_sd=0.0, boundary_sd=0.0) for one in job.dataset.insertions)
    return replace(job, dataset=replace(job.dataset, insertions=exact))


def theta(job, **changes):
    values = {"mu1_pa": 2e5, "mu2_pa": 3e7, "bevel_mm": 0.08, **changes}
    return job.parameters.theta(values)


def test_one_draw_is_the_scene_with_its_parameters(job):
    found = planned(sure(job), [theta(job)] * 3)
    tissue = replace(SCENE.tissue, mu=np.array([0.2, 30.0, 0.2, 30.0]), alpha=np.array([1.0, -1, 1, -1]))
    (step,) = SCENE.steps
    step = replace(step, bevel=replace(step.bevel, offset=0.08))
    shape = needlefit.simulate_steps(SCENE.needle, tissue, (step,), SCENE.rules)
    expected = compute_positions(shape, found.s)
    assert found.needle.means[0] == pytest.approx(expected[:, 1], abs=1e-6)
    table = tabulate_forecast(found)
    assert table["needle_95_low_mm"].iloc[-1] == pytest.approx(expected[-1, 1], abs=1e-6)
    half = table["measured_95_high_mm"].iloc[-1] - table["measured_median_mm"].iloc[-1]
    assert half == pytest.approx(1.959964 * found.measured.sd[-1], rel=1e-3)
    assert found.measured.sd[-1] > found.measured.sd[0] > 0  # the pose's angle tells on the tip


def test_bands_are_quantiles_of_draws(job):
    found = planned(sure(job), [theta(job, bevel_mm=b) for b in np.linspace(0.06, 0.10, 101)])
    tips = np.sort(found.needle.means[:, -1])
    low, high = tabulate_forecast(found).iloc[-1][["needle_50_low_mm", "needle_50_high_mm"]]
    assert tips[24] <= low <= tips[26] and tips[74] <= high <= tips[76]


def test_an_impossible_prediction_is_refused(job):
    other = replace(SCENE, needle=Needle(150.0, 2e4))
    with pytest.raises(ConfigError, match="flexural rigidity"):
        planned(job, [theta(job)], other)
    deep = replace(
        SCENE.tissue,
        mu=np.full(5, 1.0),
        alpha=np.ones(5),
        boundaries=np.array([5.0, 10, 15, 20]),
        thickness=np.full(5, 40.0),
        friction=np.zeros(5),
    )
    with pytest.raises(ConfigError, match="5 layers"):
        planned(job, [theta(job)], replace(SCENE, tissue=deep))


def test_depths_that_err_widen_the_needle_s_band(job):
    exact, open_ = (planned(one, [theta(job)] * 200).needle.means[:, -1] for one in (sure(job), job))
    assert np.ptp(exact) < 1e-9
    # a layer 0.1 mm deeper moves such a tip by a tenth of a millimetre or two
    assert 0.02 < np.std(open_) < 0.5


def test_the_scale_of_the_noise_widens_what_is_measured(job):
    doubled = job.recipe.likelihood.model_copy(update={"noise_scale": 2.0})
    wide = replace(job, recipe=job.recipe.model_copy(update={"likelihood": doubled}))
    one, two = (planned(sure(each), [theta(job)] * 3).measured.sd for each in (job, wide))
    assert two == pytest.approx(2 * one)


def test_draws_of_a_posterior_are_spread_over_it(job):
    names = job.parameters.free
    values = np.exp(np.linspace(np.log(1e4), np.log(1e6), 80)).reshape(4, 20, 1) * np.ones(len(names))
    values[:, :, names.index("bevel_mm")] = 0.05
    many = np.full((4, 3), 500.0)
    found = Convergence(names, np.ones(3), np.ones((4, 3)), many, many, 4)
    posterior = Posterior(names, values, np.zeros((4, 20)), 5, "de", np.ones(4), found, 0, 0, False)
    thetas = thin_posterior(posterior, job.parameters, 10).thetas
    assert thin_posterior(posterior, job.parameters, 10).faults == posterior.faults != ()
    assert thetas[[0, -1], 0] == pytest.approx(np.log([1e4, 1e6]))
    assert np.exp(thetas[:, names.index("bevel_mm")]) == pytest.approx(0.05)


def test_a_prediction_from_an_unconverged_posterior_is_flagged(job):
    draws = Draws(np.array([theta(job)] * 3), "posterior", ("R-hat of mu1_pa is 1.2",))
    found = forecast(SCENE, draws, job)
    layout = lay_out_forecast(found, "gel", False)
    assert "NOT CONVERGED" in layout.caption and "R-hat of mu1_pa is 1.2" in " ".join(layout.notes)
    assert summarize_tip(found)["not_converged"] == ["R-hat of mu1_pa is 1.2"]


def test_a_posterior_of_other_data_is_refused(job, tmp_path):
    record = {key: describe_configuration(job)[key] for key in ("medium", "folds", "dataset", "recipe")}
    write_json(tmp_path / "run.json", record)
    require_same_configuration(job, tmp_path)
    write_json(tmp_path / "run.json", record | {"dataset": {}})
    with pytest.raises(ConfigError, match="another dataset"):
        require_same_configuration(job, tmp_path)
    other = job.recipe.model_copy(update={"likelihood": LikelihoodRecord(noise="independent")})
    write_json(tmp_path / "run.json", record)
    with pytest.raises(ConfigError, match="another likelihood"):
        require_same_configuration(replace(job, recipe=other), tmp_path)
    (tmp_path / "run.json").write_text("{")
    with pytest.raises(DataError):
        require_same_configuration(job, tmp_path)


def test_a_run_that_is_named_must_hold_a_posterior(job, tmp_path):
    with pytest.raises(ConfigError, match=r"no posterior\.nc"):
        draw_parameters(job, tmp_path, Settings(), required=True)


def test_an_interrupted_search_predicts_nothing_and_an_early_end_is_flagged(job, tmp_path):
    assert draw_parameters(job, tmp_path, Settings(stop=lambda: True)) is None
    short = replace(job, recipe=job.recipe.model_copy(update={"evaluations": 4}))
    found = draw_parameters(short, tmp_path, Settings())
    assert "minimum" in found.faults[0] and "(budget)" in found.faults[0]


@pytest.mark.slow
def test_importance_draws_match_the_posterior(job, tmp_path):
    """Weighed draws and walked ones have the same middle and width, in the stiff and the sloppy direction."""
    problem = job.problem(job.folds[0])
    drawn = draw_parameters(job, tmp_path, Settings()).thetas
    fit = minimize(problem, job.recipe, np.random.default_rng(1))
    walked = sample(problem, fit.theta, SampleRecord(steps=400, check_interval=200), np.random.default_rng(2))
    thetas = thin_posterior(walked, job.parameters, 2000).thetas
    axes = np.linalg.eigh(np.cov(thetas.T))[1]
    for direction in axes.T:
        one, two = drawn @ direction, thetas @ direction
        assert np.median(one) == pytest.approx(np.median(two), abs=0.35 * np.std(two))
        assert np.std(one) == pytest.approx(np.std(two), rel=0.3)


def test_the_command(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    fit = find_file("fit", "phantom2").read_text(encoding="utf-8").replace('"default"', '"quick"')
    (tmp_path / "gel.toml").write_text(fit + 'insertions = ["phantom2-15", "phantom2-16"]\n')
    words = ("predict", "./gel.toml", "--scene", "study2", "--depth", "30", "-q")
    assert run(*words, "--json") == 0
    output = json.loads(capsys.readouterr().out)
    assert output["draw_source"] == "importance" and output["draws"] + output["failed_solves"] == 400
    tip = output["tip"]
    assert tip["s_mm"] == 30
    assert tip["needle_95_low_mm"] < tip["needle_median_mm"] < tip["needle_95_high_mm"]
    assert tip["measured_95_low_mm"] < tip["needle_95_low_mm"]
    folder = tmp_path / "reports" / "predict-gel-study2"
    first = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert set(first) == {"forecast.csv", "forecast.pdf", "results.json.gz", "run.json", "needlefit.json"}
    assert_made_again(folder)
    assert run(*words, "--jobs", "1") == 0
    assert "synthetic" in capsys.readouterr().out
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == first
