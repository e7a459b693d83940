"""`needlefit simulate`."""

import json
import math
import time

import pytest
from test_cli import run

from needlefit.mechanics.scene import Entry
from needlefit.project.locate import find_file, list_names
from needlefit.project.toml import load
from needlefit.project.unit_warnings import coarse_warnings, scene_warnings
from needlefit.schemas.scene import SceneRecord


def answer(capsys, *words):
    assert run("simulate", *words, "--json") == 0
    return json.loads(capsys.readouterr().out)


def test_json_has_the_documented_keys(capsys):
    found = answer(capsys, "phantom1")
    assert found["converged"] is True
    assert found["boundaries_mm"] == [20, 28, 45]
    assert found["depth_mm"] == pytest.approx((50.69 + 54.27) / 2)
    assert len(found["tip_mm"]) == 2
    assert found["constraints_mm"][0] == [0, 0]
    assert found["constraints_mm"][-1][0] == pytest.approx(found["depth_mm"])


@pytest.mark.parametrize(
    ("scene", "implied_mm"), [("phantom1", 1.2), ("phantom3", 1.0), ("chicken", 0.29)]
)  # the deflections that the published parameters give in this model
def test_magnitudes(scene, implied_mm, capsys):
    assert answer(capsys, scene)["tip_lateral_mm"] == pytest.approx(implied_mm, rel=0.15)


def test_without_bevel_the_needle_stays_straight(capsys):
    found = answer(capsys, "phantom1", "--set", "bevel.offset_mm=0", "--depth", "40")
    assert found["tip_lateral_mm"] == pytest.approx(0, abs=1e-12)
    assert found["tip_mm"] == pytest.approx([40, 0])


def test_the_other_side_mirrors(capsys):
    left = answer(capsys, "study3")
    right = answer(capsys, "study3", "--set", "bevel.side=-1")
    assert right["tip_lateral_mm"] == pytest.approx(-left["tip_lateral_mm"], rel=1e-12)


def test_the_entry_moves_the_tip_in_the_world_only(capsys):
    plain = answer(capsys, "phantom1")
    x, y = plain["tip_mm"]
    turned = answer(capsys, "phantom1", "--set", "entry.angle_deg=90", "--set", "entry.x_mm=5")
    assert turned["tip_lateral_mm"] == plain["tip_lateral_mm"]
    assert turned["tip_mm"] == pytest.approx([5 - y, x])


def test_entry_turns_counter_clockwise():
    points = Entry(1.0, 2.0, math.pi / 6).to_world([[2.0, 0.0], [0.0, 2.0]])
    assert points.tolist() == [
        pytest.approx([1 + math.sqrt(3), 3.0]),
        pytest.approx([0.0, 2 + math.sqrt(3)]),
    ]


def test_layers_are_numbered_from_1(capsys):
    plain = answer(capsys, "chicken")
    stiffer = answer(capsys, "chicken", "--set", "layers.1.mu_pa=3e5")
    assert stiffer["tip_lateral_mm"] > 1.2 * plain["tip_lateral_mm"]


def test_an_empty_value_removes_a_key_and_with_it_the_law_is_switched(capsys):
    path_angle = ("--set", "rules.advance=path_angle", "--set", "bevel.cut_angle_deg=5")
    assert run("simulate", "phantom1", *path_angle) == 3
    assert "bevel.offset_mm" in capsys.readouterr().err
    found = answer(capsys, "phantom1", *path_angle, "--set", "bevel.offset_mm=")
    assert found["converged"] and abs(found["tip_lateral_mm"]) > 1


