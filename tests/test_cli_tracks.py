"""`needlefit validate` of a study of tip tracks, small but whole."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from test_cli import run
from track_cases import DEPTH, GUIDE, GUIDE_Z, NEEDLE, TOML, measured, measured_in_space, track, written
from world import PROJECT

from needlefit.mechanics.control import Bevel, Controls, Guide
from needlefit.mechanics.simulate import simulate
from needlefit.mechanics.tissue import Tissue
from needlefit.studies.load import load_target

STUDY = (PROJECT / "studies/tracks.toml").read_text().replace('"tips"', '"mine"').replace('"tiny"', '"few"')
RECIPE = (PROJECT / "configs/recipes/tiny.toml").read_text()
FIT = """
schema = 2
dataset = "mine"
medium = "track_gel"
recipe = "few"
tune = { guided = true }
"""
SCENE = """
schema = 2
depth_mm = 50

[needle]
length_mm = 200
flexural_rigidity_nmm2 = 2.5e4

[[layers]]
top_mm = 0
mu_pa = 3e4
alpha = 1.0

[bevel]
offset_mm = 0.03
side = 1

[controls]
guide_distance_mm = 20
"""


@pytest.fixture
def project(tmp_path, monkeypatch):
    rest = [measured(track(f"rest{n}", 0 * GUIDE), n, 0.03 + 0.004 * n, n) for n in range(4)]
    moved = [measured(track(f"moved{n}", GUIDE * (1 - n)), -n, 0.034 + 0.004 * n, 9 + n) for n in (0, 2)]
    written(tmp_path / "data/mine", [*rest, *moved])
    shutil.copytree(PROJECT, tmp_path, dirs_exist_ok=True)
    for name, text in (
        ("studies/mine", STUDY),
        ("configs/recipes/few", RECIPE.replace("[likelihood]", '[likelihood]\nnoise_scale = "estimated"')),
        ("configs/fits/moved", FIT),
        ("configs/scenes/plan", SCENE),
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / f"{name}.toml").write_text(text)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.sweep
@pytest.mark.parametrize("compared", ["plane", "space"])
@pytest.mark.usefixtures("few_draws")
def test_runs_tracked_in_space_are_predicted_along_both(project, compared):
    """Fitted along y alone, or along both: the guide's moves along z are predicted."""
    runs = [track(f"rest{n}", 0 * GUIDE, guide_z=0 * GUIDE) for n in range(4)]
    runs += [track(f"moved{n}", GUIDE * (1 - n), guide_z=GUIDE_Z) for n in (0, 2)]
    every = [measured_in_space(one, n, (0.03 + 0.004 * n, -0.02)) for n, one in enumerate(runs)]
    written(project / "data/mine", every)
    text = STUDY.replace('"track_gel"', f'"track_gel"\ncompared = "{compared}"')
    (project / "studies/mine.toml").write_text(text)
    assert run("validate mine --jobs 1 -q") in (0, 5)
    found = pd.read_csv(project / "reports/mine/readings.csv").query("scored and level == 0.95")
    count = found.groupby(["run", "direction", "method"]).size()
    assert set(found["direction"]) == {"y", "z"} and len(count) == 2 * 2 * 4
    assert set(count) == {np.sum(DEPTH > 15)}
    assert not (project / "reports/mine/predictive.csv").exists()  # no fitted run has a moved guide
    found["squared"] = (found["predicted_mm"] - found["measured_mm"]) ** 2
    error = np.sqrt(found.groupby(["direction", "method"])["squared"].mean())
    assert error["z", "prediction"] < 0.6 * error["z", "straight"]


@pytest.mark.parametrize(
    ("file", "old", "new", "key"),
    [
        ("studies/mine.toml", "validate = { guided = true }", "validate = {}", "fitted to"),
        ("data/mine/dataset.toml", "slope_sd_deg = 1.0", "", "slope_sd_deg"),
        ("studies/mine.toml", '"track_gel"', '"track_gel"\ncompared = "space"', "compared"),
        ("studies/mine.toml", "depth_mm = 15", "depth_mm = 200", "registration_depth_mm"),
    ],
)
def test_a_study_that_cannot_predict_is_refused(project, capsys, file, old, new, key):
    text = (project / file).read_text()
    (project / file).write_text(text.replace(old, new))
    assert run("validate mine -q") == 3
    assert key in capsys.readouterr().err and not (project / "reports/mine.partial").exists()


