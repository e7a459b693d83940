import math
from dataclasses import replace

import numpy as np
import pytest
from inference_cases import NEEDLE, TRUTH, insertion, measure, medium, problem, recipe, two_layers

from needlefit.errors import ConfigError, DataError
from needlefit.inference.compared_points import compare_points
from needlefit.inference.fit import Callbacks
from needlefit.inference.forward_model import make_options, predict
from needlefit.inference.optimize import minimize
from needlefit.inference.parameters import Parameters
from needlefit.schemas.recipe import WeightsRecord


def rotated(points, degrees, shift):
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return points @ np.array([[c, s], [-s, c]]) + shift


def test_the_objective_is_zero_at_the_truth():
    p = two_layers()
    assert p.objective(p.parameters.theta(TRUTH)) < 1e-3  # the polyline's own error
    assert p.objective(p.parameters.theta({**TRUTH, "bevel_mm": 0.09})) > 0.05


def test_the_objective_is_the_weighted_sum_that_it_states():
    record = medium(1)
    shifted = measure(TRUTH, record, insertion(40.0), error=lambda xy: xy + np.array([0.3, 0.4]))
    p = problem(record, [shifted])
    theta = p.parameters.theta(TRUTH)
    assert p.objective(theta) == pytest.approx(
        0.5 + 0.5 + 0.1 * 0.5 / max(abs(shifted.deflection), 0.2), rel=1e-3
    )
    only_ipe = replace(p, weights=WeightsRecord(ipe=2, te=0, edp=0))
    assert only_ipe.objective(theta) == pytest.approx(1.0, rel=1e-3)
    floored = replace(p, weights=WeightsRecord(ipe=0, te=0, edp=1, edp_floor_mm=100))
    assert floored.objective(theta) == pytest.approx(0.5 / 100, rel=1e-3)


def test_a_solve_that_fails_makes_the_objective_infinite():
    p = two_layers(count=1)
    bent_off = p.parameters.with_only(["mu1_pa", "bevel_mm"], TRUTH)
    wide = replace(bent_off, bounds={**bent_off.bounds, "bevel_mm": (1e-3, 50.0)})
    hopeless = p.with_parameters(wide)
    theta = np.log([1e9, 30.0])
    assert not hopeless.shapes(theta)[0].converged
    assert hopeless.objective(theta) == math.inf
    assert math.isnan(hopeless.log_posterior(theta))
    assert np.isnan(hopeless.residuals(theta)).all()


@pytest.mark.parametrize("jobs", [1, 2])
def test_noise_free_shapes_give_their_parameters_back(jobs):
    p = two_layers()
    fit = minimize(p, recipe(algorithm="bobyqa+neldermead", evaluations=300), rng(), Callbacks(jobs=jobs))
    assert fit.objective < 0.003
    assert fit.values["mu1_pa"] == pytest.approx(TRUTH["mu1_pa"], rel=0.05)
    assert fit.values["mu2_pa"] == pytest.approx(TRUTH["mu2_pa"], rel=0.1)
    assert fit.values["bevel_mm"] == pytest.approx(TRUTH["bevel_mm"], rel=0.02)


@pytest.mark.parametrize(
    ("changed", "free"),
    [
        ({"mu2_pa": {"tie": "10 * mu1_pa"}}, 2),
        ({"mu2_pa": {"tie": "mu1_pa", "spread": 1}}, 2),
        ({"mu2_pa": {"fixed": 2e7}, "mu1_pa": {"fixed": 3e5}}, 1),
        ({"bevel_mm": {"fixed": 0.08}}, 2),
    ],
)
def test_tied_ratio_tied_and_fixed_parameters_are_recovered(changed, free):
    record = medium(**changed)
    parameters = Parameters.from_record(record)
    truth = parameters.values(parameters.theta(TRUTH))
    made = [measure(truth, record, insertion(30.0 + 6 * k, (12.0 + 4 * k,), (1, 2))) for k in range(2)]
    p = problem(record, made)
    assert len(parameters.free) == free
    fit = minimize(p, recipe(algorithm="bobyqa+neldermead"), rng())
    assert fit.values == pytest.approx(truth, rel=0.05)


