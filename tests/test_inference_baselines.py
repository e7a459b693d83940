import math
import os
from dataclasses import replace

import numpy as np
import pytest
from inference_cases import insertion
from refusals import refusal

from needlefit.errors import ConfigError
from needlefit.geometry.curves import integrate_curvature
from needlefit.inference.baseline_fit import fit_baseline, fit_baselines
from needlefit.inference.compared_points import compare_points

AT = np.linspace(0, 100, 21)


def measured(depth, coefficients, side=1, points=801):
    planar = integrate_curvature(depth, [side * c for c in coefficients], np.linspace(0, depth, points))
    return replace(insertion(depth, side=side), planar=planar)


def test_integrated_curvatures_are_lines_circles_and_clothoids():
    assert integrate_curvature(100.0, [], AT) == pytest.approx(np.column_stack([AT, 0 * AT]))
    circle = 400 * np.column_stack([np.sin(AT / 400), 1 - np.cos(AT / 400)])
    assert integrate_curvature(100.0, [1 / 400], AT) == pytest.approx(circle, abs=1e-12)
    s = np.linspace(0, 100, 2001)
    points = integrate_curvature(100.0, [0.0, 2e-5], s)
    heading = np.unwrap(np.arctan2(*np.diff(points, axis=0).T[::-1]))
    assert heading[-1] == pytest.approx(2e-5 * 100**2 / 2, abs=1e-5)
    curvature = np.diff(heading) / np.diff(s)[0]
    assert curvature[0] == pytest.approx(2e-5 * 100, rel=1e-2) and curvature[-1] == pytest.approx(0, abs=1e-5)
    assert np.hypot(*np.diff(points, axis=0).T) == pytest.approx(0.05, rel=1e-6)  # arc length
    assert integrate_curvature(50.0, [0.01], [-10.0, 0.0]) == pytest.approx(np.array([[-10, 0], [0, 0]]))


@pytest.mark.parametrize("pose", ["known", "free"])
@pytest.mark.parametrize("coefficients", [(), (2e-3,), (1e-3, 1.5e-5), (1e-3, 1e-5, 1e-7)])
def test_a_curve_of_its_kind_is_recovered(pose, coefficients):
    tuned = [measured(d, coefficients, side) for d, side in ((80.0, 1), (95.0, -1), (100.0, 1))]
    if pose == "free":
        turn = np.array([[0.6, 0.8], [-0.8, 0.6]])
        tuned = [replace(i, planar=i.planar @ turn + [5, 9]) for i in tuned]
    name = ("straight", "constant_curvature", "linear_curvature", "quadratic_curvature")[len(coefficients)]
    fitted = fit_baseline(name, pose, 10.0, tuned)
    assert fitted.coefficients == pytest.approx(coefficients, rel=1e-4)
    assert fitted.rms < 1e-3
    ahead = measured(120.0, coefficients)
    assert fitted.curve(ahead)(np.array([120.0]))[0] == pytest.approx(ahead.planar[-1], abs=1e-2)


@pytest.mark.parametrize("pose", ["known", "free"])
def test_the_mean_shape_is_the_mean_of_the_turns_from_the_tip(pose):
    bent = [measured(100.0, (c,), side) for c, side in ((1e-3, 1), (3e-3, -1))]
    fitted = fit_baseline("mean_shape", pose, 10.0, bent)
    assert fitted.coefficients == pytest.approx([5 * 2e-3] * len(fitted.coefficients), rel=0.02)
    mean = measured(100.0, (2e-3,), -1)
    found, goal = compare_points(pose, 10.0, mean, fitted.curve(mean))
    assert np.abs(found - goal).max() < 0.01
    alone = fit_baseline("mean_shape", pose, 10.0, bent[:1])
    assert alone.rms < 0.01


def test_the_rms_is_over_distances_and_richer_curves_fit_no_worse():
    bent = replace(insertion(10.0), planar=np.array([[0.0, 0.3], [10.0, 0.3]]))
    assert fit_baseline("straight", "known", 0.0, [bent]).rms == pytest.approx(0.3)
    tuned = [measured(d, (1e-3, 1e-5, 3e-7)) for d in (80.0, 100.0)]
    fits = fit_baselines("known", 0.0, tuned)
    nested = ["straight", "constant_curvature", "linear_curvature", "quadratic_curvature"]
    assert list(fits) == [*nested, "mean_shape"]
    errors = [fits[name].rms for name in nested]
    assert errors == sorted(errors, reverse=True)
    refusal(ConfigError, "spline", lambda: fit_baseline("spline", "known", 0.0, [measured(50.0, ())]))
    refusal(ConfigError, "no insertion", fit_baseline, "straight", "known", 0.0, [])


@pytest.mark.skipif(
    "NEEDLEFIT_REAL_DATA" not in os.environ, reason="NEEDLEFIT_REAL_DATA is not set: no real needles"
)
def test_the_real_stereo_shapes_give_the_known_baselines():
    from needlefit.datasets.read import read
    from needlefit.geometry.curves import compare_curves
    from needlefit.project.locate import find_file

    shapes = read(find_file("dataset", "stereo_shapes"))
    pose, drop = shapes.pose, shapes.drop_proximal
    deep = [i for i in shapes.insertions if i.depth == 120]
    fits = fit_baselines(pose, drop, [i for i in shapes.insertions if i.depth < 120])
    errors = {
        name: np.mean([compare_curves(*compare_points(pose, drop, i, b.curve(i))).distances for i in deep])
        for name, b in fits.items()
    }
    assert errors["straight"] == pytest.approx(0.59, abs=0.02)
    assert errors["constant_curvature"] == pytest.approx(0.068, abs=0.005)
    assert errors["linear_curvature"] == pytest.approx(0.036, abs=0.005)
    assert math.isfinite(fits["straight"].rms)
