"""Each key of a study or dataset decides the identity of a fit, or is listed not to."""

import json
import shutil
import tomllib
from inspect import isclass
from pathlib import Path
from typing import Literal, get_args, get_origin

import numpy as np
import pytest
import track_cases
from light_runs import draw_blank, predict_by_few_draws
from needles import BEVEL, INTERFACE, MU, NEEDLE
from pydantic import BaseModel
from test_cli import run

from needlefit import Bevel, Tissue, simulate
from needlefit.datasets.columns import InsertionRow
from needlefit.datasets.write import write_dataset
from needlefit.errors import ConfigError
from needlefit.geometry.frames import make_entry_frame
from needlefit.geometry.smoothing_spline import SplineSections, make_knots
from needlefit.geometry.surfaces import make_cylinder, make_sheet
from needlefit.mechanics.shape import sample_inserted_points
from needlefit.project.checkpoint import open_checkpoint, release_checkpoint
from needlefit.project.folders import sha256, write_manifest
from needlefit.project.toml import dumps
from needlefit.schemas.dataset import DatasetRecord
from needlefit.schemas.deciding import UNDECIDING, select_deciding
from needlefit.schemas.medium import MediumRecord, ParameterRecord
from needlefit.schemas.recipe import LikelihoodRecord, RecipeRecord
from needlefit.schemas.study import StudyRecord
from needlefit.studies.identity import describe_change, identify
from needlefit.studies.job import Settings
from needlefit.studies.load import load_study
from needlefit.studies.provenance import describe_configuration
from needlefit.studies.store import pack, restore_run, store_run, unpack
from needlefit.studies.study_files import load_study_file

ROOTS = (StudyRecord, DatasetRecord)
DEPTHS = {"n1": 24.0, "n2": 30.5, "n3": 36.25, "n4": 41.0, "n5": 33.0, "n6": 15.0}
NEEDLE_TABLE = {"length_mm": 150, "outer_diameter_mm": 1.27, "youngs_modulus_gpa": 80}
DATASET = {
    "schema": 1,
    "name": "shapes",
    "origin": "synthetic",
    "license": "MIT",
    "source": "made by a test",
    "frame": {"name": "world"},
    "needle": NEEDLE_TABLE,
    "noise": {"point_sd_mm": 0.05},
    "insertions": {"file": "insertions.csv"},
    "centerlines": {"pattern": "centerlines/{id}.csv"},
    "measurement": {"operator": "spline", "sections": "sections/{id}.toml"},
    "media": {
        "gel": {
            "surfaces": [
                {"file": "layers/gel.stl", "kind": "sheet", "into": 2},
                {"file": "layers/deep.stl", "kind": "sheet", "into": 2},  # which no needle reaches
            ]
        },
        "flat": {"boundaries_mm": [INTERFACE]},
    },
}
STUDY = {
    "schema": 2,
    "dataset": "./shapes",
    "medium": "./gel.toml",
    "recipe": "./recipe.toml",
    "margin_mm": 0.5,
    "margin_for": "a test",
    "tune": {"insertions": ["n1", "n2", "n3", "n5", "n6"], "layers": [2]},
    "validate": [{"insertions": ["n4"]}],
}
FOLDS = {"name": "all", "tune": {"layers": [2]}, "validate": {"insertions": ["n1", "n2"]}}
MEDIUM = {
    "schema": 1,
    "layers": 2,
    "parameters": {
        "mu1_pa": {"bounds": [3e4, 3e6], "prior": {"median": 3e5, "factor": 2.0}},
        "alpha1": {"bounds": [0.5, 2.0], "prior": {"mean": 1.0, "sd": 0.2}},
        "mu2_pa": {"tie": "60 * mu1_pa", "spread": 1.2},
        "alpha2": {"fixed": -1.0},
        "bevel_mm": {"bounds": [0.02, 0.3]},
    },
}
TRACK_MEDIUM = {
    "schema": 1,
    "layers": 2,
    "parameters": {
        "mu1_pa": {"bounds": [1e3, 1e7]},
        "mu2_pa": {"bounds": [1e3, 1e7]},
        "alpha1": {"fixed": 1.0},
        "alpha2": {"fixed": 1.0},
        "bevel_mm": {"bounds": [1e-4, 0.3]},
    },
}
TRACKS = {
    "schema": 2,
    "dataset": "./tips",
    "medium": "./track_gel.toml",
    "recipe": "./recipe.toml",
    "registration_depth_mm": 15.0,
    "folds": [{"name": "gel", "tune": {"guided": False}, "validate": {"guided": True}}],
}
RECIPE = {"schema": 2, "likelihood": {}, "sample": {"walkers": 12}}


