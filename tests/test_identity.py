"""Each key of a study or dataset decides the identity of a fit, or is listed not to."""

import json
import shutil
import tomllib
from pathlib import Path

import pytest
import track_cases
import trimesh
from light_runs import draw_blank, predict_by_few_draws
from test_cli import run
from test_datasets import without_checksums
from world import copy_project

from needlefit.datasets.digests import _READ
from needlefit.project.locate import shipped_folder
from needlefit.project.toml import dumps
from needlefit.schemas import dataset as dataset_schemas
from needlefit.schemas import medium, recipe, study
from needlefit.schemas.deciding import UNDECIDING, select_deciding
from needlefit.studies.identity import JUDGING, RESOLVED, describe_configuration, identify
from needlefit.studies.job import Settings
from needlefit.studies.load import load_study, load_study_file

IDS = [f"phantom2-{n:02}" for n in (1, 2, 4, 7, 8, 9)]
STUDY = f"""
schema = 2
dataset = "./shapes"
medium = "./gel.toml"
recipe = "./recipe.toml"
margin_mm = 0.5
margin_for = "a test"
tune.insertions = {IDS[:4]}
validate = [{{ insertions = {IDS[4:5]} }}]
"""
TRACKS = """
schema = 2
dataset = "./tips"
medium = "./track_gel.toml"
recipe = "./recipe.toml"
registration_depth_mm = 15.0
folds = [{ name = "gel", tune = { guided = false }, validate = { guided = true } }]
"""
TRACK_GEL = """
schema = 1
layers = 1
parameters.mu1_pa.bounds = [1e3, 1e7]
parameters.alpha1.fixed = 1.0
parameters.bevel_mm.bounds = [1e-4, 0.3]
"""
RECIPE = """
schema = 2
likelihood = {}
sample.walkers = 12
"""
PRIOR = """
schema = 1
alpha = { mean = 1.0, sd = 0.1 }
mu_pa = { median = 3e5, factor = 1.5 }
"""


def write_shapes(folder):
    """Copy six insertions of the shipped dataset."""
    shutil.copytree(shipped_folder() / "data" / "twin", folder)
    without_checksums(folder / "dataset.toml")
    head, *rows = (folder / "insertions.csv").read_text().splitlines()
    rows = [row for row in rows if row.split(",")[0] in IDS]
    depth = head.split(",").index("depth_mm")
    rows = [f"{row},{0.01 * float(row.split(',')[depth]):.4f}" for row in rows]
    text = "\n".join([f"{head},other", *rows]) + "\n"
    (folder / "insertions.csv").write_text(text)
    (folder / "other.csv").write_text(text.replace("+1", "-1"))


def leave_out_a_point(path):
    lines = path.read_text().splitlines(True)
    path.write_text("".join(lines[:5] + lines[6:]))


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """A study of shapes and one of tip tracks, and further files for edits."""
    folder = tmp_path_factory.mktemp("identity")
    shapes, tips = folder / "shapes", folder / "tips"
    write_shapes(shapes)
    shutil.copytree(shapes, folder / "other")
    edit(folder / "other/dataset.toml", "", {"needle.youngs_modulus_gpa": 81.0})
    for part in ("centerlines", "sections"):
        shutil.copytree(shapes / part, shapes / f"other_{part}")
    for path in (*(shapes / "other_centerlines").iterdir(), *(folder / "other/centerlines").iterdir()):
        leave_out_a_point(path)
    for path in (shapes / "other_sections").iterdir():
        path.write_text(path.read_text().replace("sigma_mm = 0.0", "sigma_mm = 0.1"))
    moved = trimesh.load_mesh(shapes / "layers/phantom2_interface1.stl").apply_translation([0.05, 0.0, 0.0])
    moved.export(shapes / "layers/other.stl")
    (shapes / "turns.csv").write_text("id,depth_mm,bevel_roll_deg\nphantom2-01,20,180\n")
    (shapes / "curvature.csv").write_text(
        "id,s_mm,kappa_y_1_per_mm,kappa_z_1_per_mm,sd_1_per_mm\nphantom2-01,5,0.001,0,0.0001\n"
    )
    still = [track_cases.track(f"rest{n}", 0 * track_cases.GUIDE) for n in range(2)]
    runs = [*still, track_cases.track("moved", track_cases.GUIDE)]
    track_cases.written(tips, [track_cases.measured(one, n, 0.03, n) for n, one in enumerate(runs)])
    edit(tips / "dataset.toml", "", {"media.gel.layers": [1]})
    head, *rows = (tips / "steps.csv").read_text().splitlines()
    rows = [f"{row},{float(row.split(',')[3]) + 0.01:.4f}" for row in rows]
    text = "\n".join([f"{head},other", *rows]) + "\n"
    (tips / "steps.csv").write_text(text)
    (tips / "other.csv").write_text(text.replace("rest0", "first"))
    gel = (shipped_folder() / "configs/media/phantom2.toml").read_text()
    files = {"s": STUDY, "tracks": TRACKS, "gel": gel, "other_gel": f"thickness_mm = 30.0\n{gel}"}
    files |= {"track_gel": TRACK_GEL, "recipe": RECIPE, "other_recipe": f"starts = 3\n{RECIPE}"}
    for name, text in {**files, "prior": PRIOR}.items():
        (folder / f"{name}.toml").write_text(text)
    return folder


