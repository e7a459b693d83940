"""Needles in space: rolls and turns as stated, residuals along y and z, predictions across the needle."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import scipy
from inference_cases import (
    NEEDLE,
    TRUTH,
    assert_objective_slope,
    assert_one_density,
    dataset,
    insertion,
    medium,
)
from numpy.random import default_rng
from numpy.testing import assert_allclose
from problem_cases import make_problem
from pytest import approx
from research.simulated_data import simulate_measurement
from test_datasets import CURVE, record, row

from needlefit import Scene, simulate_steps
from needlefit.datasets.compared import find_curve_roll, leaves_plane, set_compared, turns_out_of_plane
from needlefit.datasets.read import check, read
from needlefit.datasets.write import write_dataset
from needlefit.errors import ConfigError, DataError
from needlefit.geometry.curves import compare_curves, integrate_curvature
from needlefit.inference.baseline_fit import fit_baselines
from needlefit.inference.forward_model import predict
from needlefit.inference.identifiability.profile import minimize_squares
from needlefit.inference.likelihood.pose_errors import turn_about_x
from needlefit.inference.parameters import make_tissue
from needlefit.inference.predictive_mixture import find_geometric_median
from needlefit.mechanics.shape import sample_inserted_points
from needlefit.mechanics.torsion import compute_roll_lag
from needlefit.planning.insertion_scene import make_scene_record
from needlefit.schemas.recipe import LikelihoodRecord
from needlefit.studies.prediction_scores import score_tip_in_space

TURNED = {
    "insertions": {"file": "insertions.csv", "turns": "turns.csv"},
    "media": {"given": {"boundaries_mm": [20.0]}},
}
FREE = LikelihoodRecord(bevel_spread=0.0)
BY_CURVATURE = LikelihoodRecord(bevel_spread=0.0, measurement="curvature")


def turned(depth=40.0, turns=((18.0, 90.0),), **changes):
    """An insertion through two layers whose bevel turns on the way, measured without errors."""
    planned = replace(insertion(depth, (12.0,), (1, 2)), turns=turns, **changes)
    points = sample_inserted_points(predict(TRUTH, medium(), planned), 101)
    return planned.with_points(points)


def in_space(made, how=FREE, compared="space"):
    data = replace(dataset(made), compared=compared)
    return make_problem(data, made, medium(), how)


def test_values_gradients_and_residuals_in_space_are_of_one_density():
    made = [turned(boundary_sd=0.4, depth_sd=0.3), turned(35.0, ((10.0, -90.0), (22.0, 180.0)), side=-1)]
    p = in_space(made, LikelihoodRecord())
    theta = p.parameters.theta({**TRUTH, "mu1_pa": 5e5, "bevel_mm": 0.1, "bevel_cv": 0.1})
    assert_one_density(p, theta)
    assert_objective_slope(p, theta)
    exact = p.with_parameters(replace(p.parameters)).objective(p.parameters.theta({**TRUTH, "bevel_cv": 0.1}))
    assert exact < 1e-4


def test_needles_in_one_plane_have_the_same_likelihood_in_space():
    made = [turned(40.0, ()), turned(33.0, (), side=-1)]
    one, two = (in_space(made, compared=compared) for compared in ("plane", "space"))
    thetas = [one.parameters.theta({**TRUTH, "mu1_pa": mu, "bevel_mm": 0.09}) for mu in (2e5, 6e5)]
    gaps = [p.log_posterior(thetas[0]) - p.log_posterior(thetas[1]) for p in (one, two)]
    assert gaps[0] == approx(gaps[1], rel=1e-9) and abs(gaps[0]) > 0.1


def test_a_roll_and_turns_of_the_pose_out_of_the_plane_cost_what_their_priors_say():
    exact = turned(turns=())
    points, quiet = exact.points, {"pose_angle_sd": 0.0}
    theta = in_space([exact]).parameters.theta(TRUTH)
    noise = replace(dataset([exact]).noise, registration_mean=0.0, point_sd=0.05, correlated_sd=0.0)
    angle = 0.01
    rolled = turn_about_x(points, angle)
    tilted = points + np.column_stack([0 * points[:, :2], angle * points[:, 0]])
    for moved, sds in ((rolled, {"roll_sd": 0.05}), (tilted, {"pose_angle_sd": 0.05, "roll_sd": 1e-9})):
        one = replace(exact, **(quiet | sds))
        pair = [one, one.with_points(moved)]
        values = [replace(in_space([o]), noise=noise).log_posterior(theta) for o in pair]
        # half the square of the angle in SDs, and what the noise adds to these
        assert values[0] - values[1] == approx(angle**2 / 2 / 0.05**2, rel=0.02)


def test_an_insertion_is_the_same_whatever_direction_has_a_roll_of_0(tmp_path):
    """The bevel faces y; turned frames state rolls of 0, 30 and -90 degrees, and the same turn."""
    in_world = CURVE + np.column_stack([0 * CURVE[:, :2], 1e-4 * np.maximum(CURVE[:, 0] - 25, 0) ** 2])
    found = []
    for degrees in (0.0, 30.0, -90.0):
        angle = math.radians(degrees)
        toward = np.array([0.0, math.cos(angle), -math.sin(angle)])
        turns = ((25.0, angle + math.pi / 2),)
        one = row("a", "given", layers=2, bevel=toward, roll=angle, roll_sd=0.02, turns=turns)
        tables = record(**TURNED)
        file = write_dataset(tmp_path / f"{degrees:g}", tables, [one], {"a": in_world}, {}, checksums=False)
        assert check(file) == []
        found.append(read(file).insertions[0])
    for one in found:
        assert_allclose(one.points[:, :2], found[0].points[:, :2], atol=1e-4)
        assert_allclose(one.points[:, 2], in_world[:, 2], atol=1e-4)
        assert np.ravel(one.turns) == approx((25.0, 90.0), abs=1e-3)
        assert one.side == 1 and one.roll_sd == approx(0.02, abs=1e-4)


@pytest.mark.parametrize(
    ("rows", "row_changes", "pose", "place"),
    [
        (["b,20,90"], {}, "known", "turns.csv:2"),
        (["a,20,90", "a,15,180"], {}, "known", "turns.csv:3"),
        (["a,60,90"], {}, "known", "turns.csv:2"),
        ([], {"roll": math.pi}, "both", "insertions.csv:2"),
        ([], {"roll": 1.0, "bevel": None}, "known", "insertions.csv:2"),
        (["a,20,90"], {}, "free", "dataset.toml"),
    ],
)
def test_rolls_and_turns_that_contradict_are_faults(tmp_path, rows, row_changes, pose, place):
    one = row("a", "given", layers=2, **({"bevel": np.array([0.0, 1, 0])} | row_changes))
    tables = record(**TURNED)
    file = write_dataset(tmp_path, tables, [one], {"a": CURVE}, {}, checksums=False)
    (tmp_path / "turns.csv").write_text("\n".join(["id,depth_mm,bevel_roll_deg", *rows, ""]))
    if pose == "both":
        table = pd.read_csv(tmp_path / "insertions.csv").assign(bevel_side=1)
        table.to_csv(tmp_path / "insertions.csv", index=False)
    if pose == "free":
        file.write_text(file.read_text().replace('pose = "known"', 'pose = "free"'))
    assert any(place in fault.where for fault in check(file))


def test_the_data_decide_where_needles_are_compared():
    flat, half, quarter = turned(turns=()), turned(35.0, ((18.0, 180.0),)), turned()
    assert [turns_out_of_plane(one) for one in (flat, half, quarter)] == [False, False, True]
    data = dataset([flat, half, quarter])
    for insertions, stated, compared in (
        ([flat, half], None, "plane"),
        ([flat, quarter], None, "space"),
        ([flat], "space", "space"),
        ([quarter], "plane", "plane"),
    ):
        assert set_compared(data, insertions, stated).compared == compared
    # in one plane a quarter turn is none, and a larger one a half turn
    more = turned(turns=((10.0, 90.0), (20.0, 140.0)))
    kept = set_compared(dataset([more]), [more], "plane").insertions[0]
    assert kept.turns == ((10.0, 0.0), (20.0, 180.0))
    # 10 degrees are two SDs of a roll of 5, and ten of one of 1
    points = turn_about_x(flat.points, math.radians(10.0))
    bent = replace(flat, pose_angle_sd=0.0).with_points(points)
    noise = replace(data.noise, registration_mean=0.0, correlated_sd=0.0, point_sd=0.01)
    assert bent.points[-1, 2] > 0.005 * bent.depth
    assert not leaves_plane(bent, noise) and leaves_plane(replace(bent, roll_sd=math.radians(1.0)), noise)
    # a tip alone that is out of the plane leaves it
    aside = points.copy()
    aside[:, 2] = 0.0
    assert not leaves_plane(bent.with_points(aside), noise)
    aside[-1, 2] = 2.0
    assert leaves_plane(bent.with_points(aside), noise)
    # so do curvatures: 1e-4/mm toward z are explained by the roll, 1e-3/mm are not
    for kappa_z, leaves in ((1e-4, False), (1e-3, True)):
        sensors = np.array([[10.0, 2e-3, kappa_z, 2e-5], [30.0, 2e-3, kappa_z, 2e-5]])
        assert leaves_plane(replace(flat, curvature=sensors), noise) == leaves
    with pytest.raises(ConfigError):
        set_compared(replace(data, pose="free"), [flat], "space")


def test_a_medium_states_the_friction_by_which_the_tip_stays_behind_the_hub():
    """A needle turned over leaves its plane; fitted with its friction it gives back the truth."""
    known = medium().model_copy(update={"torsional_friction_n": 0.5})
    planned = replace(insertion(40.0, (12.0,), (1, 2)), turns=((18.0, 180.0),))
    shape = predict(TRUTH, known, planned)
    lag = compute_roll_lag(NEEDLE, make_tissue(TRUTH, (1, 2), np.array([12.0]), known), 18.0)
    behind = predict(TRUTH, medium(), replace(planned, turns=((18.0, 180.0 - lag),)))
    assert_allclose(shape.w, behind.w, atol=1e-9)
    assert lag > 5 and abs(shape.w[-1]) > 0.02
    points = sample_inserted_points(shape, 101)
    made = [planned.with_points(points)]
    data = replace(dataset(made), compared="space")
    p = make_problem(data, made, known, FREE)
    assert p.objective(p.parameters.theta(TRUTH)) < 1e-4
    assert_one_density(p, p.parameters.theta({**TRUTH, "mu1_pa": 5e5, "bevel_mm": 0.1}))
    scene = make_scene_record(TRUTH, known, data.name, made[0])
    again = Scene.from_record(scene)
    assert again.tissue.torsional_friction == 0.5
    assert_allclose(simulate_steps(again.needle, again.tissue, again.steps, again.rules).w, shape.w)


SENSORS = np.column_stack([[2.0, 10.0, 20.0, 30.0], np.zeros((4, 2)), np.full(4, 2e-5)])


def test_curvatures_of_four_sensors_give_the_shape_and_are_of_one_density():
    """By curvatures with an error of 2e-5 1/mm alone, tips lie within 0.1 mm of the measured ones."""
    rng, how = default_rng(7), BY_CURVATURE
    planned = [turned(40.0, curvature=SENSORS), turned(45.0, ((20.0, -90.0),), curvature=SENSORS, side=-1)]
    data = replace(dataset(planned), compared="space")
    seen = [simulate_measurement(data, one, TRUTH, medium(), rng) for one in planned]
    made = [replace(one, curvature=other.curvature) for one, other in zip(planned, seen, strict=True)]
    p = in_space(made, how)
    assert [one.rows for one in p.density.observations] == [8, 8]
    begin = p.parameters.theta({**TRUTH, "mu1_pa": 5e5, "mu2_pa": 1e7, "bevel_mm": 0.1})
    assert_one_density(p, begin)
    found = minimize_squares(p, begin)
    assert found.converged
    assert max(compare_curves(*pair).tip_error for pair in p.points(found.theta)) < 0.1
    both = in_space(made, FREE)
    assert [one.rows for one in both.density.observations] == [2 * 101 + 8] * 2
    assert_one_density(both, begin)
    with pytest.raises(DataError):
        in_space([turned()], how).log_posterior(begin)


def test_curvatures_are_read_in_the_frame_of_the_bevel_and_their_faults_named(tmp_path):
    sensors = np.array([[5.0, 1e-3, 2e-3, 1e-5]])
    one = row("a", "given", layers=2, bevel=np.array([0.0, 1, 0]), roll=math.pi / 2)
    tables = {**TURNED, "insertions": {"file": "insertions.csv", "curvature": "fbg.csv"}}
    file = write_dataset(tmp_path, record(**tables), [one], {"a": CURVE}, {}, checksums=False)
    head = "id,s_mm,kappa_y_1_per_mm,kappa_z_1_per_mm,sd_1_per_mm\n"
    (tmp_path / "fbg.csv").write_text(head + "a,5,1e-3,2e-3,1e-5\n")
    assert_allclose(read(file).insertions[0].curvature, sensors[:, [0, 2, 1, 3]] * [1, 1, -1, 1])
    for line in ("b,5,1e-3,2e-3,1e-5", "a,200,0,0,1e-5", "a,5,0,0,0"):
        (tmp_path / "fbg.csv").write_text(f"{head}{line}\n")
        assert any("fbg.csv:2" in fault.where for fault in check(file))


def test_curves_without_mechanics_lie_in_the_plane_to_which_the_turns_lead():
    """Turned over by a quarter at half the depth, a needle goes 3 parts toward y and 1 toward z."""
    depths, s, angle = (40.0, 50.0), np.linspace(0.0, 1.0, 101), math.atan2(1.0, 3.0)
    made = []
    for n, depth in enumerate(depths):
        bent = integrate_curvature(depth, [1 / 300], depth * s)
        points = turn_about_x(np.pad((-1.0) ** n * bent, ((0, 0), (0, 1))), angle)
        points[:, 0] = bent[:, 0]
        one = replace(insertion(depth, (12.0,), (1, 2), (-1) ** n), turns=((depth / 2, 90.0),))
        made.append(one.with_points(points))
    made = set_compared(dataset(made), made, "space").insertions
    assert [one.curve_roll for one in made] == approx([angle] * 2)
    assert (
        find_curve_roll(turned(turns=())) == 0 and find_curve_roll(turned(turns=((1.0, 180.0),))) == math.pi
    )
    found = fit_baselines(dataset(made), made)
    assert found["constant_curvature"].coefficients == approx([1 / 300], rel=1e-6)
    for name in ("constant_curvature", "mean_shape"):
        for one in made:
            tip = found[name].curve(one)(np.array([one.depth]))[0]
            assert tip == approx(one.points[-1], abs=0.02)


def test_the_median_turns_with_the_points_and_tips_are_scored_by_distance():
    rng = default_rng(2)
    points = np.array([[0, 0], [3, 1], [-2, 5]]) + rng.normal(size=(401, 3, 2))
    turn = np.array([[0.6, 0.8], [-0.8, 0.6]])
    middle = find_geometric_median(points)
    assert_allclose(find_geometric_median(points @ turn), middle @ turn, atol=1e-6)
    lines = np.array([[[0.0, 0.0]], [[1.0, 0.0]], [[10.0, 0.0]]])
    assert_allclose(find_geometric_median(lines), [[1.0, 0.0]], atol=1e-6)
    tips = rng.normal(size=(4000, 2))
    for radius, expected in ((0.0, math.sqrt(math.pi / 2) - math.sqrt(math.pi) / 2), (3.0, None)):
        found = score_tip_in_space(tips, np.zeros(2), np.array([0.0, radius]))
        assert found["tip_pit"] == approx(1 - math.exp(-(radius**2) / 2), abs=0.02)
        assert expected is None or found["tip_crps_mm"] == approx(expected, abs=0.02)
        assert found["tip_in_95"] == (radius < 2)
    for interval, probability in (("tip_95", 0.025), ("tip_50", 0.25), ("tip_z_95", 0.025)):
        ends = found[f"{interval}_low_mm"], found[f"{interval}_high_mm"]
        assert ends == approx(scipy.stats.norm.ppf([probability, 1 - probability]), abs=0.1)
