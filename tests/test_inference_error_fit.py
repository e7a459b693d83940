"""What the errors determine: the tolerance, the ranges within it, and the point nearest to a target."""

import math
from dataclasses import replace

import numpy as np
import pytest
from inference_cases import NOISE, TRUTH, insertion, measure, medium, problem, two_layers

from needlefit.datasets.insertion import Noise
from needlefit.inference.error_fit import ErrorSearch, Target, examine_errors
from needlefit.inference.error_tolerance import ErrorTolerance, estimate_tolerance
from needlefit.inference.fit import Fit
from needlefit.inference.problem import Problem

ONE = {"bevel_mm": {"fixed": 0.08}}  # mu alone is free: it is determined


def at_truth(p: Problem) -> Fit:
    theta = p.parameters.theta(TRUTH)
    return Fit(tuple(theta.tolist()), p.values(theta), p.objective(theta), (), 0, 0, False, "metric")


def examine(p: Problem, target: Target | None = None, jobs: int = 1):
    rng = np.random.default_rng(3)
    return examine_errors(p, at_truth(p), target, ErrorSearch(p.parameters), rng, jobs)


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


def test_without_noise_and_with_few_insertions_no_tolerance_is_known_and_nothing_determined():
    p = problem(medium(), two_layers().insertions, noise=Noise())
    p = replace(p, insertions=tuple(replace(one, pose_angle_sd=0.0) for one in p.insertions))
    found = examine(p)
    assert not found.tolerance.known and found.tolerance.value == 0.002
    assert {found.determined(name) for name in p.names} == {"no"}


def test_modulus_and_bevel_are_known_only_together_and_the_truth_is_within():
    p = two_layers()
    found = examine(p)
    assert found.least == pytest.approx(0.0, abs=1e-3) and found.theta == at_truth(p).theta
    theta = np.array(at_truth(p).theta)
    for k, name in enumerate(p.names):
        assert found.ranges[name].low < theta[k] < found.ranges[name].high
        assert found.ranges[name].low <= found.ranges[name].alone[0]
        assert found.ranges[name].alone[1] <= found.ranges[name].high
    assert found.determined("bevel_mm") == "only together"


def test_ends_of_a_range_lie_where_the_best_of_the_others_reaches_the_limit():
    p = problem(medium(1, **ONE), [measure(TRUTH, medium(1, **ONE), insertion(30.0))], noise=NOISE)
    found, (name,) = examine(p), p.names
    one = found.ranges[name]
    assert one.ends == ("closed", "closed") and one.alone == (one.low, one.high)
    for end in (one.low, one.high):  # nothing else is free
        inside, outside = sorted((end - 0.06, end + 0.06), key=lambda at: abs(at - found.theta[0]))
        assert p.objective([inside]) < found.least + found.tolerance.value < p.objective([outside])


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


def test_the_result_does_not_depend_on_threads():
    p = two_layers(count=2)
    one, two = (examine(p, jobs=jobs) for jobs in (1, 2))
    assert one == two
