"""Plans of steering: they reach what can be reached, past obstacles, and say how probable that is."""

import json
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from test_cli import run
from test_datasets_markups import markup, point, save

from needlefit.errors import ConfigError, DataError, ModelError
from needlefit.geometry.frames import Frame, Placement
from needlefit.inference.fit import Fit
from needlefit.inference.forward_model import ParameterDraws
from needlefit.inference.predict import Draws
from needlefit.mechanics.control import Bevel, Step
from needlefit.mechanics.scene import Scene, begin_session
from needlefit.mechanics.shape import compute_positions
from needlefit.mechanics.simulate import simulate_steps
from needlefit.planning.aiming import Aim, ExecutionDraw, TargetSite, aim_straight, optimize_aim
from needlefit.planning.goals import (
    Ball,
    Goal,
    compute_clearances,
    cut_plane,
    find_hits,
    name_obstacles,
    read_goal_points,
)
from needlefit.planning.steering import (
    PlanLimits,
    StartedInsertion,
    SteeringPlan,
    find_reachable_region,
    plan_steering,
)
from needlefit.schemas.planning import ObstacleRecord
from needlefit.schemas.study import FitRecord
from needlefit.studies import further_insertion
from needlefit.studies.further_insertion import (
    WeightedPosterior,
    describe_posterior,
    find_specimen,
    find_template,
    move_to_specimen,
    weigh_posterior,
)
from needlefit.studies.held_out_predictions import PosteriorFit, Specimens
from needlefit.studies.job import Fold, Job, Settings, prepare
from needlefit.studies.kinds import plan as plan_kind
from needlefit.studies.kinds.plan import REPORT, PlanRecord
from needlefit.studies.report import write_run
from needlefit.viewer.opening import open_target
from needlefit.viewer.plans import begin_insertion
from needlefit.viewer.recording import read_recording, replay


@cache
def insertion() -> StartedInsertion:
    """Return a needle of phantom 2 at first contact."""
    return begin_insertion(open_target("phantom2"))


def uncertain(count: int = 96) -> StartedInsertion:
    """Return it with draws of its parameters: b to 20 %, moduli to a factor of 1.5."""
    rng, exact = np.random.default_rng(4), insertion().exact
    mu = exact.mu * np.exp(np.log(1.5) * rng.standard_normal((count, exact.mu.shape[1])))
    bevel = exact.bevel * np.exp(0.2 * rng.standard_normal(count))
    return replace(insertion(), draws=ParameterDraws(mu, np.repeat(exact.shape, count, 0), bevel))


def plan(target, radius=1.0, circles=(), start=None, **limits) -> SteeringPlan:
    """Return the plan past circles (x, y, radius), from first contact unless a start is given."""
    obstacles = tuple(
        ObstacleRecord(name=f"o{n}", centre_mm=(x, y), radius_mm=size)
        for n, (x, y, size) in enumerate(circles)
    )
    goal = Goal(tuple(target), radius, obstacles)
    return plan_steering(start or insertion(), goal, PlanLimits(**limits), threads=1)


def tip_of(*steps: Step) -> np.ndarray:
    one = insertion()
    shape = simulate_steps(one.needle, one.tissue, steps, one.rules)
    return compute_positions(shape, np.array([shape.depth]))[0]


def test_where_the_needle_goes_by_itself_nothing_is_moved() -> None:
    x, y = tip_of(replace(insertion().now, depth=40.0))
    found = plan((x, y))
    assert found.nominal_miss < 0.02 and found.turns == ()
    assert abs(found.end.controls.base_y) < 0.05 and abs(found.end.depth - 40.0) < 0.05
    other = plan((x, -y), base_mm=0.0, base_angle_deg=0.0, turns=0)
    assert other.turns == (0.0,) and other.nominal_miss < 0.02  # the bevel alone


def test_a_plan_is_the_needle_that_its_steps_simulate() -> None:
    found = plan((42.0, -1.5))
    tip = tip_of(*found.steps)
    assert tip == pytest.approx(found.nominal[-1], abs=1e-6)
    assert np.linalg.norm(tip - (42.0, -1.5)) == pytest.approx(found.nominal_miss, abs=1e-6)
    assert found.nominal_miss < 0.05
    assert found.steps[0].controls == insertion().now.controls  # the entry is where the needle lies
    assert abs(found.end.controls.base_y) > 0.1


