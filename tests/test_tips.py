"""Tips alone, and curvatures alone: read, imported, and fitted to known truths."""

from dataclasses import replace

import numpy as np
import pytest
from inference_cases import (
    TRUTH,
    assert_objective_slope,
    assert_one_density,
    dataset,
    insertion,
    measure,
    medium,
)
from numpy.random import default_rng
from problem_cases import ALONG_X, make_problem
from pytest import approx
from research.simulated_data import simulate_measurement

from needlefit.datasets.folds import is_copy
from needlefit.datasets.insertion import Noise
from needlefit.datasets.read import check, read
from needlefit.inference.forward_model import predict
from needlefit.inference.likelihood.observation import whiten_residuals
from needlefit.inference.likelihood.observations import make_observation, read_points

ONE_LAYER = medium(1)
THETA = np.log([TRUTH["mu1_pa"], TRUTH["bevel_mm"]])
NOISE = Noise(point_sd=0.05)


def tip(depth, side=1, error=0.0):
    """An insertion of which the tip was measured, at the truth and an error, mm."""
    planned = insertion(depth, side=side, angle_sd=0.0)
    planned = replace(planned, id=f"at{depth:g}{side:+d}", observation="tip", directions=1)
    (end,) = read_points(planned, predict(TRUTH, ONE_LAYER, planned), np.array([depth]))[:, 1] + error
    return planned.with_points(np.array([[0.0, 0.0], [depth, end]]))


def tips(seed):
    errors = iter(NOISE.point_sd * default_rng(seed).normal(size=40))
    return [tip(depth, side, next(errors)) for depth in np.arange(20.0, 100.0, 5.0) for side in (1, -1)]


def test_equal_readings_of_two_tips_are_no_copies_and_equal_shapes_are():
    first, other = (replace(tip(40.0), id=name) for name in "ab")
    assert not is_copy(first, other)
    shape = insertion(40.0).with_points(np.array([[0.0, 0.0], [20.0, 0.3], [40.0, 1.0]]))
    assert is_copy(shape, replace(shape, id="b"))


def problem(made):
    return make_problem(dataset(made, NOISE), made, ONE_LAYER)


def test_density_and_objective_of_tips_have_exact_derivatives():
    asked, at = problem(tips(1)[::8]), THETA + np.array([0.2, -0.1])
    assert_one_density(asked, at, rtol=5e-4)
    assert_objective_slope(asked, at, 1e-4, 1e-3)


def test_the_density_is_that_of_a_normal_deviation_across():
    """Of one tip: (y_sim - y) / sd, with a shift and a turn of the pose in its variance."""
    one = replace(tip(60.0, error=0.07), pose_shift_sd=0.1, pose_angle_sd=0.002)
    known = make_observation(dataset([one], NOISE), one)
    slope = 2 * one.points[-1, 1] / 60.0
    variance = 0.05**2 + 0.1**2 + (60.0 * 0.002) ** 2 + (0.1 * slope) ** 2
    assert known.covariance()[0, 0] == approx(variance, rel=1e-9)
    assert known.whitening[0, 0] == approx(1 / np.sqrt(variance), rel=1e-9)


@pytest.mark.parametrize("compared", ["plane", "space"])
def test_a_tip_beside_a_shape_is_one_residual_more(compared):
    """It errs by its own deviation; along z, where it was not measured, it counts for nothing."""
    shape = replace(measure(TRUTH, ONE_LAYER, insertion(60.0, angle_sd=0.0)), roll_sd=0.0)
    beside = replace(shape, tip=np.array([shape.points[-1, 1] + 0.07, np.nan, 0.02]))
    data = replace(dataset([shape], NOISE), compared=compared)
    alone, joined = (make_observation(data, one) for one in (shape, beside))
    simulated = read_points(beside, predict(TRUTH, ONE_LAYER, beside), joined.nodes.s[0])
    residuals = whiten_residuals(joined, simulated)
    assert len(residuals) == alone.rows + 1
    assert residuals[-1] == approx(-0.07 / 0.02, rel=1e-3) and np.abs(residuals[:-1]).max() < 1e-2
    whole = make_observation(data, replace(beside, tip=np.array([1.0, 0.5, np.nan])))
    assert whole.whitening[-1, -1] == approx(1 / NOISE.point_sd)  # the deviation of a point


@pytest.mark.parametrize("compared", ["plane", "space"])
def test_all_that_an_insertion_holds_is_simulated_with_its_errors(compared):
    """The squares of whitened residuals at the truth are chi-squared: their number is the mean."""
    shape = measure(TRUTH, ONE_LAYER, insertion(60.0), points=21)
    sensors = np.column_stack([[10.0, 40.0], np.zeros((2, 2)), [5e-5, 1e-4]])
    beside = replace(
        shape, tip=np.array([0.0, 0.0, 0.4]), curvature=sensors, point_sd=0.2, pose_shift_sd=0.1, roll_sd=0.05
    )
    for planned in (beside, replace(tip(60.0), pose_angle_sd=0.004, point_sd=0.2, directions=2)):
        data, rng, squares = (
            replace(dataset([planned], NOISE), compared=compared),
            default_rng(7),
            [],
        )
        for _ in range(100):
            seen = simulate_measurement(data, planned, TRUTH, ONE_LAYER, rng)
            asked = make_problem(data, [seen], ONE_LAYER)
            misfits = asked.compute_misfits(THETA)
            squares.append(misfits @ misfits / len(misfits))
        assert np.mean(squares) == approx(1.0, abs=4 * np.sqrt(2 / len(misfits) / 100))


TOML = (
    """
schema = 1
name = "tips"
origin = "synthetic"
license = "none"
source = "made up"

[needle]
length_mm = 150.0
flexural_rigidity_nmm2 = 2.5e4

[noise]
point_sd_mm = 0.1

[insertions]
file = "insertions.csv"

"""
    + ALONG_X
)


def written(folder, rows, toml=TOML):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "insertions.csv").write_text(rows)
    (folder / "dataset.toml").write_text(toml)
    return folder


def test_a_table_of_depths_and_deflections_is_a_dataset(tmp_path):
    rows = (
        "id,hole,depth_mm,bevel_side,tip_y_mm,point_sd_mm\na,h,40,1,2.5,\nb,h,60,1,5.5,0.2\nc,k,60,-1,-5.0,\n"
    )
    data = read(written(tmp_path, rows))
    first, second, third = data.insertions
    assert [one.deflection for one in data.insertions] == approx([2.5, 5.5, 5.0])
    assert [one.observation for one in data.insertions] == ["tip"] * 3 == list(data.to_frame()["observation"])
    assert (first.hole, second.hole, first.directions) == ("h", "h", 1)
    assert [data.noise.of(one).point_sd for one in data.insertions] == [0.1, 0.2, 0.1]
    covariances = [make_observation(data, one).point_covariance for one in (second, third)]
    assert np.ravel(covariances) == approx([0.04, 0.01])
    assert data.compared == "plane" and data.pose == "known"


@pytest.mark.parametrize(
    "rows",
    [
        "id,depth_mm,tip_y_mm\na,40,\n",
        "id,depth_mm,tip_y_mm\na,40,41\n",
        "id,depth_mm,tip_y_mm,tip_z_mm\na,40,,1\n",
        "id,depth_mm,tip_y_mm,point_sd_mm\na,40,1,-1\n",
    ],
)
def test_what_is_wrong_with_a_tip_is_named(tmp_path, rows):
    (fault, *_) = check(written(tmp_path, rows))
    assert fault.where.endswith("insertions.csv:2")
