"""Plans of steering: they reach what can be reached, past obstacles, and say how probable that is."""

import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from pytest import approx
from test_cli import run
from test_datasets_markups import markup, point, save

from needlefit.errors import DataError, ModelError
from needlefit.geometry.frames import Frame, Placement
from needlefit.inference.forward_model import ParameterDraws
from needlefit.mechanics.batch import simulate_batches
from needlefit.mechanics.control import Bevel, Step
from needlefit.mechanics.scene import Scene, begin_session
from needlefit.mechanics.shape import compute_positions
from needlefit.mechanics.simulate import simulate_steps
from needlefit.planning.goals import Goal, compute_clearances, cut_plane, find_hits, read_goal_points
from needlefit.planning.steered_needle import Recording, read_recording, replay
from needlefit.planning.steering import PlanLimits, plan_steering
from needlefit.schemas.scene import ObstacleRecord
from needlefit.viewer import opening
from needlefit.viewer.opening import open_target


def run_plan(line, folder):
    """Return the exit code of a plan as it is typed; its result is printed as JSON."""
    return run(f"plan {line} --json", "--out", folder)


@cache
def insertion():
    """Return a needle of phantom 2 at first contact."""
    return open_target("phantom2").begin_insertion()


def uncertain():
    """Return it with draws of its parameters: b to 20 %, moduli to a factor of 1.5."""
    rng, exact, count = np.random.default_rng(4), insertion().exact, 96
    mu = exact.mu * np.exp(np.log(1.5) * rng.standard_normal((count, exact.mu.shape[1])))
    bevel = exact.bevel * np.exp(0.2 * rng.standard_normal(count))
    return replace(insertion(), draws=ParameterDraws(mu, np.repeat(exact.shape, count, 0), bevel))


def plan(target, radius=1.0, circles=(), start=None, **limits):
    """Return the plan past circles (x, y, radius), from first contact unless a start is given."""
    obstacles = tuple(
        ObstacleRecord(name=f"o{n}", centre_mm=(x, y), radius_mm=size)
        for n, (x, y, size) in enumerate(circles)
    )
    goal = Goal(tuple(target), radius, obstacles)
    return plan_steering(start or insertion(), goal, PlanLimits(**limits), threads=1)


def tip_of(*steps):
    one = insertion()
    shape = simulate_steps(one.needle, one.tissue, steps, one.rules)
    return compute_positions(shape, np.array([shape.depth]))[0, :2]


def test_where_the_needle_goes_by_itself_nothing_is_moved():
    x, y = tip_of(replace(insertion().now, depth=40.0))
    found = plan((x, y))
    assert found.nominal_miss < 0.02 and found.turns == ()
    assert abs(found.steps[-1].controls.base_y) < 0.05 and abs(found.steps[-1].depth - 40.0) < 0.05
    other = plan((x, -y), base_mm=0.0, base_angle_deg=0.0, turns=0)
    assert other.turns == (0.0,) and other.nominal_miss < 0.02  # the bevel alone


def test_a_plan_is_the_needle_that_its_steps_simulate():
    found = plan((42.0, -1.5))
    tip = tip_of(*found.steps)
    assert tip == approx(found.nominal[-1], abs=1e-6)
    assert np.linalg.norm(tip - (42.0, -1.5)) == approx(found.nominal_miss, abs=1e-6)
    assert found.nominal_miss < 0.05
    assert found.steps[0].controls == insertion().now.controls  # the entry is where the needle lies
    assert abs(found.steps[-1].controls.base_y) > 0.1


def test_an_obstacle_on_the_way_is_passed_by():
    x, y = plan((45.0, 2.0), turns=0).nominal[20]
    found = plan((45.0, 2.0), circles=[(x, y, 0.5)], entry_mm=5, turns=1)
    assert compute_clearances(found.nominal[None], found.goal.obstacles[0], found.goal)[0] > 0.1
    assert found.goal.needle_radius == approx(insertion().needle.outer_diameter / 2)
    assert found.nominal_miss < 0.2 and found.touched == {"o0": 0.0}
    # one that is just passed, by a thin needle, does not keep the tip from the target
    one = insertion()
    thin = replace(one, needle=replace(one.needle, outer_diameter=None))
    passed = plan((50.73, 0.17), 2.0, [(28.76, -0.45, 0.52)], start=thin, base_mm=20, turns=0)
    assert passed.hits and passed.nominal_miss < 0.1