def write_shapes(folder, bevel=BEVEL):
    tissue = Tissue(mu=np.array(MU), alpha=np.array([1.0, -1.0]), boundaries=np.array([INTERFACE]))
    rows, curves, sections = [], {}, {}
    for n, (name, depth) in enumerate(DEPTHS.items()):
        origin, x, y = np.array([0.0, 3.0 * n, 0.0]), np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
        points = sample_inserted_points(simulate(NEEDLE, tissue, Bevel(bevel, 1), depth), 61)
        curve = curves[name] = make_entry_frame(origin, x, y).to_world(points)
        s = np.linspace(0.0, depth, len(curve))
        knots = make_knots(0.0, depth, 8.0)
        sections[name] = SplineSections(s, s, curve, np.ones(len(s)), knots, sigma=0.05, shared_sd=0.0)
        deep = depth > INTERFACE
        row = InsertionRow(
            id=name, medium="gel" if n < 4 else "flat", layers=1 + deep, depth=depth,
            layers_alternative=1 if name == "n2" else None, specimen=f"piece{n // 2 + 1}",
            entry=origin, direction=x, bevel=y, pose_source="stage",
        )  # fmt: skip
        rows.append(row)
    record = DatasetRecord.model_validate(DATASET)
    places = {"gel": INTERFACE, "deep": 60.0, "other": INTERFACE - 0.5}
    surfaces = {
        f"layers/{name}.stl": make_sheet(name, [x, 0, 0], [1, 0, 0], 200.0, 2) for name, x in places.items()
    }
    surfaces["layers/solid.stl"] = make_cylinder("gel", ([INTERFACE, 0, 0], [60.0, 0, 0]), 100.0, 2)
    write_dataset(folder, record, rows, curves, surfaces, checksums=False, sections=sections)
    text = add_column(folder / "insertions.csv", -2)
    (folder / "other.csv").write_text(text.replace("24.0000", "24.0100"))
    state_checksum(folder, "layers/gel.stl", DATASET)


def add_column(path, copied):
    """Add a column `other` to a table, which only edits of `columns` read; return its text."""
    head, *lines = path.read_text().splitlines()
    values = [float(line.split(",")[copied]) + 0.01 for line in lines]
    lines = [f"{line},{value:.6f}" for line, value in zip(lines, values, strict=True)]
    path.write_text("\n".join([f"{head},other", *lines]) + "\n")
    return path.read_text()


def state_checksum(folder, name, table):
    table = table | {"checksums": {name: sha256(folder / name)}}
    (folder / "dataset.toml").write_text(dumps(table))


def write_tracks(folder):
    still = [
        track_cases.measured(track_cases.track(f"rest{n}", 0 * track_cases.GUIDE), n, 0.03, n)
        for n in range(3)
    ]
    moved = track_cases.measured(track_cases.track("moved", track_cases.GUIDE), -1, 0.034, 9)
    track_cases.written(folder, [*still, moved])
    text = add_column(folder / "steps.csv", 3)
    (folder / "other.csv").write_text(text.replace("rest0", "first"))
    table = tomllib.loads((folder / "dataset.toml").read_text()) | {"media": {"gel": {"layers": [1]}}}
    state_checksum(folder, "steps.csv", table)


