"""A plan: straight where nothing bends the needle, mirrored where the target is, away from obstacles."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from needlefit.inference.fit import Fit
from needlefit.inference.predict import Draws
from needlefit.planning.aiming import Aim, ExecutionDraw, TargetSite, aim_straight, optimize_aim
from needlefit.planning.goals import compute_clearances
from needlefit.schemas.planning import ObstacleRecord
from needlefit.studies import further_insertion
from needlefit.studies.further_insertion import WeightedPosterior
from needlefit.studies.job import Job, Settings, prepare
from needlefit.studies.kinds import plan
from needlefit.studies.kinds.plan import REPORT, PlanRecord
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
    return plan.make_site(job(), PlanRecord.model_validate({**CHICKEN, **changed}))


@pytest.fixture
def few_draws(monkeypatch) -> None:
    effort = replace(further_insertion.PLANNING_EFFORT, draws=100, min_ess=100.0)
    monkeypatch.setattr(further_insertion, "PLANNING_EFFORT", effort)
    monkeypatch.setattr(plan, "SEARCH_DRAWS", 2)
    monkeypatch.setattr(plan, "TEST_DRAWS", 6)


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
    return WeightedPosterior(job().problem(job().folds[0]), learned, theta[None], np.ones(1), 0.1)


def test_needles_differ_by_bevel_and_in_a_new_specimen_by_its_parameters():
    (fold,) = job().folds
    theta = job().parameters.theta({**SOFT, "bevel_spread": 0.1})
    unknown = {one.specimen: None for one in job().dataset.insertions}  # the stated spread alone is left
    # so small that no draw meets a bound
    stated = job().recipe.specimens.model_copy(update={"modulus_factor": 2.0, "bevel_factor": 1.2})
    recipe = job().recipe.model_copy(update={"specimens": stated})
    new = NewSpecimens(replace(job(), recipe=recipe), fold, theta, unknown)
    sds = {}
    for name, about in (("same", None), ("new", new)):
        sets = [one.values for one in plan.draw_trials(job(), site().like, posterior(theta), about, 4000)]
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
    found = plan.find_new_specimen(job(), stated, template, posterior(np.empty(0)))
    assert (found is not None) == differs


def test_the_answer_is_tried_on_fresh_draws_and_written(world):
    answer = world.restore("plan")
    plans = answer.frames["plans"].set_index("method")
    assert plans["rms_mm"]["expected"] < plans["rms_mm"]["straight"]
    misses = answer.frames["misses"].query("method == 'expected'")["miss_mm"]
    assert len(misses) == plan.TEST_DRAWS
    beyond = answer.frames["exceedances"].set_index(["method", "limit_mm"])["share"]
    assert beyond["expected", 1.0] == pytest.approx((misses > 1.0).mean())
    written = {path.name for path in world.find("plan").iterdir()}
    assert {"plane.pdf", "plane.csv", "within.pdf", "within.csv", "report.pdf"} <= written


@pytest.mark.sweep
def test_a_plan_of_draws_that_are_not_certified_has_no_misses(tmp_path, monkeypatch, few_draws):
    weigh, fault = plan.weigh_posterior, "draws by importance are not certified"

    def weigh_uncertified(*given):
        known = weigh(*given)
        draws = replace(known.learned.draws, faults=(fault,))
        return replace(known, learned=replace(known.learned, draws=draws))

    monkeypatch.setattr(plan, "weigh_posterior", weigh_uncertified)
    answer = plan.run("aim", PlanRecord.model_validate(CHICKEN), Settings())
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
    answer = plan.run("aside", PlanRecord.model_validate(record), Settings())
    (fault,) = (one for one in answer.faults if "no plan" in one)
    assert "1 mm" in fault
    assert "(29, 4 mm)" in REPORT.summarize(answer)[0] and "offset, angle" in REPORT.summarize(answer)[0]
    (table, _) = REPORT.lay_out(answer)
    assert "0.1*" in table.rows[0] and "(*" in table.caption