def test_an_obstacle_on_the_way_is_passed_by() -> None:
    x, y = plan((45.0, 2.0)).nominal[20]
    found = plan((45.0, 2.0), circles=[(x, y, 0.5)], entry_mm=5)
    assert compute_clearances(found.nominal[None], found.goal.obstacles[0])[0] > 0.1
    assert found.nominal_miss < 0.2 and found.touched == {"o0": 0.0}
    # one that is just passed does not keep the tip from the target
    passed = plan((50.73, 0.17), 2.0, [(28.76, -0.45, 0.52)], base_mm=20)
    assert passed.hits and passed.nominal_miss < 0.1


def test_the_probability_is_that_of_draws_that_the_plan_was_not_sought_with() -> None:
    one = uncertain()
    found, tests = plan((40.0, 1.0), 0.1, start=one), one.samples[1]
    assert len(found.needles) == len(tests) == 64
    (shapes,) = one.simulate(tests, [found.steps], 1)
    tips = np.array([compute_positions(shapes[n], np.array([found.end.depth]))[0] for n in range(64)])
    assert found.hits == np.sum(np.linalg.norm(tips - found.goal.target, axis=1) <= 0.1)
    assert found.hits == np.sum(find_hits(found.needles, found.goal))
    assert 0.1 < found.probability < 1 and found.low < found.probability < found.high


@pytest.mark.sweep
def test_turning_the_bevel_lowers_the_risk_of_an_uncertain_bevel() -> None:
    straight, turned = (plan((45.0, 0.0), 0.5, start=uncertain(), turns=n) for n in (0, 2))
    assert turned.turns and turned.probability > straight.probability + 0.1


@pytest.mark.sweep
def test_a_plan_goes_on_from_where_the_needle_stands() -> None:
    view = open_target("phantom2")
    session = begin_session(Scene.from_record(view.record), view.first_cell)
    session.step(insert=15.3)
    session.step(base=(2.0, 0.0))
    found = plan((44.0, 1.0), start=replace(insertion(), path=session.input_path()))
    assert min(step.depth for step in found.steps) > 15.3 and found.nominal_miss < 0.1
    for step in found.steps:
        session.go(step)
    end = compute_positions(session.now.shape, np.array([session.depth]))[0]
    assert end == pytest.approx(found.nominal[-1], abs=1e-5)


@pytest.mark.sweep
@pytest.mark.parametrize(
    "target", [(45.0, 2.0), (45.0, -3.0), (38.0, 4.0), (52.0, 0.5), (45.0, 5.0), (33.0, -2.0)]
)
@pytest.mark.parametrize(
    "circle", [(25.0, 0.5, 1.0), (20.0, -0.5, 1.0), (30.0, 1.5, 1.5), (15.0, 0.0, 0.5), (35.0, 0.0, 1.0)]
)
def test_a_wider_range_never_finds_less(target, circle) -> None:
    found = [plan(target, 2.0, [circle], base_mm=base) for base in (5.0, 10.0, 15.0, 20.0)]
    hits = [one.hits for one in found]
    assert hits == sorted(hits)
    assert all(np.isfinite(one.nominal_miss) for one in found)


def test_within_the_radius_the_miss_is_least_and_a_limit_that_binds_is_named() -> None:
    free = plan((45.0, 1.0), 2.0)
    assert free.hits and free.nominal_miss < 0.3 and free.at_limit == ()
    bound = plan((45.0, 4.0), 5.0, base_mm=2, base_angle_deg=0)
    assert bound.hits and "base" in bound.at_limit


def test_a_plan_that_fails_prints_no_steps_and_how_near_it_comes(tmp_path, capsys) -> None:
    words = ("plan", "phantom2", "--target", "45,9", "--radius", "0.5", "--base", "2", "--turns", "0")
    path = tmp_path / "plan.csv"
    assert run(*words, "--recording", str(path)) == 5
    out = capsys.readouterr().out
    assert "nan" not in out and "insert" not in out and "base is at its limit" in out and not path.exists()
    assert run(*words, "--json") == 5
    found = json.loads(capsys.readouterr().out)
    assert not found["reached"] and found["steps"] == [] and found["at_limit"] == ["base", "base angle"]
    assert found["nominal_miss_mm"] > 0.5


def test_a_cancelled_search_ends() -> None:
    asked = iter([False, False, True])
    with pytest.raises(ModelError):
        plan_steering(insertion(), Goal((60.0, 2.0), 1.0), threads=1, cancelled=lambda: next(asked))


