"""`needlefit validate` of a study of tip tracks, small but whole."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from made_again import assert_made_again
from test_cli import run
from track_cases import DEPTH, GUIDE, measured, track, written

from needlefit.validation.tracks.results import READING_COLUMNS, RUN_COLUMNS

STUDY = """
schema = 1
observable = "tip tracks"
title = "Mine"
dataset = "mine"
recipe = "few"
registration_depth_mm = 15

[[fits]]
name = "gel"
medium = "gel"
tune = { guided = false }
validate = { guided = true }
"""
MEDIUM = """
schema = 1
layers = 1

[parameters]
mu1_pa = { bounds = [1e3, 1e7] }
alpha1 = { fixed = 1.0 }
bevel_mm = { bounds = [1e-4, 0.3] }
guide_distance_mm = { bounds = [2.0, 100.0], prior = { median = 20.0, factor = 1.3 } }
"""
RECIPE = """
schema = 1
starts = 2

[likelihood]
noise_scale = "estimated"

[sample]
ensembles = 2
walkers = 8
steps = 40
check_interval = 40
"""


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    rest = [measured(track(f"rest{n}", 0 * GUIDE), n, 0.03 + 0.004 * n, n) for n in range(4)]
    moved = [measured(track(f"moved{n}", GUIDE * (1 - n)), -n, 0.034 + 0.004 * n, 9 + n) for n in (0, 2)]
    written(tmp_path / "data/mine", [*rest, *moved])
    for name, text in (
        ("studies/mine", STUDY),
        ("configs/media/gel", MEDIUM),
        ("configs/recipes/few", RECIPE),
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / f"{name}.toml").write_text(text)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_runs_are_predicted_scored_and_printed(project, capsys):
    assert run("validate", "mine", "--jobs", "1", "-q") == 5  # forty steps are no posterior, and it says so
    out = capsys.readouterr().out
    assert "SYNTHETIC data" in out and "NOT CONVERGED" in out and "the fit is" in out
    folder = project / "reports/mine"
    runs, readings = (pd.read_csv(folder / f"{name}.csv") for name in ("runs", "readings"))
    assert tuple(runs.columns) == (*RUN_COLUMNS, "origin") and tuple(readings.columns) == (
        *READING_COLUMNS,
        "origin",
    )
    held = runs[runs["role"] == "validate"]
    assert set(held["run"]) == {"moved0", "moved2"} and set(held["readings"]) == {np.sum(DEPTH > 15)}
    shape = held.groupby("method")["aligned_rms_mm"].mean()
    assert shape["fitted"] < 0.5 * shape["straight"]  # the truth is the model's own, and the guide moved
    assert not readings.loc[~readings["scored"], "median_mm"].notna().any()
    record = json.loads((folder / "run.json").read_text())
    assert str(project) not in json.dumps(record) and record["fits"]["gel"]["tune"][0] == "rest0"
    deep = pd.read_csv(folder / "depths.csv").query("method == 'fitted'")
    assert list(deep["from_mm"]) == [20.0, 40.0, 60.0] and deep["readings"].sum() == 2 * np.sum(DEPTH > 15)
    names = {path.name for path in folder.iterdir()}
    assert {
        "report.pdf",
        "readings.pdf",
        "readings.csv",
        "posterior-gel.nc",
        "paired.csv",
        "depths.csv",
    } <= names
    assert_made_again(folder)


def test_a_run_that_both_tunes_and_validates_is_refused(project, capsys):
    (project / "studies/mine.toml").write_text(STUDY.replace("validate = { guided = true }", "validate = {}"))
    assert run("validate", "mine", "-q") == 3
    err = capsys.readouterr().err
    assert all(f"rest{n}" in err for n in range(4))


def test_a_guide_out_of_the_needle_s_reach_is_refused(project, capsys):
    (project / "configs/media/gel.toml").write_text(MEDIUM.replace("[2.0, 100.0]", "[2.0, 160.0]"))
    assert run("validate", "mine", "-q") == 3
    assert " 200 mm " in capsys.readouterr().err


def test_other_commands_name_the_one_that_runs_it(project, capsys):
    assert run("tune", "mine", "-q") == 3
    assert "needlefit validate mine\n" in capsys.readouterr().err
    assert run("check", "mine") == 0


def test_a_study_with_nothing_to_predict_is_refused_before_anything_runs(project, capsys):
    (project / "studies/mine.toml").write_text(
        STUDY.replace("registration_depth_mm = 15", "registration_depth_mm = 200")
    )
    assert run("validate", "mine", "-q") == 3
    assert "registration_depth_mm" in capsys.readouterr().err
    assert not (project / "reports/mine.partial").exists()