def test_the_probability_is_that_of_draws_that_the_plan_was_not_sought_with():
    one = uncertain()
    found, tests = plan((40.0, 1.0), 0.25, start=one, turns=0), one.samples[1]
    assert len(found.needles) == len(tests) == 64
    (shapes,) = simulate_batches(one.make_batches(tests, [found.steps]), 1)
    depth = np.array([found.steps[-1].depth])
    tips = np.array([compute_positions(shapes[n], depth)[0, :2] for n in range(64)])
    assert found.hits == np.sum(np.linalg.norm(tips - found.goal.target, axis=1) <= 0.25)
    assert found.hits == np.sum(find_hits(found.needles, found.goal))
    assert 0.1 < found.probability < 1 and found.low < found.probability < found.high


def test_turning_the_bevel_lowers_the_risk_of_an_uncertain_bevel():
    straight, turned = (plan((45.0, 0.0), 0.5, start=uncertain(), turns=n) for n in (0, 2))
    assert turned.turns and turned.probability > straight.probability + 0.1


@pytest.mark.sweep
def test_a_plan_goes_on_from_where_the_needle_stands():
    view = open_target("phantom2")
    session = begin_session(Scene.from_record(view.record), view.first_cell)
    session.step(insert=15.3)
    session.step(base=(2.0, 0.0))
    found = plan((44.0, 1.0), start=replace(insertion(), path=session.input_path()))
    assert min(step.depth for step in found.steps) > 15.3 and found.nominal_miss < 0.1
    for step in found.steps:
        session.go(step)
    end = compute_positions(session.now.shape, np.array([session.depth]))[0, :2]
    assert end == approx(found.nominal[-1], abs=1e-5)


def test_within_the_radius_the_miss_is_least_and_a_limit_that_binds_is_named():
    free = plan((45.0, 1.0), 2.0, turns=0)
    assert free.hits and free.nominal_miss < 0.3 and free.at_limit == ()
    bound = plan((45.0, 4.0), 5.0, base_mm=2, base_angle_deg=0, turns=0)
    assert bound.hits and "base" in bound.at_limit


def test_a_plan_that_fails_has_no_steps_and_how_near_it_comes(tmp_path, capsys):
    path = tmp_path / "plan.csv"
    line = f"phantom2 --target 45,9 --radius 0.5 --base 2 --turns 0 --write-recording {path}"
    assert run_plan(line, tmp_path) == 5
    found = json.loads(capsys.readouterr().out)
    assert found["page"] is None and not (tmp_path / "plan").exists() and not path.exists()
    assert not found["reached"] and found["steps"] == [] and found["at_limit"] == ["base", "base angle"]
    assert found["nominal_miss_mm"] > 0.5


@pytest.mark.parametrize("x", [10.0, 300.0])
def test_a_target_behind_the_tip_or_out_of_reach_is_refused(x):
    with pytest.raises(ModelError):
        plan((x, 0.0), start=replace(insertion(), path=(replace(insertion().now, depth=20.0),)))


def sphere(name, centre):
    return ObstacleRecord(name=name, centre_mm=centre, radius_mm=1.0)


def test_the_plane_of_the_needle_contains_a_target_in_space():
    balls = (sphere("cut", (20.0, 1.0, 1.0)), sphere("beside", (20.0, -2.0, 2.0)))
    found = cut_plane(Goal((45.0, 3.0, 3.0), 1.5, balls))
    assert found.roll_deg == approx(45.0) and found.beside == ("beside",)
    assert found.goal.target == approx((45.0, np.hypot(3, 3)))
    (circle,) = found.goal.obstacles
    assert circle.centre_mm == approx((20.0, np.sqrt(2))) and circle.radius_mm == approx(1.0)
    assert cut_plane(Goal((45.0, -3.0, 0.0))).goal.target == (45.0, -3.0)
    other = cut_plane(Goal((45.0, -2.0, 1.0)))
    assert other.goal.target == approx((45.0, -np.sqrt(5)))
    assert other.roll_deg == approx(-np.degrees(np.arctan(0.5)))
    assert cut_plane(Goal((45.0, 0.0, -2.0))).goal.target == approx((45.0, 2.0))