@pytest.mark.parametrize("x", [10.0, 300.0])
def test_a_target_behind_the_tip_or_out_of_reach_is_refused(x) -> None:
    with pytest.raises(ModelError):
        plan((x, 0.0), start=replace(insertion(), path=(replace(insertion().now, depth=20.0),)))


@pytest.mark.sweep
@pytest.mark.parametrize("depth", [0.0, 20.0])
def test_the_reachable_region_ends_where_plans_end(depth) -> None:
    there = replace(insertion(), path=(replace(insertion().now, depth=depth),))
    behind = find_reachable_region(there, there.now.depth - 10.0, threads=1)
    assert behind.x.shape == (0,) and behind.low.shape == (3, 0)  # the tip is beyond it
    region = find_reachable_region(there, 45.0, threads=1)
    assert region.x[0] == depth + 0.5 and abs(region.high[1][0] - region.low[1][0]) < (2.0 if depth else 0.1)
    for edge, sign in ((region.low[1][-1], -1), (region.high[1][-1], 1)):
        inside, outside = (plan((45.0, edge + sign * more), 0.3, start=there) for more in (-0.4, 1.0))
        assert inside.hits == 1 and outside.hits == 0
        assert outside.nominal_miss < 1.1  # the nearest that a plan gets


def test_the_plane_of_the_needle_contains_a_target_in_space() -> None:
    balls = (Ball("cut", (20.0, 1.0, 1.0), 1.0), Ball("beside", (20.0, -2.0, 2.0), 1.0))
    found = cut_plane((45.0, 3.0, 3.0), 1.5, balls)
    assert found.roll_deg == pytest.approx(45.0) and found.beside == ("beside",)
    assert found.goal.target == pytest.approx((45.0, np.hypot(3, 3)))
    (circle,) = found.goal.obstacles
    assert circle.centre_mm == pytest.approx((20.0, np.sqrt(2))) and circle.radius_mm == pytest.approx(1.0)
    assert cut_plane((45.0, -3.0, 0.0), 1.5, ()).goal.target == (45.0, -3.0)
    other = cut_plane((45.0, -2.0, 1.0), 1.5, ())
    assert other.goal.target == pytest.approx((45.0, -np.sqrt(5)))
    assert other.roll_deg == pytest.approx(-np.degrees(np.arctan(0.5)))
    assert cut_plane((45.0, 0.0, -2.0), 1.5, ()).goal.target == pytest.approx((45.0, 2.0))


def test_points_of_slicer_are_targets_and_obstacles_in_the_constraint_frame(tmp_path) -> None:
    placement = Placement(Frame(np.array([10.0, 0.0, 0.0]), np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])))
    listed = [point(1, [10, 45, 0], label="Target 1"), point(2, [9, 20, 0.5], label="vessel")]
    path = save(tmp_path / "a.mrk.json", markup(points=listed))
    target, balls = read_goal_points(path, placement, 2.5)
    assert target == pytest.approx((45.0, 0.0, 0.0))
    assert balls[0].name == "vessel" and balls[0].radius == 2.5
    assert balls[0].centre == pytest.approx((20.0, 1.0, 0.5))
    alone, none = read_goal_points(save(tmp_path / "b.mrk.json", markup(points=[listed[1]])), placement, 1.0)
    assert alone is not None and none == ()
    twice = save(tmp_path / "c.mrk.json", markup(points=[listed[0], listed[0] | {"id": "9"}]))
    with pytest.raises(DataError):
        read_goal_points(twice, placement, 1.0)


def test_an_obstacle_has_the_name_of_its_label_or_a_number_of_its_own() -> None:
    labels = ["vessel", "", " bone\n1 ", "vessel", "obstacle 1", "=1+1", "x" * 300, "a\x00b"]
    names = name_obstacles(labels)
    assert names[:6] == ("vessel", "obstacle 2", "bone 1", "vessel 2", "obstacle 1", "obstacle 3")
    assert names[6:] == ("x" * 40, "obstacle 4")
    circles = cut_plane((40.0, 1.0, 0.0), 1.0, tuple(Ball(name, (20.0, 0.0, 0.0), 1.0) for name in names))
    assert tuple(one.name for one in circles.goal.obstacles) == names


