"""What imported files are taken to mean, what is written, and how bad input ends."""

import json

import numpy as np
import pytest
from import_cases import needle, vtk_sheet, write_bundle, write_european_csv, write_markups, write_scene

from needlefit.cli import main
from needlefit.datasets.importing.conversion import plan_import, write_plan
from needlefit.datasets.importing.decisions import Decisions
from needlefit.datasets.read import check_all, read
from needlefit.errors import ConfigError, DataError
from needlefit.geometry.surfaces import make_cylinder, make_sheet, write_surface
from needlefit.project.toml import read_toml
from needlefit.studies.study_files import load_study

CURVES = [needle(n, 16) for n in range(3)]


def understood(paths, **options):
    """Return the plan, and the decisions by name: (value, source)."""
    decisions = Decisions({key.replace("_", " "): value for key, value in options.items()})
    _, plan = plan_import(paths, decisions)
    return plan, {one.what: (one.value, one.source) for one in decisions.made}


def write_plain(folder, curves, name="points.csv", scale=1.0):
    parts = ["\n".join(",".join(f"{scale * v:.8g}" for v in p) for p in one) for one in curves]
    (folder / name).write_text("\n\n".join(parts))
    return folder / name


def with_shaft(curve):
    """Return a needle that begins 18 mm before its entry."""
    x = np.linspace(-18.0, -3.0, 6)
    return np.vstack([np.column_stack([x, np.full((6, 2), curve[0, 1:])]), curve])


def test_units_are_guessed_by_the_longest_needle_and_asked_where_they_are_not_clear(tmp_path):
    for scale, unit in [(1.0, "mm"), (1e-3, "m"), (1e3, "um")]:
        plan, made = understood([write_plain(tmp_path, CURVES, scale=scale)])
        assert made["units"] == (unit, "guess")
        assert plan.insertions[0].row.depth == pytest.approx(60.02, abs=0.1)
    file = write_plain(tmp_path, CURVES, scale=0.1)
    with pytest.raises(ConfigError) as error:
        understood([file])
    assert "--units" in error.value.fix
    plan, made = understood([file], units="cm")
    assert made["units"] == ("cm", "option")
    assert plan.insertions[0].row.depth == pytest.approx(60.02, abs=0.1)


def test_the_end_that_scatters_least_is_the_entry(tmp_path):
    plan, made = understood([write_plain(tmp_path, [one[::-1] for one in CURVES])])
    assert made["entry"] == ("last", "guess")
    np.testing.assert_allclose(plan.insertions[1].points.values, CURVES[1], atol=1e-6)
    assert understood([write_plain(tmp_path, CURVES[:1])])[1]["entry"] == ("first", "assumption")


def write_layers(folder, sign=1.0):
    for x in (20.0, 35.0):
        sheet = make_sheet(f"b{x:g}", (sign * x, 0.0, 0.0), (1.0, 0.0, 0.0), 80.0, 2)
        write_surface(sheet, folder / f"b{x:g}.stl")


def test_ras_and_lps_are_tried_against_the_surfaces(tmp_path):
    write_layers(tmp_path, -1.0)
    write_markups(tmp_path / "c.mrk.json", "c", CURVES[0])
    plan, made = understood([tmp_path])
    assert made["surfaces frame"] == ("RAS", "guess") and made["frame"] == ("LPS", "file")
    assert plan.insertions[0].row.layers == 3
    assert [one.into for one in plan.layers.surfaces] == [2, 3]
    assert understood([tmp_path], surfaces_frame="LPS")[0].insertions[0].row.layers == 1
    tmp_path /= "b"
    tmp_path.mkdir()
    (tmp_path / "fat.vtk").write_bytes(vtk_sheet(-20.0, system="LPS"))
    write_plain(tmp_path, CURVES)
    plan, made = understood([tmp_path])
    assert made["frame"] == ("RAS", "guess")
    np.testing.assert_allclose(plan.insertions[0].points.values, CURVES[0] * [-1, -1, 1], atol=1e-6)


def test_a_needle_is_cut_at_the_tissue_and_its_shaft_gives_the_pose(tmp_path):
    write_surface(make_sheet("skin", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 90.0, 2), tmp_path / "skin.stl")
    write_layers(tmp_path)
    write_plain(tmp_path, [with_shaft(one) for one in CURVES])
    plan, made = understood([tmp_path])
    assert made["tissue surface"] == ("skin", "guess") and made["pose"] == ("shaft", "guess")
    row = plan.insertions[1].row
    np.testing.assert_allclose(row.entry, [0.0, 3.0, 0.0], atol=0.01)
    np.testing.assert_allclose(row.direction, [1.0, 0.0, 0.0], atol=1e-6)
    assert (row.pose_source, row.layers) == ("shaft", 3)
    assert len(understood([tmp_path], tissue_surface="none", pose="tangent")[0].layers.surfaces) == 3
    write_surface(make_sheet("skin", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 90.0, 2), tmp_path / "skin.stl")
    write_plain(tmp_path, [with_shaft(one) for one in CURVES])
    plan, made = understood([tmp_path], point_sd="0.1")
    assert made["pose angle sd"] == ("shaft", "guess") and made["entry point"] == ("first", "guess")
    x = np.linspace(-18.0, -3.0, 6)
    assert plan.insertions[0].row.pose_angle_sd == pytest.approx(0.1 / np.linalg.norm(x - x.mean()))
    plan, _ = understood([tmp_path], pose_angle_sd="1")
    assert np.degrees(plan.insertions[0].row.pose_angle_sd) == pytest.approx(1.0)