def load(folder, study="s"):
    path = folder / f"{study}.toml"
    return load_study(study, load_study_file(path), Settings(file=path))


@pytest.fixture(scope="module")
def known(project):
    """The identity of each study as it stands."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(project)
        return {name: identify(load(project, name)) for name in ("s", "tracks")}


def edit(path, place, changes):
    """Change dotted keys below a place of a TOML file; None removes one."""
    table = tomllib.loads(path.read_text())
    for dotted, value in changes.items():
        *parents, key = filter(None, [*place.split("."), *dotted.split(".")])
        within = table
        for parent in parents:
            within = within[int(parent)] if isinstance(within, list) else within.setdefault(parent, {})
        within.pop(key, None)
        if value is not None:
            within[key] = value
    path.write_text(dumps(table))


# ---- every key


@pytest.mark.parametrize(
    "record",
    [
        *(study.StudyRecord, medium.MediumRecord, medium.ParameterRecord),
        *(recipe.RecipeRecord, recipe.LikelihoodRecord),
        *(dataset_schemas.DatasetRecord, dataset_schemas.FrameRecord, dataset_schemas.NoiseRecord),
        *(dataset_schemas.MeasurementRecord, dataset_schemas.DatasetMediumRecord),
    ],
)
def test_each_key_of_a_table_decides_or_is_listed_not_to(record):
    blank = dict.fromkeys(record.model_fields)
    for name in blank:
        one, other = (record.model_construct(**blank | {name: value}) for value in (None, "other"))
        assert (select_deciding(one) != select_deciding(other)) == (name not in UNDECIDING), name


GUIDED, FREE = {"folds.0.tune.guided": True, "folds.0.validate.guided": False}, {"frame.pose": "free"}
THIN = {"length_mm": 120.0, "flexural_rigidity_nmm2": 2e3}
#: edits of keys that count by what is read or selected for them, or by how predictions are judged
EDITS = {
    ("s", "s.toml"): (
        *({"dataset": "./other"}, {"medium": "./other_gel.toml"}, {"recipe": "./other_recipe.toml"}),
        *({"priors": {"1": "./prior.toml"}}, {"paper_parameters": "phantom2"}, {"fix": {"mu1": 1e5}}),
        *({"compared": "space"}, {"tune.insertions": IDS[:3]}, {"tune.depth_min_mm": 50.0}),
        *({"leave_out": "insertion", "validate": None}, {"margin_mm": 0.6}, {"same_specimen": True}),
    ),
    ("s", "recipe.toml"): ({"aiming_width_mm": 3.0},),
    ("s", "shapes/dataset.toml"): (
        *({"root": "../other"}, {"needle.length_mm": 151.0}, {"insertions.file": "other.csv"}),
        {"needles.thin": THIN, "insertions.constants": {"needle": "thin"}},
        *({"insertions.columns": {name: "other"}} for name in ("pose_shift_sd_mm", "scan_x_mm")),
        {"insertions.constants": {"hole": "one"}},
        *({"insertions.turns": "turns.csv"}, {"insertions.curvature": "curvature.csv"}),
        {"centerlines.pattern": "other_centerlines/{id}.csv"},
        {"measurement.sections": "other_sections/{id}.toml"},
        *({"media.phantom2.surfaces.0.file": "layers/other.stl"}, {"noise.point_sd_mm": 0.02}),
    ),
    ("tracks", "tracks.toml"): (GUIDED, {"registration_depth_mm": 16.0}),
    ("tracks", "tips/dataset.toml"): (
        *({"tip_tracks.file": "other.csv"}, {"tip_tracks.columns.tip_mm": "other"}),
        *({"tip_tracks.constants": {"bevel_side": -1}}, {"tip_tracks.depth_zero": "tissue"}),
        *({"media.gel.specimen": "other"}, {"noise.slope_sd_deg": 2.0}, {"needle.length_mm": 201.0}),
    ),
}
ROWS = [(*place, changes) for place, every in EDITS.items() for changes in every]


@pytest.mark.parametrize(("study_name", "file", "changes"), ROWS)
def test_what_counts_by_what_is_read_decides_too(
    study_name, file, changes, project, known, tmp_path, monkeypatch
):
    folder = shutil.copytree(project, tmp_path / "project")
    edit(folder / file, "", changes)
    monkeypatch.chdir(folder)
    assert identify(load(folder, study_name)).sha256 != known[study_name].sha256


def test_each_key_that_counts_by_what_is_read_is_edited():
    edited = {part for *_, changes in ROWS for dotted in changes for part in dotted.split(".")}
    selected = {"tune", "validate_", "layer_count_rule", "media"}
    assert RESOLVED | JUDGING | {*_READ} <= edited | selected


# ---- what does not decide, and what is said of what does


def test_a_copy_with_comments_other_names_and_needles_that_are_not_fitted_has_the_same_identity(
    project, known, tmp_path, monkeypatch
):
    folder = tmp_path / "elsewhere"
    shutil.copytree(project, folder)
    (folder / "s.toml").rename(folder / "renamed.toml")
    for path in folder.rglob("*.toml"):
        table = tomllib.loads(path.read_text())
        path.write_text(f"# comment\n\n{dumps(dict(reversed(table.items())))}")
    table = folder / "shapes/insertions.csv"
    lines = table.read_text().splitlines(True)
    table.write_text("".join(one for one in lines if not one.startswith(IDS[5])))
    monkeypatch.chdir(folder)
    assert identify(load(folder, "renamed")) == known["s"]
    works = []
    for seed in (1, 1, 2):
        edit(folder / "recipe.toml", "", {"seed": seed})
        works.append(describe_configuration(load(folder, "renamed")).work)
    assert works[0] == works[1] != works[2]  # of an interrupted run, which goes on or does not


def test_the_fit_of_a_study_does_not_know_what_is_held_out(project, tmp_path, monkeypatch):
    folder = tmp_path / "project"
    shutil.copytree(project, folder)
    monkeypatch.chdir(folder)

    def identities():
        record = load_study_file(folder / "s.toml")
        return [identify(load_study("s", one, Settings())).sha256 for one in (record.tuning(), record)]

    fit, study = identities()
    edit(folder / "s.toml", "", {"validate": [{"insertions": IDS[5:]}], "margin_mm": 0.7})
    assert identities()[0] == fit and identities()[1] != study


# ---- verdicts


@pytest.fixture
def validated(world, tmp_path, monkeypatch):
    """A copy of the project with a study that was validated, and a fit."""
    # before figures are blank: other tests read these runs
    folder = copy_project(world, tmp_path / "project", "cross_validation", "fit")
    monkeypatch.chdir(folder)
    draw_blank(monkeypatch)
    predict_by_few_draws(monkeypatch)
    return folder


def predict():
    """Predict with the study; return what its result knows of the verdict."""
    assert run("predict ./studies/held_out.toml --scene ahead --quiet --jobs 1") in (0, 5)
    return json.loads(Path("reports/predict-held_out-ahead/run.json").read_text())


@pytest.mark.sweep
def test_a_posterior_of_another_fit_is_not_used(validated, capsys):
    line = "predict gel --scene ahead --quiet --jobs 1"
    result = Path("reports/predict-gel-ahead/run.json")
    assert run(line) in (0, 5)
    assert json.loads(result.read_text())["draw_source"] == "posterior"
    edit(validated / "configs/recipes/tiny.toml", "", {"starts": 3})
    capsys.readouterr()
    assert run(line) in (0, 5)
    found = json.loads(result.read_text())
    assert found["draw_source"] == "importance" and found["fit_verdict"] is None
    assert "needlefit tune gel" in capsys.readouterr().err