def test_the_command_prints_a_plan_and_writes_it_as_a_recording(tmp_path, capsys) -> None:
    path = tmp_path / "plan.csv"
    words = ("phantom2", "--target", "45,2", "--obstacle", "25,0.4,0.8", "--entry", "5", "--json")
    assert run("plan", *words, "--recording", str(path)) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["reached"] and found["nominal_miss_mm"] < 0.2 and found["draws"] == 0
    assert found["steps"][-1]["depth_mm"] == pytest.approx(45.0, abs=1.0)
    *_, last = replay(read_recording(path))
    assert last.tip_offset_mm == 0
    assert last.state.step.depth == found["steps"][-1]["depth_mm"]
    entry = read_recording(path).head.scene.entry
    assert entry.y_mm == pytest.approx(found["entry_mm"]) and abs(entry.y_mm) <= 5


@pytest.mark.sweep
def test_the_bevel_of_a_path_angle_scene_is_planned_too() -> None:
    rules = replace(insertion().rules, advance="path_angle")
    start = Step(0.0, Bevel(cut_angle=0.05), insertion().now.controls)
    assert plan((40.0, -1.0), start=replace(insertion(), rules=rules, path=(start,))).nominal_miss < 0.1


CHICKEN = {
    "schema": 1,
    "kind": "plan",
    "dataset": "twin",
    "medium": "chicken",
    "recipe": "quick",
    "template_insertion": "chicken-02",
    "target_mm": [45, 3],
    "tune": {"insertions": ["chicken-01"]},
    "entry_plane": {"offset_mm": [-10, 10], "angle_deg": [-10, 10], "depth_mm": [30, 60]},
}
SOFT = {"mu1_pa": 2e4, "alpha1": 1.0, "bevel_mm": 0.2}
AHEAD = {"offset_mm": [-0.1, 0.1], "angle_deg": [-0.1, 0.1], "depth_mm": [30, 60]}


@cache
def job() -> Job:
    return prepare("test", PlanRecord.model_validate(CHICKEN).tuning(), Settings())


def site(**changed: object) -> TargetSite:
    return plan_kind.make_site(job(), PlanRecord.model_validate({**CHICKEN, **changed}))


@pytest.fixture
def few_draws(monkeypatch) -> None:
    effort = replace(further_insertion.PLANNING_EFFORT, draws=100, min_ess=100.0)
    monkeypatch.setattr(further_insertion, "PLANNING_EFFORT", effort)
    monkeypatch.setattr(plan_kind, "SEARCH_DRAWS", 2)
    monkeypatch.setattr(plan_kind, "TEST_DRAWS", 6)


def optimize(where: TargetSite, values: dict[str, float]) -> Aim:
    return optimize_aim(where, [ExecutionDraw(values)], values)


def test_without_a_bevel_the_best_plan_is_the_straight_aim():
    found, aimed = (
        optimize(site(), {**SOFT, "bevel_mm": 0.0}),
        aim_straight(site().entry_plane, (45.0, 3.0), 0.0, 1),
    )
    assert found.rms < 1e-3
    assert (found.offset, found.angle, found.depth) == pytest.approx((3.0, 0.0, 45.0), abs=1e-3)
    assert (aimed.offset, aimed.depth) == (3.0, 45.0)


def test_a_target_on_the_other_side_turns_the_bevel_over():
    """Straight ahead, only bending reaches beside the axis."""
    one, other = (optimize(site(target_mm=[45, y], entry_plane=AHEAD), SOFT) for y in (1.5, -1.5))
    assert (one.side, other.side) == (1, -1)
    assert one.rms == pytest.approx(other.rms, abs=1e-4)
    assert one.depth == pytest.approx(other.depth, abs=1e-2)


def test_a_plan_passes_by_an_obstacle_on_the_straight_way():
    obstacle = ObstacleRecord(name="vessel", centre_mm=(25.0, 2.0), radius_mm=2.0, margin_mm=0.5)
    where = site(obstacles=[obstacle.model_dump()])
    (path,) = where.find_paths(optimize(where, SOFT), [ExecutionDraw(SOFT)], SOFT)
    assert compute_clearances(path[None], obstacle)[0] > 0.49
    assert np.linalg.norm(path[-1] - (45.0, 3.0)) < 0.02


@pytest.mark.parametrize(("centre", "clearance"), [((5, 3), 2.0), ((13, 4), 4.0), ((5, 0.5), -0.5)])
def test_clearance_is_the_distance_from_the_rim(centre, clearance):
    line = np.array([[[0.0, 0.0], [10.0, 0.0]]])
    obstacle = ObstacleRecord(name="a", centre_mm=centre, radius_mm=1)
    assert compute_clearances(line, obstacle) == pytest.approx(clearance)