def test_the_first_solid_entered_from_outside_is_the_tissue(tmp_path):
    block = make_cylinder("block", ((0.0, 0.0, 0.0), (90.0, 0.0, 0.0)), 40.0, 2)
    write_surface(block, tmp_path / "a.stl")
    core = make_cylinder("core", ((30.0, 0.0, 0.0), (80.0, 0.0, 0.0)), 30.0, 2)
    write_surface(core, tmp_path / "b.stl")
    write_plain(tmp_path, [with_shaft(one)[::-1] for one in CURVES])
    plan, made = understood([tmp_path])
    assert made["entry"] == ("last", "guess") and made["tissue surface"] == ("a", "guess")
    assert [(one.name, one.kind, one.into) for one in plan.layers.surfaces] == [("b", "solid", 2)]


def test_a_stated_direction_leaves_the_entry_and_its_errors_to_be_decided(tmp_path):
    file = write_plain(tmp_path, CURVES)
    plan, made = understood([file], pose="1,0,0", point_sd="0.03")
    assert made["entry point"] == ("first", "assumption") and made["pose shift sd"] == ("0.03", "guess")
    assert made["pose angle sd"] == ("0.5", "assumption")
    row = plan.insertions[1].row
    np.testing.assert_allclose(row.entry, CURVES[1][0], atol=1e-6)
    assert (row.pose_shift_sd, np.degrees(row.pose_angle_sd)) == (0.03, pytest.approx(0.5))
    stated = {"entry_point": "0,0,0", "pose_shift_sd": "0", "pose_angle_sd": "0,2"}
    plan, made = understood([file], pose="2,0,0", **stated)
    row = plan.insertions[1].row
    np.testing.assert_array_equal(row.entry, np.zeros(3))
    assert (row.pose_shift_sd, np.degrees(row.pose_angle_sd)) == (0.0, pytest.approx(0.2))
    assert {made[name][1] for name in ("entry point", "pose shift sd", "pose angle sd")} == {"option"}
    assert understood([file], pose="1,0,0", entry_point="0,0,0")[1]["pose shift sd"] == ("0.1", "assumption")


def test_boundaries_are_stated_as_depths(tmp_path):
    file = write_plain(tmp_path, CURVES)
    plan, _ = understood([file], pose="1,0,0", boundaries="15,5;52,0", boundary_sd="0.3")
    assert plan.layers.depths_mm == (15.5, 52.0)
    assert [one.row.layers for one in plan.insertions] == [3, 3, 2]
    assert {one.row.boundary_sd for one in plan.insertions} == {0.3}
    assert understood([file], boundaries="15,52")[1]["boundary sd"] == ("0.5", "assumption")
    assert understood([file])[1]["boundaries"] == ("none", "guess")
    write_layers(tmp_path)
    with pytest.raises(ConfigError) as error:
        understood([tmp_path], boundaries="15")
    assert "--boundaries" in error.value.fix


def test_bevel_sides_of_a_table_need_a_direction(tmp_path):
    turned = [CURVES[0], CURVES[0] * [1, -1, 1]]
    rows = [
        f"n{n},{side},gel,block{n}," + ",".join(f"{v:.6f}" for v in p)
        for n, (side, one) in enumerate(zip((1, -1), turned, strict=True))
        for p in one
    ]
    (tmp_path / "a.csv").write_text("\n".join(["id,bevel side,medium,specimen,x,y,z", *rows]))
    with pytest.raises(ConfigError) as error:
        understood([tmp_path / "a.csv"], pose="1,0,0")
    assert "--bevel" in error.value.fix
    out = tmp_path / "gel"
    assert (
        run("import", tmp_path / "a.csv", "--out", out, "--pose", "1,0,0", "--bevel", "0,1,0", "--yes") == 0
    )
    dataset = read(out)
    assert [one.side for one in dataset.insertions] == [1, -1]
    assert [one.specimen for one in dataset.insertions] == ["block0", "block1"]
    assert [one.deflection for one in dataset.insertions] == pytest.approx([1.44, 1.44])
    decided = {one["what"]: one for one in read_toml(out / "dataset.toml")["import"]["decisions"]}
    assert decided["medium"]["source"] == decided["specimen"]["source"] == "file"


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        *(({"pose": "1,2"}, "--pose"), ({"entry": "middle"}, "--entry"), ({"modulus": "wood"}, "--modulus")),
        *(({"diameter": "99G"}, "--diameter"), ({"inner_diameter": "2"}, "--inner-diameter")),
        *(({"boundaries": "30,15"}, "--boundaries"), ({"boundaries": "deep"}, "--boundaries")),
        ({"pose": "1,0,0", "pose_angle_sd": "-1"}, "--pose-angle-sd"),
        ({"pose": "1,0,0", "entry_point": "last"}, "--entry-point"),
    ],
)
def test_options_that_mean_nothing_are_refused(tmp_path, options, reason):
    with pytest.raises(ConfigError) as error:
        understood([write_plain(tmp_path, CURVES)], **options)
    assert reason in error.value.fix


