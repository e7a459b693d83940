"""What a name shows: the same needle as the model's, with the parameters that it says."""

import contextlib
import dataclasses
import json

import needles
import numpy as np
import pytest
from inference_cases import dataset, insertion, medium
from light_runs import predict_by_few_draws
from made_again import store
from pytest import approx

from needlefit.errors import ConfigError, DataError
from needlefit.inference.forward_model import make_simulation_inputs
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.simulate import simulate_steps
from needlefit.planning.insertion_scene import make_scene_record
from needlefit.project.locate import find_file
from needlefit.schemas.scene import SceneRecord
from needlefit.schemas.study import StudyRecord
from needlefit.studies.job import Settings
from needlefit.studies.kinds.cross_validation.run import run
from needlefit.studies.run import TUNED_SPECIMENS, pack, restore_run
from needlefit.viewer.opening import open_target

VALUES = {"mu1_pa": 3e5, "alpha1": 1.2, "mu2_pa": 2e7, "alpha2": -1.0, "bevel_mm": 0.08}
GEL = """schema = 1
layers = 2
[parameters]
mu1_pa = { bounds = [3e4, 3e6] }
alpha1 = { fixed = 1.0 }
mu2_pa = { tie = "50 * mu1_pa" }
alpha2 = { bounds = [-3.0, 5.0], prior = { mean = -1.0, sd = 0.5 } }
bevel_mm = { bounds = [0.01, 0.25] }
"""
FIT = GEL.replace('{ tie = "50 * mu1_pa" }', "{ fixed = 2e7 }").replace(
    "{ bounds = [-3.0, 5.0], prior = { mean = -1.0, sd = 0.5 } }", "{ fixed = -1.0 }"
)
RECIPE = "schema = 1\nstarts = 2\nevaluations = 100\ntolerance = 1e-6\n"


def run_study(folder, recipe, compared=None):
    """Run and store a study of the needles of a project, fitted to one piece; return what it found."""
    for name, text in (("media/gel", GEL), ("media/fit", FIT), ("recipes/short", recipe)):
        path = folder / "configs" / f"{name}.toml"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    asked = {"dataset": "needles", "medium": "fit", "recipe": "short", "tune": {"specimens": ["piece1"]}}
    asked |= {"schema": 1, "validate": [{"specimens": ["piece2"]}], "compared": compared}
    study = StudyRecord.model_validate(asked)
    results = run("small", study, Settings())
    put(results, folder / "reports" / "small")
    return results