def write_long_table(folder):
    """Shapes of unknown pose in one table."""
    folder.mkdir()
    x = np.linspace(0.0, 40.0, 41)
    lines = [
        f"{run},gel,2,40,{a},{bend * a**2:.6f},{0.1 * bend * a**2:.6f}"
        for run, bend in (("a", 1e-3), ("b", 1.2e-3), ("c", 1.1e-3))
        for a in x
    ]
    text = "\n".join(["run,medium,layers,depth_mm,x_mm,y_mm,z_mm", *lines]) + "\n"
    (folder / "needles.csv").write_text(text)
    (folder / "other.csv").write_text(text.replace("a,gel,2,40,1.0,", "a,gel,2,40,1.01,"))
    kept = {key: DATASET[key] for key in ("schema", "origin", "license", "source", "needle", "noise")}
    table = kept | {
        "name": "long",
        "frame": {"pose": "free"},
        "insertions": {"id_template": "{run}"},
        "centerlines": {"file": "needles.csv", "group_by": ["run"]},
        "media": {"gel": {"boundaries_mm": [INTERFACE]}},
    }
    (folder / "dataset.toml").write_text(dumps(table))


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """Studies of shapes and of tip tracks, and further files for edits."""
    folder = tmp_path_factory.mktemp("identity")
    write_shapes(folder / "shapes")
    write_shapes(folder / "other", 1.01 * BEVEL)
    for part in ("centerlines", "sections"):
        shutil.copytree(folder / "other" / part, folder / "shapes" / f"other_{part}")
    shapes = folder / "shapes"
    (shapes / "turns.csv").write_text("id,depth_mm,bevel_roll_deg\nn1,20,180\n")
    (shapes / "curvature.csv").write_text(
        "id,s_mm,kappa_y_1_per_mm,kappa_z_1_per_mm,sd_1_per_mm\nn1,5,0.001,0,0.0001\n"
    )
    write_long_table(folder / "long")
    write_tracks(folder / "tips")
    parameters = MEDIUM["parameters"]
    prior = {"schema": 1, "alpha": {"mean": 1.0, "sd": 0.1}, "mu_pa": {"median": 3e5, "factor": 1.5}}
    files = {
        "s": STUDY,
        "folds": {k: v for k, v in STUDY.items() if k not in ("tune", "validate", "margin_mm", "margin_for")}
        | {"folds": [FOLDS]},
        "tracks": TRACKS,
        "long": {key: STUDY[key] for key in ("schema", "medium", "recipe")}
        | {"dataset": "./long", "leave_out": "insertion", "same_specimen": True},
        "gel": MEDIUM,
        "other_gel": MEDIUM | {"parameters": parameters | {"alpha2": {"fixed": 1.0}}},
        "track_gel": TRACK_MEDIUM,
        "recipe": RECIPE,
        "other_recipe": RECIPE | {"starts": 3},
        "prior": prior,
    }
    for name, table in files.items():
        (folder / f"{name}.toml").write_text(dumps(table))
    return folder


def load(folder, study="s"):
    path = folder / f"{study}.toml"
    return load_study(study, load_study_file(path), Settings(file=path))


