"""`needlefit simulate` of a scene, and of a recording of what was steered by hand; the files it writes."""

import json
import math

import numpy as np
import pandas as pd
import pytest
from matplotlib.image import imread
from numpy.testing import assert_allclose
from pytest import approx
from test_cli import run
from test_viewer_recording import WANDERING, recorded

from needlefit.project.locate import find_file, list_names
from needlefit.project.toml import load
from needlefit.project.unit_warnings import scene_warnings
from needlefit.schemas.scene import SceneRecord


def answer(capsys, line, code=0):
    assert run(f"simulate {line} --json") == code
    return json.loads(capsys.readouterr().out, parse_constant=pytest.fail)  # NaN is no JSON


def warned(found, kind):
    return [row for row in found["warnings"] if row["kind"] == kind]


def test_json_has_the_documented_keys(capsys):
    found = answer(capsys, "phantom1")
    assert found["converged"] is True and found["boundaries_mm"] == [20, 28, 45]
    assert found["depth_mm"] == approx((50.69 + 54.27) / 2) and len(found["tip_mm"]) == 3
    assert found["constraints_mm"][0] == [0, 0, 0]
    assert found["constraints_mm"][-1][0] == approx(found["depth_mm"])
    (step,) = found["steps"]
    assert {key: found[key] for key in step} == step
    assert step["tip_angle_deg"] == approx(math.degrees(step["tip_slope"]))


def test_files_of_a_needle_in_space_show_it_from_above_too(capsys, tmp_path):
    """A bevel rolled by 90 degrees: the columns of z are those of y of the needle that is not rolled."""
    tables, panels = {}, {}
    for roll in (0, 90):
        names = {"--csv": "a.csv", "--slicer": "a.mrk.json", "--plot": "a.png"}
        paths = {option: tmp_path / f"{roll}{name}" for option, name in names.items()}
        files = " ".join(f"{option} {path}" for option, path in paths.items())
        assert run(f"simulate phantom1 --set bevel.roll_deg={roll} --depth 30 {files}") == 0
        tables[roll] = pd.read_csv(paths["--csv"])
        curve = json.loads(paths["--slicer"].read_text())["markups"][0]["controlPoints"]
        tables[roll, "slicer"] = np.array([point["position"] for point in curve])
        panels[roll] = imread(paths["--plot"]).shape[0]
    planar, rolled = tables[0], tables[90]
    for y, z in (("y_mm", "z_mm"), ("slope", "slope_z"), ("load_n_per_mm", "load_z_n_per_mm")):
        assert_allclose(rolled[z], planar[y], atol=1e-6)
        assert_allclose(rolled[y], 0, atol=1e-6)
        assert (planar[z] == 0).all()
    assert_allclose(rolled["world_z_mm"], planar["world_y_mm"], atol=1e-6)
    (x, y, z), (u, v, w) = tables[0, "slicer"].T, tables[90, "slicer"].T
    assert_allclose((u, w, v), (x, y, z), atol=1e-6)
    assert panels[90] == 2 * panels[0]
    assert run(f"simulate phantom1 --plot {tmp_path}/a.svg") == 3


def test_an_empty_value_removes_a_key_and_with_it_the_law_is_switched(capsys):
    line = "phantom1 --set rules.advance=path_angle --set bevel.cut_angle_deg=5"
    assert run(f"simulate {line}") == 3
    assert "bevel.offset_mm" in capsys.readouterr().err
    found = answer(capsys, f"{line} --set bevel.offset_mm=")
    assert found["converged"] and abs(found["tip_lateral_mm"]) > 1


@pytest.mark.parametrize(
    ("scene", "assigned", "key"),
    [
        ("phantom1", "bevel.ofset_mm=0.1", "`offset_mm`"),  # the nearest
        ("chicken", "layers.0.mu_pa=3e5", "numbered from 1"),
        ("phantom1", "depth_mm=150", "a depth below 150 mm"),
        ("phantom2", "rules.element_mm=1e-6", "`rules.element_mm`"),
        ("figure1", "steps.2.guides.template.x_mm=5", "key `steps.2.guides.template`"),
        ("figure1", "controls.guide_distance_mm=15", "`guides.1`"),
        ("figure1", "steps.2.depth_mm=135", "`steps.2.depth_mm`"),
        ("figure1", "needle.length_mm=0.15", "`needle.length_mm`"),
        ("figure1", "depth_mm=30", "steps.3.depth_mm"),
        ("figure1", "guides.1.name=stencil", "steps.2.guides.template"),
    ],
)
def test_a_wrong_value_names_its_key(scene, assigned, key, capsys):
    assert run("simulate", scene, "--set", assigned) == 3
    assert key in capsys.readouterr().err