@pytest.mark.parametrize(
    ("scene", "setting", "expected"),
    [
        ("phantom1", "bevel.ofset_mm=0.1", ["bevel.offset_mm"]),  # the nearest
        ("chicken", "layers.0.mu_pa=3e5", ["numbered from 1"]),
        ("phantom1", "bevel.offset_mm=", ["bevel.offset_mm"]),
        ("phantom1", "layers.2.mu_pa=-1", ["`layers.2.mu_pa`"]),
        ("phantom1", "layers.2.mu_pa=soft", ["`layers.2.mu_pa`"]),
        ("phantom1", "bevel.side=0", ["`bevel.side`"]),
        ("phantom1", "layers.2.top_mm=50", ["top_mm must increase"]),
        ("phantom1", "needle.youngs_modulus_gpa=nan", ["`needle.youngs_modulus_gpa`"]),
        ("phantom1", "law=rubber", ["`rubber`"]),
        ("phantom1", "rules.element_mm=0.3", ["constraint spacing"]),
        ("phantom1", "depth_mm=150", ["a depth below 150 mm"]),
        ("phantom2", "depth_mm=9e8", ["`depth_mm`", "expected", "900000000.0"]),
        ("phantom2", "needle.length_mm=1e7", ["`needle.length_mm`", "expected", "10000000.0"]),
        ("phantom2", "rules.element_mm=1e-6", ["`rules.element_mm`", "expected", "1e-06"]),
        (
            "phantom2",
            "rules.constraint_spacing_mm=1e-3",
            ["`rules.constraint_spacing_mm`", "expected", "0.001"],
        ),
        (
            "phantom2",
            "rules.constraint_spacing_mm=1e9",
            ["`rules.constraint_spacing_mm`", "expected", "1000000000.0"],
        ),
        ("figure1", "steps.2.guides.templat.y_mm=1", ["steps.2.guides.template.y_mm"]),
        ("figure1", "guides.1.x_mm=5", ["key `guides.1`", "x = 5.0 mm"]),
        ("figure1", "steps.2.guides.template.x_mm=5", ["key `steps.2.guides.template`", "x = 5.0 mm"]),
        ("figure1", "steps.3.guides.template.in_tissue=true", ["key `steps.3.guides.template`"]),
        ("figure1", "guides.1.angle_deg=100", ["80 degrees"]),
        ("figure1", "controls.stage_angle_deg=46", ["key `controls.stage_angle_deg`"]),
        (
            "figure1",
            "controls.guide_distance_mm=15",
            ["`guides.1`", "`controls.guide_distance_mm`", "x = -15 mm"],
        ),
        (
            "figure1",
            "steps.2.depth_mm=135",
            ["`steps.2.depth_mm`", "`steps.2.guides.template`", "150 mm", "135 mm", "15 mm"],
        ),
        ("figure1", "guides.1.x_mm=-120", ["30 mm", "110 mm"]),
        (
            "figure1",
            "needle.length_mm=0.15",
            ["`needle.length_mm`", "`guides.1`", "0.15 mm", "15 mm", "55 mm", "40 mm"],
        ),
        ("figure1", "steps.2.side=2", ["`steps.2.side`"]),
        ("figure1", "steps.2.tip_slope_deg=2", ["tip_slope_deg", "tip_y_mm"]),
        ("figure1", "depth_mm=30", ["steps.3.depth_mm"]),
        ("figure1", "guides.1.name=stencil", ["steps.2.guides.template"]),
        ("figure1", "guides.1.name=2", ["`guides.1.name`"]),
    ],
)
def test_a_wrong_value_names_its_key(scene, setting, expected, capsys):
    assert run("simulate", scene, "--set", setting) == 3
    err = capsys.readouterr().err
    assert [part for part in expected if part not in err] == []


