"""The Python API: the same computations as the commands', from names, paths and objects in memory."""

import doctest
import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from docs_scripts import load_script
from pytest import approx
from refusals import refusal
from research.fits import estimate_evidence, score_study

import needlefit
from needlefit import api
from needlefit.errors import ConfigError
from needlefit.inference import optimize
from needlefit.inference import prior_shift as held
from needlefit.project.locate import find_file, shipped_folder
from needlefit.studies import fold_draws, from_memory
from needlefit.studies.kinds.prediction import run as prediction

TUNE = {"insertions": ["chicken-04"]}
RECIPE = {"starts": 1, "metric": False, "likelihood": {"depths": "fixed"}}
SAMPLE = {"walkers": 8, "densities": 160}


@pytest.fixture(scope="module")
def dataset():
    return needlefit.load_dataset("twin")


@pytest.fixture(scope="module")
def fitted(dataset):
    return needlefit.fit(dataset, "chicken", tune=TUNE, recipe=RECIPE)


@pytest.fixture(scope="module")
def sampled(fitted):
    return needlefit.sample(fitted, recipe={**RECIPE, "sample": SAMPLE})


DOCTEST_OPTIONS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS
DOCS = shipped_folder() / "docs"


@pytest.mark.sweep
@pytest.mark.skipif(not DOCS.is_dir(), reason="not run from the repository")
@pytest.mark.filterwarnings(r"ignore:\sArviZ is:FutureWarning")  # once a day, where corner imports it
def test_the_page_prints_what_it_shows(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(DOCS)
    page = load_script(DOCS / "python_page.py")
    found = page.run_page(tmp_path)
    assert found.attempted > 20 and found.failed == 0 and (tmp_path / page.PICTURE).is_file()


def test_the_docstrings_print_what_they_show():
    found = doctest.testmod(api, extraglobs={"needlefit": needlefit}, optionflags=DOCTEST_OPTIONS)
    assert found.attempted > 3 and found.failed == 0


@pytest.mark.sweep
@pytest.mark.usefixtures("blank_figures")
def test_a_run_is_saved_loaded_and_predicted_from(sampled, tmp_path, monkeypatch):
    monkeypatch.setattr(prediction, "PREDICTION_DRAWS", 100)
    assert needlefit.load_run(sampled.save(tmp_path / "run")).metadata == sampled.metadata
    here = needlefit.predict(sampled, "chicken")
    there = needlefit.predict(needlefit.load_run(tmp_path / "run"), find_file("scene", "chicken"), jobs=1)
    assert here.kind == "prediction" and here.metadata.draw_source == "posterior"
    assert here.metadata.specimen == "others" and here.metadata.fit_verdict
    np.testing.assert_array_equal(
        here.frames["forecast"].filter(like="_mm"), there.frames["forecast"].filter(like="_mm")
    )


@pytest.mark.usefixtures("few_draws")
def test_draws_outside_the_model_determine_nothing(world, monkeypatch):
    from needlefit.studies.kinds.cross_validation import fold as cross_validation
    from needlefit.studies.needle_placement import FittedDraws

    monkeypatch.chdir(world.folder)
    known = needlefit.fit("gel").frames["parameters"].query("method == 'fitted'")
    outside = FittedDraws(np.ones(400, dtype=bool), {})
    monkeypatch.setattr(cross_validation, "simulate_fitted_draws", lambda *args, **given: outside)
    found = needlefit.fit("gel").frames["parameters"].query("method == 'fitted'")
    assert "yes" in set(known["determined"]) and not {"yes", "only together"} & set(found["determined"])
    assert found["value"].tolist() == known["value"].tolist()


@pytest.mark.usefixtures("few_draws", "blank_figures")
def test_a_freed_alpha_is_drawn_and_predicted_with(world, monkeypatch, tmp_path):
    monkeypatch.chdir(world.folder)
    monkeypatch.setattr(prediction, "PREDICTION_DRAWS", 100)
    found = needlefit.fit("gel", free=["alpha1"], fix={"mu2": 1.5e7})
    assert found.metadata.study["free"] == ["alpha1"] and found.metadata.study["fix"] == {"mu2_pa": 1.5e7}
    parameters = found.metadata.medium.parameters
    assert parameters["alpha1"].bounds == (-7.0, 9.0) and parameters["mu2_pa"].fixed == 1.5e7
    row = found.frames["identification"].set_index("parameter").loc["alpha1"]
    assert row["fisher_sd"] == approx(row["prior_sd"], rel=1e-3) and row["prior_sd"] == 2.0
    drawn = found.frames["draws"]
    assert drawn["alpha1"].between(-7, 9).all() and drawn["alpha1"].std() > 1.5
    assert set(drawn["alpha2"]) == {-1.0} and set(drawn["mu2_pa"]) == {1.5e7}
    # a bound says nothing of an alpha that may have any value within its bounds
    assert not [one for one in found.warnings if "alpha1" in one.what]
    refusal(ConfigError, "mu1", needlefit.fit, found, free=["mu1"])  # is free there


@pytest.mark.usefixtures("few_draws")
def test_alpha_is_freed_where_draws_alone_show_that_it_moves_points(dataset, monkeypatch):
    moved = []

    def record(*given):
        found = held.measure_shifts(*given)
        moved.append(found["alpha1"].in_noise)
        return found

    monkeypatch.setattr(optimize, "measure_shifts", record)
    monkeypatch.setattr(fold_draws, "measure_shifts", record)
    monkeypatch.setattr(fold_draws, "SHIFT_DRAWS", 60)

    def fit(**changes):
        run = needlefit.fit(dataset, "chicken", tune=TUNE, recipe=RECIPE, name="one", jobs=1, **changes)
        return run.frames["parameters"].query("method == 'fitted'").set_index("parameter")

    assert fit().loc["alpha1", "status"] == "prior"
    at_fit, over_draws = moved
    assert 0 < at_fit < over_draws < 0.1
    monkeypatch.setattr(held, "MAX_HIDDEN_SHIFT", (at_fit + over_draws) / 2)
    freed, asked = fit(), fit(free=["alpha1"])
    assert moved[2:] == [at_fit, over_draws]  # of the fit that asked for it nothing is held
    assert freed.loc["alpha1", "status"] == "free" and math.isnan(freed.loc["alpha1", "tip_shift_mm"])
    numbers = ["value", "median", "sd", "interval_low", "interval_high"]
    pd.testing.assert_frame_equal(freed[numbers], asked[numbers])


@pytest.mark.parametrize(
    "call",
    [
        lambda: needlefit.load_dataset("nothing"),
        lambda: needlefit.load_run("nothing"),
        lambda: needlefit.fit(needlefit.load_dataset("twin")),
        lambda: needlefit.fit("twin", "chicken", tune={"layer": 3}),
        lambda: needlefit.fit("twin", "chicken", recipe={"starts": "many"}),
        lambda: needlefit.fit("twin", "chicken", fix={"b": "thick"}),
        lambda: needlefit.fit("twin", "chicken", free="alpha1"),
        lambda: needlefit.predict("chicken", {"depth": 1}),
        lambda: needlefit.validate("all"),
        lambda: needlefit.open_scene({"needle": 3}),
        lambda: needlefit.write_prior("prior.toml", [1, 2], [[-1, 2], [2, 1]]),
    ],
)
def test_wrong_input_is_a_config_error(call):
    refusal(ConfigError, "", call)


def test_the_public_names_alone_are_listed():
    assert dir(needlefit) == sorted(needlefit.__all__)


def test_of_several_media_the_one_with_the_name_of_the_tissue_model_is_fitted(dataset):
    fitted = from_memory.open_fit("twin", "phantom1", stored=False)
    assert fitted.record.tune.medium == "phantom1" and "phantom1" in fitted.record.note
    other = from_memory.open_fit("twin", "gel_wax", stored=False).record
    assert other.tune.medium is None and not other.note
    refusal(
        ConfigError,
        r"1 layer, insertion .* meets layer",
        needlefit.fit,
        "twin",
        "chicken",
        tune={"medium": "phantom2"},
        recipe=RECIPE,
    )


def test_a_changed_dataset_is_refused(dataset):
    one, *others = dataset.insertions
    moved = replace(dataset, insertions=(one.with_points(one.points + 1.0), *others))
    for changed in (moved, replace(dataset, insertions=(one,))):
        refusal(
            ConfigError,
            "not what its files hold",
            needlefit.fit,
            changed,
            "chicken",
            tune=TUNE,
            recipe=RECIPE,
        )


def test_errors_of_a_study_are_those_of_validate_and_change_with_the_tissue_model(world, monkeypatch):
    monkeypatch.chdir(world.folder)
    found = score_study("held_out")
    keys, metrics = ["role", "insertion", "method"], ["ipe_mean_mm", "te_mm", "floor_te_mm"]
    scored = found.set_index(keys)[metrics].sort_index()
    run = world.restore("cross_validation").frames["errors"]
    stored = run[run["boundaries"] == "measured"].set_index(keys)[metrics].sort_index()
    pd.testing.assert_frame_equal(scored, stored.loc[scored.index], check_exact=False, rtol=1e-9)
    stiffer = api.load_medium("gel") | {"constraint_spacing_mm": 2.0}
    changed = score_study("held_out", medium=stiffer).set_index(keys)["te_mm"].sort_index()
    fitted = ("validate", "needle-3", "fitted")
    assert changed.loc[fitted] != approx(scored.loc[fitted, "te_mm"], rel=1e-3)
    refusal(ConfigError, "", score_study, "design")
    refusal(ConfigError, "", needlefit.validate, "plan", medium=stiffer)


@pytest.mark.sweep
@pytest.mark.usefixtures("few_draws")
def test_models_are_compared_by_what_they_predict_of_insertions_left_out(sampled):
    recipe = {**RECIPE, "sample": {"independent_draws": 1000}}
    names = [f"chicken-0{number}" for number in range(3, 8)]
    run = needlefit.sample("twin", "chicken", tune={"insertions": names}, recipe=recipe)
    found = needlefit.estimate_elpd(run, leave_out="insertion")
    assert found.index.tolist() == names and (found["pareto_k"] < 0.7).all()
    # exactly it is the evidence of all insertions, less that of the others
    whole, rest = (
        estimate_evidence("twin", "chicken", tune={"insertions": some}, recipe=recipe)["log_evidence"]
        for some in (names, names[1:])
    )
    assert found["elpd"].iloc[0] == approx(whole - rest, abs=0.2)
    for wrong in (sampled, replace(run, posteriors={})):
        refusal(ConfigError, "", needlefit.estimate_elpd, wrong)