@pytest.mark.parametrize("angle", [30.0, 110.0, -75.0])
def test_a_target_off_the_plane_is_reached_by_the_roll_alone(angle):
    """The needle that goes there by itself, rolled: the plan finds its roll, and moves nothing else."""
    x, y = tip_of(replace(insertion().now, depth=40.0))
    turned = np.radians(angle)
    target = (x, y * np.cos(turned), y * np.sin(turned))
    found = plan(target, base_mm=0.0, base_angle_deg=0.0, turns=0)
    assert found.nominal_miss < 0.02 and found.nominal.shape[1] == 3
    assert math.remainder(found.steps[0].bevel.roll_deg - angle, 360) == approx(0, abs=1)
    one = insertion()
    shape = simulate_steps(one.needle, one.tissue, found.steps, one.rules)
    assert compute_positions(shape, np.array([shape.depth]))[0] == approx(found.nominal[-1], abs=1e-6)


def test_base_and_turns_help_the_roll_and_draws_spread_in_both_directions():
    found = plan((45.0, 3.0, -1.5), 1.0, start=uncertain(), turns=1)
    misses = found.describe_misses()
    assert found.hits and misses["nominal_miss_mm"] < 0.3
    assert np.array(misses["tip_sd_mm"]) == approx(found.needles[:, -1, 1:].std(axis=0))
    assert min(misses["tip_sd_mm"]) > 0.01


def test_points_of_slicer_are_targets_and_obstacles_in_the_constraint_frame(tmp_path):
    placement = Placement(Frame(np.array([10.0, 0.0, 0.0]), np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])))
    listed = [point(1, [10, 45, 0], label="Target 1"), point(2, [9, 20, 0.5], label="vessel")]
    path = save(tmp_path / "a.mrk.json", markup(points=listed))
    target, balls = read_goal_points(path, placement, 2.5)
    assert target == approx((45.0, 0.0, 0.0))
    assert balls[0].name == "vessel" and balls[0].radius_mm == 2.5
    assert balls[0].centre_mm == approx((20.0, 1.0, 0.5))
    alone, none = read_goal_points(save(tmp_path / "b.mrk.json", markup(points=[listed[1]])), placement, 1.0)
    assert alone is not None and none == ()
    twice = save(tmp_path / "c.mrk.json", markup(points=[listed[0], listed[0] | {"id": "9"}]))
    with pytest.raises(DataError):
        read_goal_points(twice, placement, 1.0)


def test_the_command_prints_a_plan_and_writes_it_as_a_recording(tmp_path, capsys):
    path = tmp_path / "plan.csv"
    line = f"phantom2 --target 45,2 --obstacle 25,0.4,0.8 --entry-shift 5 --write-recording {path}"
    assert run_plan(line, tmp_path) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["reached"] and found["nominal_miss_mm"] < 0.2 and found["draws"] == 0
    assert found["steps"][-1]["depth_mm"] == approx(45.0, abs=1.0)
    *_, last = replay(read_recording(path))
    assert last.tip_offset_mm == 0
    assert last.state.step.depth == found["steps"][-1]["depth_mm"]
    entry = read_recording(path).head.scene.entry
    assert entry.y_mm == approx(found["entry_mm"]) and abs(entry.y_mm) <= 5


@pytest.mark.parametrize(("by", "same"), [(0.0, True), (1e-9, True), (1e-3, False)])
def test_a_recording_is_compared_with_its_scene_by_what_both_mean(by, same):
    shown = opening.open_target("twin/phantom2-05")
    bevel = shown.record.bevel.model_copy(update={"offset_mm": shown.record.bevel.offset_mm + by})
    record = shown.record.model_copy(update={"bevel": bevel})
    recording = Recording(replace(shown, record=record).make_head(), ())
    assert (opening.open_recording(recording).measured is not None) == same