def test_a_shipped_scene_goes_by_its_name_in_messages(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run("simulate", "figure1", "--set", "bevel.side=0") == 3
    printed = capsys.readouterr().err
    assert printed.startswith("needlefit: scene figure1 (shipped)") and "key `bevel.side`" in printed


def test_a_needle_too_short_before_a_guide_is_reported_with_its_largest_depth(capsys):
    assert run("simulate", "phantom1", "--depth", "120", "--set", "controls.guide_distance_mm=40") == 3
    assert "a depth below 110 mm" in capsys.readouterr().err


def test_an_invalid_assignment_is_a_usage_error(capsys):
    assert run("simulate", "phantom1", "--set", "bevel.offset_mm") == 2
    assert "KEY=VALUE" in capsys.readouterr().err


def test_without_convergence_the_answer_is_marked_and_the_exit_code_5(capsys):
    crushing = ("--set", "bevel.offset_mm=30", "--set", "layers.1.thickness_mm=0.5")
    assert run("simulate", "phantom1", *crushing, "--json") == 5
    captured = capsys.readouterr()
    found = json.loads(captured.out)
    assert found["converged"] is False
    assert found["status"] != "converged"
    assert "did not converge" in captured.err
    assert run("simulate", "phantom1", *crushing) == 5
    assert "NOT CONVERGED" in capsys.readouterr().out


def test_values_not_computed_are_printed_as_dashes(capsys):
    assert run("simulate", "phantom2", "--set", "bevel.offset_mm=60") == 5
    out = capsys.readouterr().out
    assert "nan" not in out
    assert out.splitlines()[-4].split()[2:5] == ["–", "–", "–"]


@pytest.mark.parametrize(
    ("setting", "key"),
    [
        ("needle.youngs_modulus_gpa=1001", "needle.youngs_modulus_gpa"),
        ("layers.2.mu_pa=33", "layers.2.mu_pa"),
        ("layers.2.mu_pa=3e10", "layers.2.mu_pa"),
        ("bevel.offset_mm=2.1", "bevel.offset_mm"),
        ("layers.1.alpha=0", "layers.1.alpha"),
        ("layers.1.alpha=-80", "layers.1.alpha"),
    ],
)
def test_implausible_values_give_a_warning(setting, key, capsys):
    assert f"`{key}`" in find_unit_warning(capsys, setting)["what"]


@pytest.mark.parametrize(
    ("setting", "unit", "right"),
    [
        ("layers.1.mu_pa=220", "kPa", "220000"),
        ("layers.1.mu_pa=0.22", "MPa", "220000"),
        ("bevel.offset_mm=1e-4", "metres", "0.1"),
    ],
)
def test_a_value_in_another_unit_names_it_and_the_right_one(setting, unit, right, capsys):
    found = find_unit_warning(capsys, setting)
    assert unit in found["what"] and found["fix"].split() == ["write", right]


def test_alpha_of_a_law_without_an_exponent_gives_no_warning(capsys):
    run("simulate", "phantom2", "--set", "layers.1.alpha=0", "--set", "law=linear", "--json")
    assert [row for row in json.loads(capsys.readouterr().out)["warnings"] if row["kind"] == "units"] == []


def find_unit_warning(capsys, setting):
    run("simulate", "phantom2", "--set", setting, "--json")
    found = json.loads(capsys.readouterr().out)["warnings"]
    (one,) = [row for row in found if row["kind"] == "units"]
    return one


def test_strict_turns_a_warning_into_an_exit_code_and_nothing_else(capsys):
    changed = ("simulate", "phantom2", "--set", "layers.2.mu_pa=3e10", "--json")
    codes, outputs = [], []
    for words in (changed, (*changed, "--strict")):
        codes.append(run(*words))
        outputs.append(capsys.readouterr())
    assert codes == [0, 5]
    assert outputs[0] == outputs[1]
    assert run("simulate", "phantom2", "--strict") == 0


def test_a_steep_offset_of_a_step_gives_a_warning_per_mm(capsys):
    run("simulate", "figure1", "--set", "steps.2.offset_mm=1.5", "--set", "rules.constraint_spacing_mm=0.5")
    err = capsys.readouterr().err
    assert "`steps.2.offset_mm`" in err and "1.5 mm per 0.5 mm" in err


def test_the_mesh_follows_the_constraint_spacing_by_default(capsys):
    half = answer(capsys, "phantom2", "--set", "rules.constraint_spacing_mm=0.5")
    same = answer(
        capsys, "phantom2", "--set", "rules.constraint_spacing_mm=0.5", "--set", "rules.element_mm=0.5"
    )
    assert half == same


def test_values_not_computed_are_null(capsys):
    assert run("simulate", "phantom2", "--set", "bevel.offset_mm=60", "--json") == 5
    found = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)  # NaN is no JSON
    assert (found["converged"], found["status"]) == (False, "over-compressed")
    assert found["tip_lateral_mm"] is None and found["tip_slope"] is None
    assert found["tip_mm"] == [None, None]
    assert found["depth_mm"] == 38.06 and found["constraints_mm"][-1] == [pytest.approx(38.06), None]


def test_a_plot_is_drawn_the_same_twice(tmp_path, capsys):
    for name in ("a.png", "b.png"):
        assert run("simulate", "phantom1", "--plot", str(tmp_path / name)) == 0
    first = (tmp_path / "a.png").read_bytes()
    assert first.startswith(b"\x89PNG") and first == (tmp_path / "b.png").read_bytes()
    capsys.readouterr()
    assert run("simulate", "phantom1", "--plot", str(tmp_path / "a.jpeg")) == 3
    assert capsys.readouterr().out == ""  # it fails before it prints


def test_a_needle_outside_the_model_is_named(capsys):
    assert run("simulate", "phantom1", "--json", "--strict") == 0
    inside = json.loads(capsys.readouterr().out)
    assert inside["valid"] and inside["validity"]["ok"] and inside["validity"]["faults"] == []
    assert 0.01 < inside["max_slope"] < 0.3 and "validity" not in [row["kind"] for row in inside["warnings"]]
    steep = ("simulate", "phantom1", "--set", "bevel.offset_mm=1", "--json")
    assert run(*steep) == 0
    captured = capsys.readouterr()
    found = json.loads(captured.out)
    assert found["converged"] and not found["valid"] and not found["validity"]["ok"]
    assert found["max_slope"] > 0.3 and len(found["validity"]["faults"]) >= 1
    assert "validity" in [row["kind"] for row in found["warnings"]] and "warning" in captured.err
    assert run(*steep, "--strict") == 5