def test_questions_are_asked_with_the_guess_and_faults_named_at_their_place(tmp_path):
    asked = {}

    def prompt(question, guess, reason):
        asked[question.what] = guess
        return {"modulus": "nitinol", "medium": "gel"}.get(question.what, "")

    decisions = Decisions({"diameter": "20G"}, prompt)
    _, plan = plan_import([write_plain(tmp_path, CURVES)], decisions)
    assert asked["modulus"] == "steel" and "diameter" not in asked
    assert plan.needle.youngs_modulus_gpa == 60.0 and plan.needle.outer_diameter_mm == 0.908
    assert {one.what: one.source for one in decisions.made}["medium"] == "answer"
    folded = CURVES[0].copy()
    folded[[6, 9]] = folded[[9, 6]]
    file = write_plain(tmp_path, [folded])
    decisions = Decisions()
    content, plan = plan_import([file], decisions)
    (tmp_path / "made").mkdir()
    with pytest.raises(DataError) as error:
        write_plan(tmp_path / "made", content, plan, decisions)
    assert error.value.where == f"{file}:8"


def run(*words):
    with pytest.raises(SystemExit) as ending:
        main([str(word) for word in words])
    return ending.value.code


@pytest.mark.sweep
def test_the_command_writes_a_dataset_that_check_passes(tmp_path, capsys):
    write_european_csv(tmp_path / "six.csv", CURVES)
    assert run("import", tmp_path / "six.csv", "--out", tmp_path / "gel", "--modulus", "steel", "--json") == 0
    shown = json.loads(capsys.readouterr().out)
    assert [one["insertion"] for one in shown["insertions"]] == ["Nadel_1", "Nadel_2", "Nadel_3"]
    faults, warnings = check_all(tmp_path / "gel")
    assert faults == [] and {one.kind for one in warnings} == {"placeholder", "assumed"}
    assert (tmp_path / "gel" / "import.png").stat().st_size > 10_000
    load_study(tmp_path / "gel" / "gel_study.toml")
    stored = read_toml(tmp_path / "gel" / "dataset.toml")["import"]
    assert stored["decisions"] == shown["decisions"] and list(stored["files"]) == ["six.csv"]
    assert run("import", tmp_path / "six.csv", "--out", tmp_path / "again", "--modulus", "steel") == 0
    one, other = (sorted((tmp_path / name).rglob("*.[cp]*")) for name in ("gel", "again"))
    assert [path.read_bytes() for path in one] == [path.read_bytes() for path in other]


def test_commands_write_studies_and_datasets_of_slicer(tmp_path):
    file, out = write_plain(tmp_path, CURVES), tmp_path / "gel"
    assert run("import", file, "--out", out, "--specimen", "block", "--yes") == 0
    study = load_study(out / "gel_study.toml")
    assert (study.leave_out, study.same_specimen) == ("insertion", True)
    assert run("check", out / "gel_study.toml") == 0
    tmp_path /= "b"
    tmp_path.mkdir()
    write_scene(tmp_path / "s", CURVES, "tfm")
    write_bundle(tmp_path / "s.mrb", tmp_path / "s")
    assert run("import", tmp_path / "s.mrb", "--out", tmp_path / "gel", "--bevel", "0,1,0", "--yes") == 0
    dataset = read(tmp_path / "gel")
    assert dataset.pose == "known" and [one.sequence for one in dataset.insertions] == [(1, 2)] * 3
    assert dataset.insertions[0].boundaries[0] == pytest.approx(20.0, abs=0.01)
    assert dataset.insertions[0].planar[-1, 1] > 1.0


@pytest.mark.parametrize("text", ["", "hello\n", "1,2,3\n", "x,y,z\n1,2,3\n4,a,6\n7,8,9\n1,2,3\n", "x,x,x\n"])
def test_bad_input_ends_in_exit_code_3_and_writes_nothing(tmp_path, text, capsys):
    (tmp_path / "a.csv").write_text(text)
    assert run("import", tmp_path / "a.csv", "--out", tmp_path / "gel") == 3
    assert run("import", tmp_path / "none.xlsx", "--out", tmp_path / "gel") == 3
    assert run("import", tmp_path, "--out", tmp_path / "gel") == 3
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.csv"]
    assert "a.csv" in capsys.readouterr().err
