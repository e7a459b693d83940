"""The error-minimising fit: the tolerance of its objective, and the point within it nearest to a target."""

import math
from dataclasses import replace

import numpy as np
import pytest
from inference_cases import TRUTH, medium, problem, two_layers

from needlefit.datasets.insertion import Noise
from needlefit.inference.error_fit import Target, examine_errors
from needlefit.inference.error_tolerance import ErrorTolerance, estimate_tolerance
from needlefit.inference.fit import Fit
from needlefit.inference.problem import Problem


def at_truth(p: Problem) -> Fit:
    theta = p.parameters.theta(TRUTH)
    return Fit(tuple(theta.tolist()), p.values(theta), p.objective(theta), (), 0, 0, False, "metric")


def examine(p: Problem, target: Target | None = None):
    return examine_errors(p, at_truth(p), target, p.parameters, np.random.default_rng(3))


def test_the_tolerance_grows_with_the_noise_and_not_with_what_a_step_cannot_take_off():
    def tolerance(factor: float) -> ErrorTolerance:
        noise = Noise(0.19 * factor, 0.05 * factor, 0.1 * factor, 5.0)
        p = two_layers()
        made = [replace(one, pose_angle_sd=0.004 * factor) for one in p.insertions]
        p = problem(p.medium, made, noise=noise)
        return estimate_tolerance(
            p, p.parameters, np.array(p.parameters.theta(TRUTH)), np.random.default_rng(1)
        )

    one, two = tolerance(1.0), tolerance(2.0)
    assert two.by_noise == pytest.approx(2 * one.by_noise, rel=0.02)
    assert math.isnan(one.by_insertions) and one.value == one.by_noise  # three insertions are too few


def test_without_noise_and_with_few_insertions_the_tolerance_is_the_smallest():
    p = problem(medium(), two_layers().insertions, noise=Noise())
    p = replace(p, insertions=tuple(replace(one, pose_angle_sd=0.0) for one in p.insertions))
    found = examine(p)
    assert found.tolerance.value == 0.002 and found.theta == at_truth(p).theta


def test_the_reported_fit_is_the_target_where_its_errors_are_equal_and_else_as_near_as_the_limit_allows():
    p = two_layers()
    theta, ones = np.array(at_truth(p).theta), np.ones(len(p.names))
    near = examine(p, Target(theta + 0.01, ones))
    assert near.theta == tuple((theta + 0.01).tolist()) and near.objective > near.least
    far = theta + np.array([2.0, 0.0, 0.0])  # across the ridge
    found = examine(p, Target(far, ones))
    limit = found.least + found.tolerance.value
    assert found.objective <= limit < p.objective(far)
    assert found.objective > found.least + 0.5 * found.tolerance.value
    assert np.linalg.norm(np.array(found.theta) - far) < np.linalg.norm(theta - far)