def test_a_needle_without_an_answer_is_marked_and_the_exit_code_5(tmp_path, capsys):
    line = "phantom2 --set bevel.offset_mm=60"
    found = answer(capsys, line, code=5)
    assert (found["converged"], found["status"]) == (False, "over-compressed")

    assert found["tip_lateral_mm"] is None and found["tip_slope"] is None
    assert found["tip_mm"][:2] == [None, None]
    assert found["depth_mm"] == 38.06 and found["constraints_mm"][-1][:2] == [approx(38.06), None]
    assert run(f"simulate {line} --csv", tmp_path / "a.csv") == 5
    assert "nan" not in capsys.readouterr().out and not (tmp_path / "a.csv").exists()


@pytest.mark.parametrize(
    ("setting", "key", "fix"),
    [
        ("needle.youngs_modulus_gpa=1001", "`needle.youngs_modulus_gpa`", None),
        ("layers.1.alpha=0", "`layers.1.alpha`", None),
        ("layers.1.mu_pa=220", "kPa", "220000"),
        ("layers.1.mu_pa=0.22", "MPa", "220000"),
        ("bevel.offset_mm=1e-4", "metres", "0.1"),
    ],
)
def test_implausible_values_give_a_warning_that_names_the_unit(setting, key, fix, capsys):
    run("simulate phantom2 --set", setting, "--json")
    (found,) = warned(json.loads(capsys.readouterr().out), "units")
    assert key in found["what"] and fix in (None, found["fix"].split()[-1])


def test_what_gives_no_warning(capsys):
    assert warned(answer(capsys, "phantom2 --set layers.1.alpha=0 --set law=linear"), "units") == []
    for name in list_names("scene"):
        record = load(find_file("scene", name), SceneRecord)
        assert [*scene_warnings(record)] == []


def test_strict_turns_a_warning_into_an_exit_code_and_nothing_else(capsys):
    line = "phantom2 --set layers.2.mu_pa=30"
    assert answer(capsys, line) == answer(capsys, f"{line} --strict", code=5)
    assert run("simulate phantom2 --strict") == 0


def test_a_needle_outside_the_model_is_named(capsys):
    inside = answer(capsys, "phantom1 --strict")
    assert inside["valid"] and inside["validity"]["ok"] and inside["validity"]["faults"] == []
    assert 0.01 < inside["max_slope"] < 0.3 and warned(inside, "validity") == []
    steep = "phantom1 --set bevel.offset_mm=1"
    assert warned(answer(capsys, f"{steep} --strict", code=5), "validity")
    found = answer(capsys, "figure1 --set steps.1.offset_mm=3")
    assert not found["valid"] and not found["steps"][0]["valid"]
    assert found["max_slope"] == found["validity"]["max_slope"] > 0.3


# --- recordings ------------------------------


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "log.csv"
    return path, recorded(path).found


def test_a_recording_ends_where_it_ended_bit_for_bit_and_so_do_its_files(log, capsys):
    path, found = log
    table, curve = path.with_name("shape.csv"), path.with_name("shape.mrk.json")
    whole = answer(capsys, f"--recording {path} --csv {table} --slicer {curve}")
    (points,) = (one["controlPoints"] for one in json.loads(curve.read_text())["markups"])
    for y in (pd.read_csv(table)["y_mm"].iloc[-1], points[-1]["position"][1]):
        assert y == approx(found[len(WANDERING)][-1], abs=1e-6)
    assert (whole["depth_mm"], whole["tip_lateral_mm"]) == (5.0, found[len(WANDERING)][-1])
    assert whole["replayed"] == {"steps": len(WANDERING), "tip_offset_mm": 0.0}
    assert whole["converged"] and len(whole["steps"]) == 1 and whole["boundaries_mm"] == [20, 28, 45]
    path.write_text("x,y\n1,2\n")
    assert run("simulate --recording", path) == 3 and "is no recording" in capsys.readouterr().err


@pytest.mark.parametrize(
    "line",
    [
        "study2 --recording LOG",
        "--recording LOG --depth 20",
        "--recording LOG --set bevel.side=-1",
        "",
        "phantom1 --set bevel.offset_mm",
        "figure1 --depth 50",
    ],
)
def test_contradicting_options_are_a_usage_error(log, line):
    assert run(f"simulate {line.replace('LOG', str(log[0]))}") == 2