def test_a_step_outside_the_model_marks_the_whole_insertion(capsys):
    assert run("simulate", "figure1", "--set", "steps.1.offset_mm=3", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert not found["valid"] and not found["steps"][0]["valid"]
    assert found["max_slope"] == found["validity"]["max_slope"] > 0.3


@pytest.mark.parametrize(
    ("depth", "spacing", "count"),
    [(12, 10, 1), (39, 8, 0), (31, 8, 1), (149, 10, 0), (2.5, 0.5, 0), (3, 1, 1)],
)
def test_an_insertion_of_few_constraint_cells_is_named_as_coarse(depth, spacing, count, capsys):
    sizes = (f"depth_mm={depth}", f"rules.constraint_spacing_mm={spacing}", "bevel.offset_mm=0.01")
    assert run("simulate", "phantom1", "--json", *(word for size in sizes for word in ("--set", size))) == 0
    warnings = json.loads(capsys.readouterr().out)["warnings"]
    assert [one["kind"] for one in warnings].count("coarse") == count
    assert all("`rules.constraint_spacing_mm`" in one["what"] for one in warnings if one["kind"] == "coarse")


def test_a_short_step_of_a_deep_insertion_is_not_coarse(capsys):
    assert run("simulate", "figure1", "--set", "steps.1.depth_mm=2", "--json") == 0
    assert "coarse" not in [one["kind"] for one in json.loads(capsys.readouterr().out)["warnings"]]


@pytest.mark.parametrize("name", list_names("scene"))
def test_no_shipped_scene_gives_a_warning(name):
    record = load(find_file("scene", name), SceneRecord)
    assert [*scene_warnings(record), *coarse_warnings(record)] == []


def test_an_insertion_of_too_many_elements_is_refused_at_once(capsys):
    sizes = ("needle.length_mm=2000", "depth_mm=1500", "rules.constraint_spacing_mm=0.1")
    began = time.monotonic()
    assert run("simulate", "phantom2", *(word for size in sizes for word in ("--set", size))) == 3
    assert "`rules.constraint_spacing_mm`" in capsys.readouterr().err
    assert time.monotonic() - began < 5


def test_a_path_is_a_scene_too(tmp_path, monkeypatch, capsys):
    from needlefit.project.locate import find_file

    text = find_file("scene", "chicken").read_text(encoding="utf-8")
    (tmp_path / "mine.toml").write_text(text.replace("depth_mm = 44.1", "depth_mm = 20"), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    assert answer(capsys, "mine.toml")["depth_mm"] == 20
    assert answer(capsys, "./mine.toml")["depth_mm"] == 20


def test_a_scene_of_one_step_prints_the_same(capsys):
    found = answer(capsys, "phantom1")
    (step,) = found["steps"]
    assert {key: found[key] for key in step} == step
    assert step["tip_angle_deg"] == pytest.approx(math.degrees(step["tip_slope"]))


def test_json_has_an_entry_for_every_step(capsys):
    found = answer(capsys, "figure1")
    assert [step["depth_mm"] for step in found["steps"]] == [40, 70, 105]
    assert {key: found[key] for key in ("tip_lateral_mm", "tip_mm", "status")}.items() <= found["steps"][
        -1
    ].items()
    assert sum(step["iterations"] for step in found["steps"]) == found["iterations"]
    first = answer(capsys, "figure1", "--set", "steps.2.side=1")["steps"]
    assert first[0] == found["steps"][0] and first[1]["tip_lateral_mm"] > found["steps"][1]["tip_lateral_mm"]


def test_every_step_has_its_line(capsys):
    assert run("simulate", "figure1") == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    rows = [line[:2] for line in lines if line and line[-1] == "ok"]
    assert rows == [["1", "40.00"], ["2", "70.00"], ["3", "105.00"]]


def test_a_failure_names_its_step(capsys):
    assert run("simulate", "figure1", "--set", "steps.2.offset_mm=60", "--json") == 5
    captured = capsys.readouterr()
    found = json.loads(captured.out, parse_constant=pytest.fail)
    assert [step["status"] for step in found["steps"]] == ["converged", "over-compressed", "not reached"]
    assert (found["status"], found["depth_mm"], found["tip_lateral_mm"]) == ("over-compressed", 70, None)
    assert found["steps"][2]["tip_mm"] is None
    assert "step 2 of 3" in captured.err and "over-compressed" in captured.err


def test_the_depth_of_steps_is_set_by_their_keys(capsys):
    assert run("simulate", "figure1", "--depth", "50") == 2
    assert "steps.3.depth_mm=50" in " ".join(capsys.readouterr().err.split())
    found = answer(capsys, "figure1", "--set", "steps.3.depth_mm=50")
    assert [step["depth_mm"] for step in found["steps"]] == [40, 70, 50]


def test_guides_and_steps_are_set_by_name_and_number(capsys):
    plain = answer(capsys, "figure1")
    moved = answer(capsys, "figure1", "--set", "steps.1.guides.template.y_mm=1")
    assert moved["steps"][0]["tip_lateral_mm"] != plain["steps"][0]["tip_lateral_mm"]
    assert moved["steps"][2]["iterations"] > 0
    freed = answer(capsys, "figure1", "--set", "guides.1.turns_freely=true")
    assert freed["tip_lateral_mm"] != plain["tip_lateral_mm"]