def put(results, folder):
    folder.mkdir(parents=True, exist_ok=True)
    store(results, folder)
    (folder / "run.json").write_text(json.dumps(results.run_json))
    return str(folder)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A project with a dataset, a medium of its name, and a run of a study."""
    folder = tmp_path_factory.mktemp("project")
    needles.build(folder / "data" / "needles")
    with contextlib.chdir(folder), pytest.MonkeyPatch.context() as patch:
        predict_by_few_draws(patch)
        run_study(folder, RECIPE)
    return folder


@pytest.fixture
def project(made, monkeypatch):
    monkeypatch.chdir(made)
    return made


def rules(**changes):
    return medium().model_copy(update=changes)


ONE, TWO = insertion(24.3), insertion(41.7, [17.2], (1, 2), side=-1)
AGAIN = insertion(38.0, [12.0, 21.5], (1, 2, 1))


@pytest.mark.parametrize(
    ("one", "record"),
    [
        (ONE, medium()),
        (TWO, medium()),
        (AGAIN, rules(thickness_mm=20.0, law="linear")),
        (dataclasses.replace(TWO, guide_distance=12.0), medium()),
        (dataclasses.replace(TWO, base_moved=-1.5), rules(constraint_spacing_mm=2.5)),
        (TWO, rules(constraint_switch=0.2, tangent_part=0.5, first_cell_mm=0.4)),
    ],
)
def test_an_insertion_as_a_scene_is_the_predicted_needle(one, record):
    scene = make_scene_record(VALUES, record, dataset([one]).name, one)
    again = SceneRecord.model_validate_json(scene.model_dump_json(by_alias=True))
    scene = Scene.from_record(again)
    needle, tissue, steps, sharp = make_simulation_inputs(VALUES, record, one)
    assert scene.steps == steps and dataclasses.replace(scene.rules, tolerance=sharp.tolerance) == sharp
    sharper = simulate_steps(scene.needle, scene.tissue, scene.steps, sharp)
    expected = simulate_steps(needle, tissue, steps, sharp)
    assert np.array_equal(sharper.u, expected.u) and np.array_equal(sharper.x, expected.x)
    # a scene is solved to 1e-7 mm, a prediction further, as searches take its derivatives
    coarser = simulate_steps(scene.needle, scene.tissue, scene.steps, scene.rules)
    np.testing.assert_allclose(coarser.u, expected.u, rtol=0, atol=1e-7)


def test_draws_beside_a_scene_are_checked(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text(find_file("scene", "phantom1").read_text("utf-8"))
    assert open_target(str(path)).spread is None
    beside = tmp_path / "own.draws.csv"
    head = "mu1_pa,mu2_pa,mu3_pa,mu4_pa,bevel_mm,alpha1\n"
    beside.write_text(f"{head}2e5,3e5,4e5,5e5,0.1,3\n3e5,1e5,1e5,1e5,0.2,2\n")
    spread = open_target(str(path)).spread
    assert spread.mu[0].tolist() == approx([0.2, 0.3, 0.4, 0.5])
    assert spread.bevel.tolist() == [0.1, 0.2] and spread.shape[:, 0, 0].tolist() == [3.0, 2.0]
    for damaged in ("mu1_pa\n2e5\n", head, f"{head}-1,3e5,4e5,5e5,0.1,3\n", f"{head}2e5,3e5,4e5,5e5,,3\n"):
        beside.write_text(damaged)
        with pytest.raises(DataError):
            open_target(str(path))


def test_without_a_fit_the_medium_s_middle_is_where_tuning_by_hand_begins(project):
    viewed_scene = open_target("needles")
    first, second = viewed_scene.record.layers
    assert first.mu_pa == approx(3e5) and second.mu_pa == approx(1.5e7)  # the tie holds
    assert second.alpha == approx(-1.0)  # the prior's peak, not the middle of the bounds
    assert viewed_scene.record.bevel.offset_mm == approx(0.05)
    assert "medium gel" in viewed_scene.note


def test_a_run_shows_its_fit_starting_with_a_held_out_insertion(project):
    results = restore_run(project / "reports/small")
    viewed_scene = open_target("small")
    assert viewed_scene.name == "small/needle-3"
    assert viewed_scene.note != open_target("reports/small/needle-1").note  # held out, and fitted to
    assert len(viewed_scene.fitted_depths) == len(results.metadata.folds[0].tune)
    rows = results.frames["parameters"].query("method == 'fitted'").set_index("parameter")["value"]
    assert viewed_scene.record.bevel.offset_mm == rows["bevel_mm"]
    assert [layer.mu_pa for layer in viewed_scene.record.layers] == [rows["mu1_pa"], rows["mu2_pa"]]
    draws = results.frames["draws"]
    draws = draws[(draws["fold"] == draws["fold"].iloc[0]) & (draws["specimen"] == TUNED_SPECIMENS)]
    plain = open_target("small", specimen="same").spread
    assert np.array_equal(plain.mu[:, 0], draws["mu1_pa"] * 1e-6)
    deviations = (plain.bevel / draws["bevel_mm"] - 1) / draws["bevel_spread"]
    # b is the mean of two bevels
    assert abs(deviations.mean()) < 0.3 and deviations.std() == approx(np.sqrt(1.5), abs=0.2)


def test_the_band_of_a_new_specimen_is_as_wide_as_the_run_predicted_it(project):
    row = restore_run(project / "reports/small").frames["predictive"].set_index("insertion").loc["needle-3"]
    assert row["specimen_treatment"] == "others"
    new, same = (open_target("small", specimen=one).spread for one in ("new", "same"))
    # One specimen was tuned on: another one's ln mu differs by N(0, 2 tau^2), tau half-normal.
    rng, known = np.random.default_rng(3), np.log(same.mu[:, 0])
    tau = row["between_sd_ln_mu"] * np.abs(rng.standard_normal((100, len(known))))
    ends = np.quantile(known + np.sqrt(2) * tau * rng.standard_normal(tau.shape), [0.1, 0.25, 0.75, 0.9])
    off = np.quantile(np.log(new.mu[:, 0]), [0.1, 0.25, 0.75, 0.9]) - ends
    assert np.all(np.abs(off) < [0.3, 0.15, 0.15, 0.3])  # three standard errors of 400 draws
    assert set(new.mu[:, 1]) == set(same.mu[:, 1])  # fixed in the medium
    with pytest.raises(ConfigError, match="nobody"):
        open_target("small", specimen="nobody")


def test_a_run_of_data_that_changed_or_of_another_kind_is_refused(project, tmp_path):
    results = restore_run(project / "reports/small")
    first, *_ = (identity := results.metadata.identity).insertions
    other = identity.model_copy(update={"insertions": identity.insertions | {first: "0"}})
    files = results.metadata.dataset.model_copy(update={"sha256": "0"})
    put(results.with_metadata(identity=other, dataset=files), tmp_path)
    with pytest.raises(DataError, match="changed"):
        open_target(str(tmp_path))
    pack({"kind": "identification"}, tmp_path)
    with pytest.raises(DataError, match="fitted needle"):
        open_target(str(tmp_path))
