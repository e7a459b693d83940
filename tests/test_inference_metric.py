"""The metric objective and its exact gradient."""

from dataclasses import replace

import numpy as np
import pytest
from inference_cases import TRUTH, medium, two_layers

from needlefit.inference.problem import SMOOTHING_MM, metric_misfit, metric_misfit_gradient
from needlefit.schemas.recipe import WeightsRecord


def test_distances_are_smooth_at_zero_and_otherwise_what_they_were():
    weights, line = WeightsRecord(te=0, edp=0), np.zeros((5, 2))
    for d in (0.0, SMOOTHING_MM, 1.0):
        assert metric_misfit(line + np.array([0, d]), line, weights) == pytest.approx(
            np.hypot(d, SMOOTHING_MM) - SMOOTHING_MM, abs=1e-12
        )
    shift = np.broadcast_to(np.array([[0.0], [1.0]]), (5, 2, 1))
    assert metric_misfit_gradient(line, line, weights, shift) == pytest.approx([0.0])
    assert metric_misfit_gradient(line + np.array([0, 1.0]), line, weights, shift) == pytest.approx(
        [1.0], abs=1e-6
    )
    assert metric_misfit_gradient(line - np.array([0, 1.0]), line, weights, shift) == pytest.approx(
        [-1.0], abs=1e-6
    )


def test_a_deflection_below_the_floor_counts_as_the_floor():
    measured = np.column_stack([np.arange(5.0), np.linspace(0, 0.05, 5)])
    weights = WeightsRecord(ipe=0, te=0, edp=1.0, edp_floor_mm=0.2)
    assert metric_misfit(measured + np.array([0, 1.0]), measured, weights) == pytest.approx(5.0, rel=2e-3)


@pytest.mark.parametrize("pose", ["known", "free"])
def test_the_gradient_is_that_of_differences(pose):
    p = two_layers(medium(guide_distance_mm={"bounds": [5.0, 60.0]}) if pose == "known" else medium())
    p = replace(p, dataset=replace(p.dataset, pose=pose))
    theta = p.parameters.theta({**TRUTH, "mu1_pa": 5e5, "bevel_mm": 0.1, "guide_distance_mm": 20.0})
    value, slope = p.objective_gradient(theta)
    moves = 1e-5 * np.eye(len(theta))
    differences = [(p.objective(theta + m) - p.objective(theta - m)) / 2e-5 for m in moves]
    assert value == pytest.approx(p.objective(theta), rel=1e-8)
    assert slope == pytest.approx(differences, rel=1e-5, abs=1e-6)