@pytest.mark.parametrize(
    ("fitted", "directions", "target", "count"),
    [
        ((100.0, 110.0), 1, "45,2", 1),
        ((70.0, 80.0), 1, "45,2,1", 1),
        ((70.0, 80.0), 2, "45,2,1", 0),
    ],
)
def test_a_plan_to_a_depth_or_along_z_that_was_not_fitted_says_so(
    fitted, directions, target, count, monkeypatch, capsys, tmp_path
):
    shown = replace(opening.open_target("phantom2"), fitted_depths=fitted, fitted_directions=directions)
    monkeypatch.setattr(opening, "open_target", lambda *_, **__: shown)
    assert run_plan(f"phantom2 --target {target} --turns 0", tmp_path) == 0
    kinds = [one["kind"] for one in json.loads(capsys.readouterr().out)["warnings"]]
    assert kinds == ["extrapolation"] * count


@pytest.mark.sweep
def test_the_bevel_of_a_path_angle_scene_is_planned_too():
    rules = replace(insertion().rules, advance="path_angle")
    start = Step(0.0, Bevel(cut_angle=0.05), insertion().now.controls)
    assert plan((40.0, -1.0), start=replace(insertion(), rules=rules, path=(start,))).nominal_miss < 0.1


@pytest.mark.parametrize(("centre", "clearance"), [((5, 3), 2.0), ((13, 4), 4.0), ((5, 0.5), -0.5)])
def test_clearance_is_the_distance_from_the_rim(centre, clearance):
    line = np.array([[[0.0, 0.0], [10.0, 0.0]]])
    obstacle = ObstacleRecord(name="a", centre_mm=centre, radius_mm=1)
    thin, thick = Goal((10.0, 0.0)), Goal((10.0, 0.0), needle_radius=0.6)
    assert compute_clearances(line, obstacle, thin) == approx(clearance)
    assert compute_clearances(line, obstacle, thick) == approx(clearance - 0.6)


def test_a_thick_needle_touches_a_ball_beside_its_plane():
    balls = (sphere("near", (20.0, 1.0, 1.2)), sphere("far", (20.0, 1.0, 2.0)))
    found = cut_plane(Goal((45.0, 3.0, 0.0), 1.5, balls, needle_radius=0.6))
    (circle,) = found.goal.obstacles
    assert circle.radius_mm == approx(np.sqrt(1.6**2 - 1.2**2) - 0.6) and found.beside == ("far",)


def test_a_plan_from_first_contact_does_not_depend_on_the_roll_that_a_scene_states(tmp_path, capsys):
    text = (Path(__file__).parents[1] / "configs/scenes/phantom2.toml").read_text()
    steps = "\n[[steps]]\ndepth_mm = 20.0\n[[steps]]\ndepth_mm = 38.06\nroll_deg = 45.0\n"
    changed = text.replace("side = 1", "roll_deg = -30").replace("depth_mm = 38.06", "", 1)
    (tmp_path / "rolled.toml").write_text(changed + steps)
    x, y = tip_of(replace(insertion().now, depth=40.0))
    line, found = f"--target {x},{0.6 * y},{0.8 * y} --radius 0.5 --base 0 --turns 0", []
    for name in ("phantom2", tmp_path / "rolled.toml"):
        assert run_plan(f"{name} {line}", tmp_path) == 0
        found.append(json.loads(capsys.readouterr().out))
    keys = ("reached", "steps", "turns_mm", "roll_deg", "nominal_miss_mm")
    assert [found[0][key] for key in keys] == [found[1][key] for key in keys] and found[0]["reached"]


def test_an_uncertain_gain_of_the_base_spreads_the_misses(tmp_path, capsys):
    line, most = "--target 45,2 --radius 0.5 --turns 0 --gain-sd", []
    for gain_sd in (0, 0.25):
        assert run_plan(f"phantom2_fitted {line} {gain_sd}", tmp_path) == 0
        most.append(json.loads(capsys.readouterr().out)["miss_95_mm"])
    assert most[1] > 1.5 * most[0]
    assert run_plan(f"phantom2 {line} 0.25", tmp_path) == 3  # of exact parameters
