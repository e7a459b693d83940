"""What a prediction takes from the medium's record, the needle's and the scene's: every number arrives."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from inference_cases import NEEDLE, TRUTH, dataset, insertion, medium
from pytest import approx
from scipy.special import ndtr, ndtri

from needlefit import Bevel, Controls, ModelOptions, Needle, Tissue, simulate
from needlefit.geometry.curves import COMPARISON_POINTS, integrate_curvature
from needlefit.inference.baseline_fit import fit_baseline
from needlefit.inference.draws import Draws, rms_noise_scale
from needlefit.inference.forward_model import predict
from needlefit.inference.likelihood.compared_points import align_points
from needlefit.inference.likelihood.observations import select_points
from needlefit.inference.parameters import make_tissue
from needlefit.inference.predictive_mixture import (
    PredictiveMixture,
    cdf,
    crps,
    estimate_end_errors,
    interval,
    quantile,
)
from needlefit.inference.proportion import estimate_proportion, wilson_interval
from needlefit.mechanics.packing import MAX_TOLERANCE_MM
from needlefit.schemas.scene import NeedleRecord

UNUSUAL = {"thickness_mm": 3.0, "law": "neo_hookean", "constraint_spacing_mm": 2.0}


def test_a_prediction_is_the_simulation_that_the_medium_describes():
    unusual = medium().model_copy(update=UNUSUAL)
    met = make_tissue(TRUTH, (1, 2, 1), np.array([10.0, 20.0]), unusual)
    assert met.thickness.tolist() == [3.0, 3.0, 3.0]
    assert met.law == "neo_hookean"
    planned = insertion(31.3, (12.0,), (1, 2), -1)
    got = predict(TRUTH, unusual, planned)
    met = Tissue(mu=[0.3, 20.0], alpha=[1.0, -1.0], boundaries=[12.0], thickness=[3.0], law="neo_hookean")
    options = ModelOptions(2.0, 1.0, MAX_TOLERANCE_MM)
    meant = simulate(NEEDLE, met, Bevel(0.08, -1), 31.3, Controls(), options)
    assert got.constraints[1, 0] == approx(1.3)  # 31.3 = 15 cells of 2 mm and 1.3 mm
    np.testing.assert_array_equal(got.u, meant.u)
    # OD 1.27 mm, ID 0.838 mm, 193 GPa: I = pi (1.27^4 - 0.838^4) / 64 = 0.103491 mm^4 by hand.
    tube = NeedleRecord(
        length_mm=150, outer_diameter_mm=1.27, inner_diameter_mm=0.838, youngs_modulus_gpa=193
    )
    found = Needle.from_record(tube)
    assert found.length == 150.0
    assert found.flexural_rigidity == approx(19973.7, rel=1e-5)
    assert (found.outer_diameter, found.name) == (1.27, "needle")
    assert replace(Needle.from_tube(150.0, 1.27, 193e3, 0.838), name="needle") == found


# ---- predictive mixtures against closed forms and integrals


def one(mean, sd):
    return PredictiveMixture(np.full((3, 1), float(mean)), np.array([float(sd)]))


def test_equal_draws_are_one_gaussian_and_a_point_scores_its_absolute_error():
    low, high = interval(one(2.0, 0.5), 0.95)
    assert low == approx(2.0 - 1.959964 * 0.5, abs=1e-6)
    assert high == approx(2.0 + 1.959964 * 0.5, abs=1e-6)
    assert cdf(one(2.0, 0.5), [2.5]) == approx(ndtr(1.0))
    assert quantile(one(2.0, 0.5), 0.9) == approx(2.0 + 0.5 * ndtri(0.9))
    # of a standard Gaussian at its mean: (sqrt(2) - 1) / sqrt(pi)
    assert crps(one(0.0, 1.0), [0.0]) == approx((np.sqrt(2) - 1) / np.sqrt(np.pi))
    assert crps(one(1.0, 0.0), [3.5]) == approx(2.5)
    around = ndtr(0.5) - 0.5 + (2 * np.exp(-1 / 8) / np.sqrt(2) - 1) / np.sqrt(np.pi)
    assert crps(one(0.0, 1.0), [0.5]) == approx(around)
    spread = PredictiveMixture(np.array([[3.0, 0.0], [0.0, 1.0], [2.0, 2.0], [1.0, 3.0]]), np.zeros(2))
    # sum over i of |y - x_i| / n - sum over pairs of |x_i - x_j| / (2 n^2)
    expected = (1 + 0 + 1 + 2) / 4 - (2 * (3 * 1 + 2 * 2 + 1 * 3)) / (2 * 16)
    assert crps(spread, [1.0, 1.0]) == approx([expected] * 2)
    both = PredictiveMixture(np.column_stack([np.zeros(3), np.full(3, 5.0)]), np.array([1.0, 2.0]))
    assert quantile(both, 0.5) == approx([0.0, 5.0], abs=1e-9)
    assert crps(both, [0.0, 5.0]) == approx((np.sqrt(2) - 1) / np.sqrt(np.pi) * np.array([1.0, 2.0]))


# ---- baselines: curves without a model of the tissue

AT = np.linspace(0, 100, 21)


def measured(depth, coefficients, side=1, points=801):
    planar = integrate_curvature(depth, [side * c for c in coefficients], np.linspace(0, depth, points))
    return insertion(depth, side=side).with_points(planar)


def test_integrated_curvatures_are_lines_circles_and_clothoids():
    assert integrate_curvature(100.0, [], AT) == approx(np.column_stack([AT, 0 * AT]))
    circle = 400 * np.column_stack([np.sin(AT / 400), 1 - np.cos(AT / 400)])
    assert integrate_curvature(100.0, [1 / 400], AT) == approx(circle, abs=1e-12)
    s = np.linspace(0, 100, 2001)
    points = integrate_curvature(100.0, [0.0, 2e-5], s)
    heading = np.unwrap(np.arctan2(*np.diff(points, axis=0).T[::-1]))
    assert heading[-1] == approx(2e-5 * 100**2 / 2, abs=1e-5)
    curvature = np.diff(heading) / np.diff(s)[0]
    assert curvature[0] == approx(2e-5 * 100, rel=1e-2) and curvature[-1] == approx(0, abs=1e-5)
    assert np.hypot(*np.diff(points, axis=0).T) == approx(0.05, rel=1e-6)  # arc length
    assert integrate_curvature(50.0, [0.01], [-10.0, 0.0]) == approx(np.array([[-10, 0], [0, 0]]))


@pytest.mark.parametrize("pose", ["known", "free"])
def test_the_mean_shape_is_the_mean_of_the_turns_from_the_tip(pose):
    bent = [measured(100.0, (c,), side) for c, side in ((1e-3, 1), (3e-3, -1))]
    fitted = fit_baseline("mean_shape", dataset(bent, pose=pose, drop=10.0), bent)
    assert fitted.coefficients == approx([5 * 2e-3] * len(fitted.coefficients), rel=0.02)
    mean = measured(100.0, (2e-3,), -1)
    found, goal = align_points(select_points(pose, 10.0, mean), fitted.curve(mean))
    assert np.abs(found - goal).max() < 0.01
    alone = fit_baseline("mean_shape", dataset(bent, pose=pose, drop=10.0), bent[:1])
    found, goal = align_points(select_points(pose, 10.0, bent[0]), alone.curve(bent[0]))
    assert np.abs(found - goal).max() < 0.02


def test_a_curve_lies_closest_to_the_shape_and_to_the_tip_beside_it():
    """Of a straight shape and a tip that deflects by 2 mm: least squares of c x^2 / 2, by hand."""
    flat = replace(measured(100.0, (0.0,)), tip=np.array([2.0, np.nan, 0.1]))
    found = fit_baseline("constant_curvature", dataset([flat]), [flat])
    x = np.linspace(0.0, 100.0, COMPARISON_POINTS)
    expected = 2.0 * 5000.0 / (np.sum((x**2 / 2) ** 2) + 5000.0**2)
    assert found.coefficients == approx([expected], rel=1e-3)


def test_the_interval_of_a_share_is_wilson_s_by_as_many_trials_as_groups():
    """Of 10 trials 8: 0.490 to 0.943 (E. B. Wilson, 1927)."""
    assert wilson_interval(0.8, 10) == approx((0.4902, 0.9433), abs=1e-4)
    found = estimate_proportion([True, True, False, True], "aabb")
    assert (found.hits, found.trials, found.groups, found.rate) == (3, 4, 2, 0.75)
    assert (found.low, found.high) == wilson_interval(0.75, 2)


def test_the_end_of_an_interval_of_even_draws_errs_by_the_error_of_its_probability():
    draws = np.linspace(0.0, 1.0, 10_001)[:, None]
    for independent, count in ((None, 10_001), (2000.0, 2000)):
        expected = [[np.sqrt(0.025 * 0.975 / count)]] * 2
        assert estimate_end_errors(draws, 0.95, independent) == approx(np.array(expected), rel=1e-3)


def test_a_drawn_scale_of_the_noise_counts_by_its_mean_square():
    known = SimpleNamespace(free=("noise_scale",), values=lambda theta: {"noise_scale": theta[0]})
    draws = Draws(np.array([[1.0], [3.0]]), "importance")
    assert rms_noise_scale(draws, known, "estimated") == approx(np.sqrt(5))
    found = [one.describe()["certified"] for one in (draws, replace(draws, faults=("k",)))]
    assert found == [True, False]
    stated = SimpleNamespace(free=())
    assert [rms_noise_scale(draws, stated, one) for one in (1.7, "estimated")] == [1.7, 1.0]
