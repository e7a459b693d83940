"""A plan: straight where nothing bends the needle, mirrored where the target is, away from obstacles."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from needlefit.inference.fit import Fit
from needlefit.inference.predict import Draws
from needlefit.studies.job import Job, Settings, prepare
from needlefit.studies.kinds.plan import candidates, run
from needlefit.studies.kinds.plan.aiming import (
    TargetSite,
    aim_straight,
    clearance,
    execute_exactly,
    optimize_aim,
)
from needlefit.studies.kinds.plan.candidates import WeightedPosterior, find_template
from needlefit.studies.kinds.plan.report import lay_out_tables, summarize
from needlefit.studies.kinds.plan.schema import ObstacleRecord, PlanRecord
from needlefit.studies.new_specimens import NewSpecimens
from needlefit.studies.posterior_fit import PosteriorFit
from needlefit.studies.report import write_run

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
    record = PlanRecord.model_validate({**CHICKEN, **changed})
    return TargetSite(job(), find_template(job(), record.template_insertion), record)


def test_without_a_bevel_the_best_plan_is_the_straight_aim():
    where = site()
    values = {**SOFT, "bevel_mm": 0.0}
    found = optimize_aim(where, [execute_exactly(values)], values)
    aimed = aim_straight(where.record.entry_plane, (45.0, 3.0), 0.0, 1)
    assert found.rms < 1e-3
    assert (found.aim.offset, found.aim.angle, found.aim.depth) == pytest.approx((3.0, 0.0, 45.0), abs=1e-3)
    assert (aimed.offset, aimed.depth) == (3.0, 45.0)


def test_a_target_on_the_other_side_turns_the_bevel_over():
    """Straight ahead, only bending reaches beside the axis."""
    plans = {}
    for y in (1.5, -1.5):
        plans[y] = optimize_aim(site(target_mm=[45, y], entry_plane=AHEAD), [execute_exactly(SOFT)], SOFT)
    assert [plans[y].aim.side for y in (1.5, -1.5)] == [1, -1]
    assert plans[1.5].rms == pytest.approx(plans[-1.5].rms, abs=1e-4)
    assert plans[1.5].aim.depth == pytest.approx(plans[-1.5].aim.depth, abs=1e-2)


def test_a_plan_passes_by_an_obstacle_on_the_straight_way():
    obstacle = ObstacleRecord(name="vessel", centre_mm=(25.0, 2.0), radius_mm=2.0, margin_mm=0.5)
    where = site(obstacles=[obstacle.model_dump()])
    found = optimize_aim(where, [execute_exactly(SOFT)], SOFT)
    (path,) = where.paths(found.aim, [execute_exactly(SOFT)], SOFT)
    assert clearance(path, obstacle) > 0.49
    assert np.linalg.norm(path[-1] - (45.0, 3.0)) < 0.02


def test_clearance_is_the_distance_from_the_rim():
    line = np.array([[0.0, 0.0], [10.0, 0.0]])
    assert clearance(line, ObstacleRecord(name="a", centre_mm=(5, 3), radius_mm=1)) == pytest.approx(2.0)
    assert clearance(line, ObstacleRecord(name="a", centre_mm=(13, 4), radius_mm=1)) == pytest.approx(4.0)
    assert clearance(line, ObstacleRecord(name="a", centre_mm=(5, 0.5), radius_mm=1)) == pytest.approx(-0.5)


def test_errors_of_the_entry_move_the_tip_as_a_rigid_body():
    where = site()
    aim = aim_straight(where.record.entry_plane, (45.0, 3.0), 5.0, 1)
    plain = execute_exactly(SOFT)
    there, shifted = (where.executed(aim, one) for one in (plain, replace(plain, across=0.3)))
    turn = np.radians(5.0)
    assert shifted - there == pytest.approx(np.tile([-0.3 * np.sin(turn), 0.3 * np.cos(turn)], (41, 1)))


def test_needles_differ_by_bevel_and_in_a_new_specimen_by_its_parameters():
    where, (fold,) = site(), job().folds
    theta = job().parameters.theta({**SOFT, "bevel_spread": 0.1})
    fit = Fit(tuple(theta), {}, 0.0, (), 1, 0, interrupted=False)
    learned = PosteriorFit(fit, Draws(theta[None], "importance"), 0.0)
    known = WeightedPosterior(job().problem(fold), learned, theta[None], np.ones(1), 0.1)
    unknown = {one.specimen: None for one in job().dataset.insertions}  # the stated spread alone is left
    # so small that no draw meets a bound
    stated = job().recipe.specimens.model_copy(update={"modulus_factor": 2.0, "bevel_factor": 1.2})
    recipe = job().recipe.model_copy(update={"specimens": stated})
    new = NewSpecimens(replace(job(), recipe=recipe), fold, theta, unknown)
    bevel, moduli = {}, {}
    for name, about in (("same", None), ("new", new)):
        sets = [one.values for one in run._draw_trials(where, known, about, 4000)]
        bevel[name], moduli[name] = (
            np.std(np.log([values[key] for values in sets])) for key in ("bevel_mm", "mu1_pa")
        )
    # of one insertion: its bevel is the mean of those fitted to
    assert bevel["same"] == pytest.approx(0.1 * np.sqrt(2), rel=0.05) and moduli["same"] < 1e-9
    # of the new specimen, and of the one tuned on
    assert moduli["new"] == pytest.approx(np.sqrt(2) * np.log(2), rel=0.05)
    assert bevel["new"] == pytest.approx(np.hypot(0.1 * np.sqrt(2), np.sqrt(2) * np.log(1.2)), rel=0.05)


def test_the_template_s_specimen_decides_unless_the_study_does():
    fit = Fit((), {}, 0.0, (), 1, 0, interrupted=False)
    draws = Draws(np.empty((1, 0)), "importance")
    problem, learned = job().problem(job().folds[0]), PosteriorFit(fit, draws, 0.0)
    known = WeightedPosterior(problem, learned, draws.thetas, np.ones(1), 0.1)
    tuned = {one.specimen for one in job().folds[0].tune}
    other = next(one.id for one in job().dataset.insertions if one.specimen not in tuned)
    for template, stated, differs in (
        ("chicken-01", None, False),
        ("chicken-01", "new", True),
        (other, None, True),
        (other, "same", False),
    ):
        where = site(template_insertion=template, specimen=stated)
        assert (run._find_new_specimen(where, known) is not None) == differs


@pytest.mark.sweep
def test_the_answer_is_tried_on_fresh_draws_and_written(tmp_path, monkeypatch):
    monkeypatch.setattr(run, "SEARCH_DRAWS", 8)
    monkeypatch.setattr(run, "TEST_DRAWS", 20)
    monkeypatch.setattr(
        candidates, "PLANNING_EFFORT", replace(candidates.PLANNING_EFFORT, draws=100, min_ess=100.0)
    )
    answer = run.run("aim", PlanRecord.model_validate(CHICKEN), Settings())
    plans = answer.frames["plans"].set_index("method")
    assert plans["rms_mm"]["expected"] < plans["rms_mm"]["straight"]
    rows = answer.frames["misses"]
    misses = rows[rows["method"] == "expected"]["miss_mm"]
    assert len(misses) == 20
    beyond = answer.frames["exceedances"].set_index(["method", "limit_mm"])["share"]
    assert beyond["expected", 1.0] == pytest.approx((misses > 1.0).mean())
    assert "45" in summarize(answer)[0]
    written = {path.name for path in write_run(answer, tmp_path / "out").iterdir()}
    assert {"plane.pdf", "plane.csv", "within.pdf", "within.csv", "report.pdf"} <= written


@pytest.mark.sweep
def test_a_plan_of_draws_that_are_not_certified_has_no_misses(tmp_path, monkeypatch):
    monkeypatch.setattr(run, "SEARCH_DRAWS", 2)
    monkeypatch.setattr(run, "TEST_DRAWS", 6)
    weigh = run.weigh_posterior

    def weigh_uncertified(*given):
        known = weigh(*given)
        draws = replace(known.learned.draws, faults=("draws by importance are not certified",))
        return replace(known, learned=replace(known.learned, draws=draws))

    monkeypatch.setattr(run, "weigh_posterior", weigh_uncertified)
    answer = run.run("aim", PlanRecord.model_validate(CHICKEN), Settings())
    assert answer.faults == ("draws by importance are not certified",)
    assert answer.frames["misses"].empty and answer.frames["plans"]["median_mm"].isna().all()
    assert answer.frames["exceedances"]["share"].isna().all()
    (verdict,) = answer.verdicts
    assert verdict.status == "warn" and verdict.sentence.startswith("NOT CERTIFIED. ")
    written = {path.name for path in write_run(answer, tmp_path / "out").iterdir()}
    assert "plane.pdf" in written and "within.pdf" not in written


def test_a_target_out_of_reach_is_refused():
    for target, message in (([500, 400], "depth_mm ends at 60 mm"), ([-3, 0], "before the entrance")):
        with pytest.raises(ValueError, match=message):
            PlanRecord.model_validate({**CHICKEN, "target_mm": target})


def test_a_plan_out_of_reach_is_reported_with_its_parameters_at_bounds(monkeypatch):
    """Straight ahead and 30 mm deep at most, a place 4 mm to the side is out of reach."""
    monkeypatch.setattr(run, "SEARCH_DRAWS", 2)
    monkeypatch.setattr(run, "TEST_DRAWS", 6)
    monkeypatch.setattr(
        candidates, "PLANNING_EFFORT", replace(candidates.PLANNING_EFFORT, draws=100, min_ess=100.0)
    )
    entry_plane = {**AHEAD, "depth_mm": [20, 30]}
    record = {**CHICKEN, "target_mm": [29, 4], "tolerances_mm": [1.0], "entry_plane": entry_plane}
    answer = run.run("aside", PlanRecord.model_validate(record), Settings())
    (fault,) = (one for one in answer.faults if "no plan" in one)
    assert "1 mm" in fault
    result = summarize(answer)[0]
    assert "(29, 4 mm)" in result and "offset, angle" in result
    (table, _) = lay_out_tables(answer)
    assert "0.1*" in table.rows[0] and "(*" in table.caption