def test_a_study_of_several_fits_is_named_with_the_fit(project, capsys):
    more = STUDY.split("[[folds]]")[1].replace('"gel"', '"again"', 1)
    (project / "studies/mine.toml").write_text(f"{STUDY}\n[[folds]]{more}")
    for target in ("mine", "mine:other"):
        assert run("tune", target, "-q") == 3
        err = capsys.readouterr().err
        assert "mine:gel" in err and "mine:again" in err
    assert load_target("mine:again")[0] == "mine-again-tune"
    assert run("tune moved:gel -q") == 3  # a fit of its own has no fits
    assert run("check mine") == 0


@pytest.mark.sweep
def test_guided_runs_are_identified_like_shapes(project):
    assert run("tune moved --design --jobs 1 -q") == 0
    before = pd.read_csv(project / "reports/moved-design/identify.csv").set_index("parameter")
    assert (before.loc["mu1_pa", "determined"], before.loc["bevel_mm", "determined"]) == ("yes", "no")


@pytest.mark.usefixtures("few_draws")
def test_a_planned_needle_is_predicted_from_runs(project):
    assert run("predict mine --scene plan --jobs 1 -q") in (0, 5)  # of a short recipe
    forecast = pd.read_csv(project / "reports/predict-mine-gel-plan/forecast.csv").query("level == 0.95")
    gel = Tissue(np.array([0.03]), np.array([1.0]), np.empty(0), np.array([40.0]))
    truth = simulate(NEEDLE, gel, Bevel(0.03), 50.0, Controls(guides=(Guide(-20.0),))).tip_lateral
    assert forecast["low_mm"].iloc[-1] < truth < forecast["high_mm"].iloc[-1]


@pytest.mark.sweep
@pytest.mark.usefixtures("few_draws")
def test_runs_into_a_specimen_are_predicted_from_runs_into_others(project):
    """Each fold fits two gels, which differ, and knows nothing of the third but their spread."""
    gels, runs = ("gel", "gel2", "gel3"), []
    for n, gel in enumerate(gels):
        of_gel = (measured(track(f"{gel}-{k}", 0 * GUIDE), k, 0.01 * k, 10 * n + k) for k in range(2))
        runs += [replace(one, medium=gel) for one in of_gel]
    written(project / "data/mine", runs, TOML + "[media.gel2]\n[media.gel3]\n")
    text = STUDY.split("[[folds]]")[0].replace("same_specimen = true", 'leave_out = "specimen"')
    (project / "studies/mine.toml").write_text(text)
    assert run("validate mine --jobs 1 -q") in (0, 5)
    table = pd.read_csv(project / "reports/mine/predictive.csv").query("quantity == 'tip' and level == 0.95")
    assert table["fold"].tolist() == [f"without {gel}" for gel in gels for _ in range(2)]
    assert {*table["specimen_treatment"]} == {"others"} and {*table["other_specimens"]} == {2}
    assert table["covered"].all() and (table["between_sd_ln_mu"] > 0.05).all()
    errors = pd.read_csv(project / "reports/mine/errors.csv").query("role == 'validate'")
    assert errors.groupby("method").size().eq(6).all()


@pytest.mark.sweep
def test_steered_runs_are_left_out_in_folds(project):
    folds = STUDY.replace("tune = { guided = false }", "tune = {}\nparts = 2")
    (project / "studies/mine.toml").write_text(folds)
    assert run("validate mine --jobs 1 -q") in (0, 5)
    errors = pd.read_csv(project / "reports/mine/errors.csv")
    held = errors[errors["method"] == "steered_line"]
    assert held.set_index("insertion")["fold"].to_dict() == {"moved0": "gel-1", "moved2": "gel-2"}
    (fold, _) = json.loads((project / "reports/mine/run.json").read_text())["folds"]
    assert set(fold["tune"]) == {"rest0", "rest1", "rest2", "rest3", "moved2"}
    ends = pd.read_csv(project / "reports/mine/ends.csv").query("level == 0.95 and method == 'prediction'")
    assert set(ends.groupby("run").size()) == {4}  # after each quarter of the readings ahead
    first, *_, last = (part for _, part in ends.groupby("registered_mm"))
    assert np.all(first["measured_mm"].between(first["low_mm"], first["high_mm"]))
    wide, narrow = (part["high_mm"].sub(part["low_mm"]).mean() for part in (first, last))
    assert narrow < 0.7 * wide