def test_errors_of_the_entry_move_the_tip_as_a_rigid_body():
    aim = aim_straight(site().entry_plane, (45.0, 3.0), 5.0, 1)
    there, shifted = (site().execute(aim, ExecutionDraw(SOFT, across)) for across in (0.0, 0.3))
    turn = np.radians(5.0)
    assert shifted - there == pytest.approx(np.tile([-0.3 * np.sin(turn), 0.3 * np.cos(turn)], (41, 1)))


def posterior(theta: np.ndarray) -> WeightedPosterior:
    """Return one certain draw as the posterior."""
    fit = Fit(tuple(theta), {}, 0.0, (), 1, 0, interrupted=False)
    learned = PosteriorFit(fit, Draws(theta[None], "importance"), 0.0)
    problem = job().problem(job().folds[0])
    return WeightedPosterior(problem, learned, theta[None], np.ones(1), 0.1, problem.new_bevel_sd)


def test_needles_differ_by_bevel_and_in_a_new_specimen_by_its_parameters():
    (fold,) = job().folds
    theta = job().parameters.theta({**SOFT, "bevel_spread": 0.1})
    # so small that no draw meets a bound
    stated = job().recipe.specimens.model_copy(update={"modulus_factor": 2.0, "bevel_factor": 1.2})
    recipe = job().recipe.model_copy(update={"specimens": stated})
    known, rng = Specimens(replace(job(), recipe=recipe), fold), np.random.default_rng(1)
    sds = {}
    for name, into in (("same", site().like), ("new", None)):
        moved = move_to_specimen(posterior(theta), known, into, rng)
        sets = [one.values for one in plan_kind.draw_trials(job(), site().like, moved, 4000)]
        sds[name] = [np.std(np.log([values[key] for values in sets])) for key in ("bevel_mm", "mu1_pa")]
    # of one insertion: its bevel is the mean of those fitted to
    assert sds["same"][0] == pytest.approx(0.1 * np.sqrt(2), rel=0.05) and sds["same"][1] < 1e-9
    # of the new specimen, and of the one tuned on
    bevel = np.hypot(0.1 * np.sqrt(2), np.sqrt(2) * np.log(1.2))
    assert sds["new"] == pytest.approx([bevel, np.sqrt(2) * np.log(2)], rel=0.05)


@pytest.mark.parametrize(
    ("tuned", "stated", "differs"),
    [(True, None, False), (True, "new", True), (False, None, True), (False, "same", False)],
)
def test_the_template_s_specimen_decides_unless_the_study_does(tuned, stated, differs):
    specimens = {one.specimen for one in job().folds[0].tune}
    template = next(one for one in job().dataset.insertions if (one.specimen in specimens) == tuned)
    assert (find_specimen(job(), template, stated) is None) == differs


def test_the_answer_is_tried_on_fresh_draws_and_written(world):
    answer = world.restore("plan")
    plans = answer.frames["plans"].set_index("method")
    assert plans["rms_mm"]["expected"] < plans["rms_mm"]["straight"]
    misses = answer.frames["misses"].query("method == 'expected'")["miss_mm"]
    assert len(misses) == plan_kind.TEST_DRAWS
    beyond = answer.frames["exceedances"].set_index(["method", "limit_mm"])["share"]
    assert beyond["expected", 1.0] == pytest.approx((misses > 1.0).mean())
    written = {path.name for path in world.find("plan").iterdir()}
    assert {"plane.pdf", "plane.csv", "within.pdf", "within.csv", "report.pdf"} <= written


@pytest.mark.sweep
def test_a_plan_of_draws_that_are_not_certified_has_no_misses(tmp_path, monkeypatch, few_draws):
    weigh, fault = plan_kind.weigh_posterior, "draws by importance are not certified"

    def weigh_uncertified(*given):
        known = weigh(*given)
        draws = replace(known.learned.draws, faults=(fault,))
        return replace(known, learned=replace(known.learned, draws=draws))

    monkeypatch.setattr(plan_kind, "weigh_posterior", weigh_uncertified)
    answer = plan_kind.run("aim", PlanRecord.model_validate(CHICKEN), Settings())
    assert answer.faults == (fault,)
    assert answer.frames["misses"].empty and answer.frames["plans"]["median_mm"].isna().all()
    assert answer.frames["exceedances"]["share"].isna().all()
    (verdict,) = answer.verdicts
    assert verdict.status == "warn" and verdict.sentence.startswith("NOT CERTIFIED. ")
    written = {path.name for path in write_run(answer, tmp_path / "out").iterdir()}
    assert "plane.pdf" in written and "within.pdf" not in written