def test_the_guide_distance_can_be_fitted_and_a_guide_out_of_reach_is_a_failed_solve():
    record = medium(1, guide_distance_mm={"bounds": [2.0, 140.0]}, mu1_pa={"fixed": 3e5})
    truth = {**TRUTH, "guide_distance_mm": 15.0}
    p = problem(record, [measure(truth, record, insertion(d)) for d in (30.0, 55.0)])
    fit = minimize(p, recipe(algorithm="neldermead+neldermead", starts=6), rng())
    assert fit.failures > 0  # 55 mm + 95 mm or more leave nothing of 150 mm
    assert fit.values["guide_distance_mm"] == pytest.approx(15.0, rel=0.05)


def test_repeats_of_one_fit_are_equal_for_any_number_of_jobs():
    p = two_layers(count=2)
    fits = [minimize(p, recipe(evaluations=40), rng(), Callbacks(jobs=jobs)) for jobs in (1, 2)]
    assert fits[0] == fits[1]


def test_planned_boundaries_replace_the_measured_ones():
    record = medium()
    asked = predict(TRUTH, record, NEEDLE, insertion(40.0, (15.0,), (1, 2)), np.array([25.0]), (1, 2))
    meant = predict(TRUTH, record, NEEDLE, insertion(40.0, (25.0,), (1, 2)))
    assert np.array_equal(asked.u, meant.u)


def test_the_mesh_divides_the_constraint_spacing():
    for spacing, element in ((1.0, 1.0), (0.5, 0.5), (2.0, 1.0), (2.5, 2.5 / 3)):
        got = make_options(medium().model_copy(update={"constraint_spacing_mm": spacing}))
        assert (got.spacing, got.element) == (spacing, pytest.approx(element))


def test_no_insertion_is_an_error():
    with pytest.raises(ConfigError, match="no insertion"):
        problem(medium(), [])


def test_free_shapes_are_compared_from_the_tip_after_alignment():
    """A moved, turned copy of the model's own shape, its proximal end cut off and garbled, fits exactly."""

    def moved(points):
        bent = rotated(points, 37.0, [100.0, -20.0])[60:]  # what is missing at the entry does not matter
        return np.concatenate([bent[:30] + np.random.default_rng(1).normal(0, 0.3, (30, 2)), bent[30:]])

    record = medium(1)
    made = [measure(TRUTH, record, insertion(d), 1001, moved) for d in (50.0, 60.0)]
    # The garbled points lengthen the polyline, but only on the far side of what is compared.
    p = problem(record, made, pose="free", drop=20.0)
    assert p.objective(p.parameters.theta(TRUTH)) < 1e-3
    assert p.objective(p.parameters.theta({**TRUTH, "bevel_mm": 0.1})) > 0.01


def test_alignment_never_mirrors():
    record = medium(1)
    flipped = [measure(TRUTH, record, insertion(55.0), 501, lambda xy: xy * [1, -1])]
    p = problem(record, flipped, pose="free", drop=5.0)
    assert p.objective(p.parameters.theta(TRUTH)) > 0.1


def test_a_free_arc_is_shown_in_the_axes_of_its_entry_side():
    """A circle of radius R: the tip's distance from its first tangent is R (1 - cos(L / R))."""
    radius, length = 500.0, 100.0
    at = np.linspace(0, length, 1001) / radius
    arc = radius * np.column_stack([np.sin(at), 1 - np.cos(at)])
    measured = replace(insertion(length), planar=rotated(arc, 80.0, [5.0, 5.0]))
    simulated, shown = compare_points("free", 0.0, measured, lambda s: np.column_stack([s, 0 * s]), 401)
    assert shown[0] == pytest.approx([0, 0], abs=1e-12)
    # The line through the first fifth is the tangent at its middle, a tenth of the way.
    tangent = radius * (1 - math.cos(0.9 * length / radius)) - radius * (1 - math.cos(0.1 * length / radius))
    assert shown[-1, 1] == pytest.approx(tangent, rel=0.01)
    assert np.linalg.norm(simulated[-1] - simulated[0]) == pytest.approx(length, rel=1e-8)
    assert simulated.mean(axis=0) == pytest.approx(shown.mean(axis=0))


def test_a_shape_shorter_than_what_is_left_out_is_an_error():
    short = replace(insertion(8.0), planar=np.array([[0.0, 0.0], [8.0, 0.0]]))
    with pytest.raises(DataError, match="at8"):
        compare_points("free", 10.0, short, lambda s: np.column_stack([s, 0 * s]))


def rng():
    return np.random.default_rng(4)