@pytest.fixture(scope="module")
def known(project):
    """The identity of each study as it stands."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(project)
        return {name: identify(load(project, name)) for name in ("s", "folds", "tracks", "long")}


# ---- every key

SHAPES, TIPS = "shapes/dataset.toml", "tips/dataset.toml"
#: of a table: the study that reads it, its file, and where it stands there
PLACES = {
    **dict.fromkeys(("FileRecord", "FitRecord", "StudyRecord"), ("s", "s.toml", "")),
    "SelectionRecord": ("s", "s.toml", "tune"),
    "FoldsRecord": ("folds", "folds.toml", "folds.0"),
    **dict.fromkeys(("SourceRecord", "DatasetRecord"), ("s", SHAPES, "")),
    "FrameRecord": ("s", SHAPES, "frame"),
    "NeedleRecord": ("s", SHAPES, "needle"),
    "NoiseRecord": ("s", SHAPES, "noise"),
    "InsertionsRecord": ("s", SHAPES, "insertions"),
    "CenterlinesRecord": ("s", SHAPES, "centerlines"),
    "MeasurementRecord": ("s", SHAPES, "measurement"),
    "DatasetMediumRecord": ("s", SHAPES, "media.flat"),
    "SurfaceRecord": ("s", SHAPES, "media.gel.surfaces.0"),
    "TipTracksRecord": ("tracks", TIPS, "tip_tracks"),
}

FREE = {"frame.pose": "free", "measurement": None, "media.gel": {"boundaries_mm": [INTERFACE]}}
LONG = "long/dataset.toml"
#: edits of keys that no other value suits alone, by dotted keys; None removes one. A key whose plain edit
#: means nothing in its own place names another place.
EDITS = {
    "FileRecord.schema_": {"schema": 1},
    "FitRecord.dataset": {"dataset": "./other"},
    "FitRecord.medium": {"medium": "./other_gel.toml"},
    "FitRecord.recipe": {"recipe": "./other_recipe.toml"},
    "FitRecord.priors": {"priors": {"1": "./prior.toml"}},
    "FitRecord.paper_parameters": {"paper_parameters": "phantom1"},
    "FitRecord.free": {"free": ["alpha2"]},
    "FitRecord.fix": {"fix": {"mu1": 1e5}},
    "FitRecord.compared": {"compared": "space"},
    "SelectionRecord.medium": {"medium": "gel"},
    "SelectionRecord.layers": {"layers": [1, 2]},
    "SelectionRecord.specimens": {"specimens": ["piece1"]},
    "SelectionRecord.insertions": {"insertions": ["n1", "n2", "n3"]},
    "SelectionRecord.depth_min_mm": {"depth_min_mm": 30},
    "SelectionRecord.depth_max_mm": {"depth_max_mm": 30},
    "SelectionRecord.guided": (
        *("tracks", "tracks.toml", "folds.0"),
        {"tune.guided": True, "validate.guided": False},
    ),
    "StudyRecord.leave_out": {"leave_out": "insertion", "validate": None},
    "FoldsRecord.parts": {"parts": 2},
    "SourceRecord.truth": {"truth": {"mu1_pa": 3e5}},
    "SourceRecord.root": {"root": "../other"},
    "FrameRecord.pose": ("s", SHAPES, "", FREE),
    "FrameRecord.lps_to_world": {"lps_to_world": [[1, 0, 0, 5], [0, 1, 0, 0], [0, 0, 1, 0]]},
    "NeedleRecord.flexural_rigidity_nmm2": {
        "flexural_rigidity_nmm2": 1e4,
        "outer_diameter_mm": None,
        "youngs_modulus_gpa": None,
    },
    "NoiseRecord.heading_sd_deg": ("tracks", TIPS, "noise", {"heading_sd_deg": 1.0}),
    "NoiseRecord.slope_sd_deg": ("tracks", TIPS, "noise", {"slope_sd_deg": 2.0}),
    "InsertionsRecord.file": {"file": "other.csv"},
    "InsertionsRecord.id_template": ("long", LONG, "", {"insertions.id_template": "other-{run}"}),
    "InsertionsRecord.columns": {"columns": {"depth_sd_mm": "other"}},
    "InsertionsRecord.constants": {"constants": {"hole": "one"}},
    "InsertionsRecord.turns": {"turns": "turns.csv"},
    "InsertionsRecord.curvature": {"curvature": "curvature.csv"},
    "CenterlinesRecord.pattern": {"pattern": "other_centerlines/{id}.csv"},
    "CenterlinesRecord.file": ("long", LONG, "centerlines", {"file": "other.csv"}),
    "CenterlinesRecord.group_by": (
        *("long", LONG, ""),
        {"centerlines.group_by": ["run", "medium"], "insertions.id_template": "{run}-{medium}"},
    ),
    "CenterlinesRecord.columns": ("long", LONG, "centerlines", {"columns": {"y_mm": "z_mm", "z_mm": "y_mm"}}),
    "MeasurementRecord.operator": {"operator": "none", "sections": None},
    "MeasurementRecord.sections": {"sections": "other_sections/{id}.toml"},
    **{
        f"MeasurementRecord.{key}": ("s", SHAPES, "", {"measurement": {"operator": operator, **values}})
        for key, operator, values in (
            ("knot_spacing_mm", "spline", {"knot_spacing_mm": 5.0}),
            ("width_mm", "gaussian", {"width_mm": 1.0}),
            ("bias_sd_mm", "unknown", {"bias_sd_mm": 0.1, "bias_length_mm": 10.0}),
            ("bias_length_mm", "unknown", {"bias_sd_mm": 0.1, "bias_length_mm": 20.0}),
        )
    },
    "DatasetRecord.import_": {"import": {"files": {"table.csv": "0"}}},
    "DatasetRecord.checksums": {"checksums": None},
    "SurfaceRecord.file": {"file": "layers/other.stl"},
    "SurfaceRecord.kind": {"kind": "solid", "file": "layers/solid.stl"},
    "SurfaceRecord.into": ("s", SHAPES, "media.gel.surfaces.1", {"into": 1}),
    "DatasetMediumRecord.boundaries_mm": {"boundaries_mm": [18.5]},
    "TipTracksRecord.file": {"file": "other.csv"},
    "TipTracksRecord.columns": {"columns.tip_mm": "other"},
    "TipTracksRecord.constants": {"constants": {"bevel_side": -1}},
    **{
        f"DatasetMediumRecord.{key}": ("tracks", TIPS, "media.gel", {key: value})
        for key, value in {"layers": [2], "specimen": "other"}.items()
    },
}


def find_record(annotation):
    """The record within an annotation, also in a list or a table."""
    if isclass(annotation) and issubclass(annotation, BaseModel):
        return annotation
    return next((found for one in get_args(annotation) if (found := find_record(one))), None)


def list_keys():
    """Every key of these files and of the tables within them, by the table that states it."""
    found = {}

    def walk(record):
        for name, field in record.model_fields.items():
            owner = next(one for one in record.__mro__ if name in vars(one).get("__annotations__", ()))
            inner = find_record(field.annotation)
            if name == "units":  # it has one value
                continue
            if name in UNDECIDING or inner is None:
                found[owner, name] = field
            elif inner not in within:
                within.add(inner)
                walk(inner)

    within: set[type[BaseModel]] = set()
    for root in ROOTS:
        walk(root)
    return found


def change(value, annotation):
    """Another value of a key."""
    options = [one for part in (annotation, *get_args(annotation)) for one in _literals(part)]
    if options:
        return next(one for one in options if one != value)
    kinds = {annotation, *get_args(annotation)}
    if bool in kinds:
        return not value
    if int in kinds:
        return (value or 0) + 1
    if float in kinds:
        return 1.01 * value if value else 0.01
    assert str in kinds, annotation
    return f"{value or ''}x"


def _literals(annotation):
    return get_args(annotation) if get_origin(annotation) is Literal else ()


def locate(table, keys):
    for key in filter(None, keys):
        table = table[int(key)] if isinstance(table, list) else table.setdefault(key, {})
    return table


def edit(path, place, changes):
    """Change dotted keys below a place of a TOML file."""
    table = tomllib.loads(path.read_text())
    for dotted, value in changes.items():
        *parents, key = filter(None, [*place.split("."), *dotted.split(".")])
        within = locate(table, parents)
        within.pop(key, None)
        if value is not None:
            within[key] = value
    path.write_text(dumps(table))


KEYS = {f"{owner.__name__}.{name}": (name, field) for (owner, name), field in list_keys().items()}


@pytest.mark.parametrize("key", KEYS)
def test_each_key_decides_the_identity_or_is_listed_not_to(key, project, known, tmp_path, monkeypatch):
    name, field = KEYS[key]
    edits = EDITS.get(key)
    *place, changes = edits if isinstance(edits, tuple) else (*PLACES[key.partition(".")[0]], edits)
    study, file, where = place
    folder = tmp_path / "project"
    shutil.copytree(project, folder)
    if changes is None:
        stated = locate(tomllib.loads((folder / file).read_text()), where.split("."))
        default = None if field.is_required() else field.get_default(call_default_factory=True)
        alias = field.alias or name
        changes = {alias: change(stated.get(alias, default), field.annotation)}
    edit(folder / file, where, changes)
    monkeypatch.chdir(folder)
    found = identify(load(folder, study))
    decides = name not in UNDECIDING or key == "FoldsRecord.name"
    assert (found.sha256 != known[study].sha256) == decides, changes


@pytest.mark.parametrize("record", [MediumRecord, ParameterRecord, RecipeRecord, LikelihoodRecord])
def test_each_key_of_a_tissue_model_and_a_recipe_decides_or_is_listed_not_to(record):
    blank = dict.fromkeys(record.model_fields)
    for name in blank:
        one, other = (record.model_construct(**blank | {name: value}) for value in (None, "other"))
        assert (select_deciding(one) != select_deciding(other)) == (name not in UNDECIDING), name


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
    table.write_text("".join(one for one in table.read_text().splitlines(True) if not one.startswith("n6,")))
    edit(folder / "renamed.toml", "", {"tune": {"insertions": ["n1", "n2", "n3", "n5"]}})
    monkeypatch.chdir(folder)
    assert identify(load(folder, "renamed")) == known["s"]


def test_the_fit_of_a_study_does_not_know_what_is_held_out(project, tmp_path, monkeypatch):
    folder = tmp_path / "project"
    shutil.copytree(project, folder)
    monkeypatch.chdir(folder)

    def identities():
        record = load_study_file(folder / "s.toml")
        return [identify(load_study("s", one, Settings())).sha256 for one in (record.tuning(), record)]

    fit, study = identities()
    edit(folder / "s.toml", "", {"validate": [{"insertions": ["n6"]}], "margin_mm": 0.7})
    assert identities()[0] == fit and identities()[1] != study


def test_what_changed_is_named(project, tmp_path, monkeypatch):
    folder = tmp_path / "project"
    shutil.copytree(project, folder)
    monkeypatch.chdir(folder)
    before = identify(load(folder))
    edit(folder / "s.toml", "", {"tune.insertions": ["n1", "n2", "n6"], "tune.layers": None})
    edit(folder / "recipe.toml", "", {"starts": 3})
    edit(folder / "gel.toml", "", {"thickness_mm": 30.0})
    points = folder / "shapes/centerlines/n2.csv"
    points.write_text(points.read_text().replace("0.0000", "0.0001", 1))
    words = describe_change(before, identify(load(folder)))
    named = [
        one for one in (*DEPTHS, "removed", "added", "recipe", "tissue model", "options") if one in words
    ]
    assert named == ["n2", "n3", "n5", "n6", "removed", "added", "recipe", "tissue model"]
    assert (
        "n3, n5 removed" in words and "n2 with other data" in words and describe_change(before, before) == ""
    )


def test_an_interrupted_run_goes_on_with_the_same_identity_alone(project, tmp_path, monkeypatch):
    folder, kept = tmp_path / "project", tmp_path / "s.partial"
    shutil.copytree(project, folder)
    monkeypatch.chdir(folder)
    open_checkpoint(kept, False, describe_configuration(load(folder)).work).keep_row("fit", {"n": 1})
    edit(folder / "s.toml", "", {"title": "Another"})
    assert open_checkpoint(kept, True, describe_configuration(load(folder)).work).rows("fit") == [{"n": 1}]
    edit(folder / "recipe.toml", "", {"seed": 2})
    with pytest.raises(ConfigError):
        open_checkpoint(kept, True, describe_configuration(load(folder)).work)
    release_checkpoint(kept)


# ---- verdicts


@pytest.fixture
def validated(world, tmp_path, monkeypatch):
    """A copy of the project with a study that was validated, and a fit."""
    folder = tmp_path / "project"
    for kind in ("cross_validation", "fit"):  # before figures are blank: other tests read these runs
        result = world.find(kind)
        shutil.copytree(result, folder / "reports" / result.name)
    for part in ("configs", "data", "studies"):
        shutil.copytree(world.folder / part, folder / part)
    monkeypatch.chdir(folder)
    draw_blank(monkeypatch)
    predict_by_few_draws(monkeypatch)
    return folder


def predict():
    """Predict with the study; return what its result knows of the verdict."""
    words = ("predict", "./studies/held_out.toml", "--scene", "ahead", "--quiet", "--jobs", 1)
    assert run(*words) in (0, 5)
    return json.loads(Path("reports/predict-held_out-ahead/run.json").read_text())


def forget_identity(folder):
    """Make a stored result one of an earlier version."""
    table = unpack(folder)
    del table["run"]["identity"]
    pack({key: value for key, value in table.items() if key != "format"}, folder)
    write_manifest(folder)


def test_a_result_of_an_earlier_version_is_reported_and_its_verdict_is_not_repeated(validated, capsys):
    forget_identity(validated / "reports/held_out")
    found = predict()
    assert found["fit_verdict"] is None and "earlier version" in found["fit_changed"]
    assert "needlefit validate ./studies/held_out.toml" in capsys.readouterr().err
    assert run("report", "reports/held_out", "--quiet") == 0
    assert run("diff", "reports/held_out", "reports/held_out") == 0


def test_a_posterior_of_another_fit_is_not_used(validated, capsys):
    words = ("predict", "gel", "--scene", "ahead", "--quiet", "--jobs", 1)
    result = Path("reports/predict-gel-ahead/run.json")
    assert run(*words) in (0, 5)
    assert json.loads(result.read_text())["draw_source"] == "posterior"
    edit(validated / "configs/recipes/tiny.toml", "", {"starts": 3})
    capsys.readouterr()
    assert run(*words) in (0, 5)
    found = json.loads(result.read_text())
    assert found["draw_source"] == "importance" and found["fit_verdict"] is None
    assert "needlefit tune gel" in capsys.readouterr().err


def test_diff_names_what_changed(validated, capsys):
    before = restore_run(validated / "reports/held_out")
    edit(validated / "configs/recipes/tiny.toml", "", {"starts": 3})
    job = load(validated / "studies", "held_out")
    other = before.with_metadata(identity=identify(job))
    shutil.copytree(validated / "reports/held_out", validated / "reports/other")
    store_run(other, validated / "reports/other")
    write_manifest(validated / "reports/other")
    assert run("diff", "reports/held_out", "reports/other", "--json") == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert (row["column"], row["row"]) == ("identity", "recipe")