@pytest.mark.parametrize(
    ("target", "message"), [([500, 400], "depth_mm ends at 60 mm"), ([-3, 0], "before the entrance")]
)
def test_a_target_out_of_reach_is_refused(target, message):
    with pytest.raises(ValueError, match=message):
        PlanRecord.model_validate({**CHICKEN, "target_mm": target})


def test_a_plan_out_of_reach_is_reported_with_its_parameters_at_bounds(few_draws):
    """Straight ahead and 30 mm deep at most, a place 4 mm to the side is out of reach."""
    entry_plane = {**AHEAD, "depth_mm": [20, 30]}
    record = {**CHICKEN, "target_mm": [29, 4], "tolerances_mm": [1.0], "entry_plane": entry_plane}
    answer = plan_kind.run("aside", PlanRecord.model_validate(record), Settings())
    (fault,) = (one for one in answer.faults if "no plan" in one)
    assert "1 mm" in fault
    assert "(29, 4 mm)" in REPORT.summarize(answer)[0] and "offset, angle" in REPORT.summarize(answer)[0]
    (table, _) = REPORT.lay_out(answer)
    assert "0.1*" in table.rows[0] and "(*" in table.caption


def test_a_further_insertion_has_the_parameters_of_its_specimen(monkeypatch):
    """Specimen 2 is twice as stiff; the draws of all insertions together are not certified."""
    ids = ["chicken-01", "chicken-02", "chicken-03", "chicken-04"]
    table = {"schema": 1, "dataset": "twin", "medium": "chicken", "recipe": "quick"}
    record = FitRecord.model_validate({**table, "tune": {"insertions": ids}})
    tuned = prepare("two", record, Settings())
    first, second = dict.fromkeys(one.specimen for one in tuned.folds[0].tune)
    theta = tuned.parameters.theta({"mu1_pa": 1e4, "bevel_mm": 0.2, "bevel_spread": 0.01})
    noise = np.array([0.1, 0.02, 0.02])[: len(theta)] * np.random.default_rng(1).standard_normal((1000, 3))
    mu = tuned.parameters.free.index("mu1_pa")
    stiffer = math.log(2.0) * (np.arange(len(theta)) == mu)
    drawn = {first: theta + noise, second: theta + stiffer + noise}
    monkeypatch.setattr(Specimens, "_sample_specimen", lambda self, name: Draws(drawn[name], "importance"))
    pooled = PosteriorFit(
        Fit(tuple(theta), {}, 0.0, (), 1, 0, interrupted=False),
        Draws(theta + noise, "importance", ("not certified",)),
        0.9,
        sampled=True,
    )
    monkeypatch.setattr(further_insertion, "fit_posterior", lambda *_: pooled)
    for specimen, template in ((first, "chicken-01"), (second, "chicken-04")):
        into = find_specimen(tuned, find_template(tuned, template), None)
        found = weigh_posterior(tuned, into, Settings())
        assert into.specimen == specimen and describe_posterior(found)["note"] == ""
        about = found.thetas[:, mu] - theta[mu]
        assert found.weights @ about == pytest.approx(stiffer[mu] * (specimen == second), abs=0.02)
        assert math.sqrt(found.weights @ about**2 - (found.weights @ about) ** 2) == pytest.approx(
            0.1, rel=0.1
        )
    # one insertion into each: the spread between specimens contains the deviation of its bevel
    alone = Fold("all", tuned.folds[0].tune[2:], ())
    assert Specimens(replace(tuned, folds=(alone,)), alone).bevel_sd_in(None) == 0.0
    moved = weigh_posterior(
        tuned, find_specimen(tuned, find_template(tuned, "chicken-01"), "new"), Settings()
    )
    middle, sd = np.mean(moved.thetas[:, mu]), np.std(moved.thetas[:, mu])
    assert middle - theta[mu] == pytest.approx(0.5 * math.log(2.0), abs=0.1) and sd > 0.4
    with pytest.raises(ConfigError) as caught:
        find_specimen(tuned, find_template(tuned, "phantom2-06"), "same")
    assert caught.value.key == "specimen" and all(one in caught.value.expected for one in (first, second))
