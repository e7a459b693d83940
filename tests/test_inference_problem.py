import math
from dataclasses import replace

import numpy as np
import pytest
from inference_cases import (
    NEEDLE,
    TRUTH,
    assert_objective_slope,
    from_first_point,
    insertion,
    measure,
    medium,
    problem,
    recipe,
    two_layers,
)
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx

from needlefit import Needle, minimize
from needlefit.datasets.insertion import find_free_reach
from needlefit.errors import DataError
from needlefit.inference.forward_model import PreparedModel, predict
from needlefit.inference.likelihood.compared_points import align_points
from needlefit.inference.likelihood.observations import select_points
from needlefit.mechanics import batch
from needlefit.schemas.recipe import WeightsRecord


def test_the_objective_is_the_weighted_sum_that_it_states_and_zero_at_the_truth():
    p = two_layers()
    assert p.objective(p.parameters.theta(TRUTH)) < 1e-3  # the polyline's own error
    assert p.objective(p.parameters.theta({**TRUTH, "bevel_mm": 0.09})) > 0.05
    record = medium(1)
    shifted = measure(TRUTH, record, insertion(40.0), error=lambda xy: xy + np.array([0.3, 0.4]))
    p = problem(record, [shifted])
    theta = p.parameters.theta(TRUTH)
    assert p.objective(theta) == approx(0.5 + 0.5 + 0.1 * 0.5 / max(abs(shifted.deflection), 0.2), rel=1e-3)
    only_ipe = replace(p, weights=WeightsRecord(ipe=2, te=0, edp=0))
    assert only_ipe.objective(theta) == approx(1.0, rel=1e-3)
    floored = replace(p, weights=WeightsRecord(ipe=0, te=0, edp=1, edp_floor_mm=100))
    assert floored.objective(theta) == approx(0.5 / 100, rel=1e-3)


def test_a_solve_that_fails_makes_the_objective_infinite():
    p = two_layers(count=1)
    bent_off = p.parameters.with_only(["mu1_pa", "bevel_mm"], TRUTH)
    wide = replace(bent_off, bounds={**bent_off.bounds, "bevel_mm": (1e-3, 50.0)})
    hopeless = p.with_parameters(wide)
    theta = np.log([1e9, 30.0])
    assert not predict(hopeless.values(theta), hopeless.medium, hopeless.insertions[0]).converged
    assert hopeless.objective(theta) == math.inf
    assert math.isnan(hopeless.log_posterior(theta))
    assert np.isnan(hopeless.jacobian(theta)[0]).all()


def test_needles_that_differ_are_fitted_together():
    record, thin = medium(1), Needle(NEEDLE.length, NEEDLE.flexural_rigidity / 10)
    planned = [insertion(depth) for depth in (30.0, 36.0, 42.0, 48.0)]
    planned = [replace(one, needle=(NEEDLE, thin)[n % 2]) for n, one in enumerate(planned)]
    p = problem(record, [measure(TRUTH, record, one) for one in planned])
    for one, lanes in zip(p.insertions, PreparedModel(record, p.insertions).simulate([TRUTH]), strict=True):
        assert_array_equal(lanes[0].u, predict(TRUTH, record, one).u)
    fit = minimize(p, recipe(starts=4), rng())
    assert [fit.values[name] for name in p.names] == approx([TRUTH[name] for name in p.names], rel=0.01)


def rng():
    return default_rng(4)


def measured(depth, planar):
    return insertion(depth).with_points(planar)


def line(length):
    """A straight needle measured in unequal steps, turned by 53 degrees and far from its frame."""
    along = length * np.array([0.0, 0.1, 0.15, 0.6, 1.0])
    return np.outer(along, [0.6, 0.8]) + np.array([50.0, -7.0])


@pytest.mark.parametrize(
    ("length", "depth", "drop", "reach"),
    [(80.0, 100.0, 10.0, 70.0), (120.0, 100.0, 10.0, 90.0), (100.0, 100.0, 0.0, 100.0)],
)
def test_a_free_comparison_reaches_as_far_as_both_curves_less_the_drop(length, depth, drop, reach):
    scored = measured(depth, line(length))
    assert find_free_reach(drop, scored) == approx(reach)
    goal = select_points("free", drop, scored, 11)
    assert_allclose(goal.s, np.linspace(depth - reach, depth, 11), atol=1e-9)
    # in the axes of its entry side a straight needle lies on x, from the first scored point
    assert_allclose(goal.measured, np.column_stack([np.linspace(0, reach, 11), np.zeros((11, 2))]), atol=1e-9)


def test_a_needle_shorter_than_what_is_dropped_is_refused():
    short = insertion(8.0).with_points(np.array([[0.0, 0.0], [8.0, 0.0]]))
    with pytest.raises(DataError, match="at8"):
        select_points("free", 10.0, short)


def test_the_simulated_points_are_those_at_the_same_distance_from_the_tip():
    """What is compared is laid on it rigidly: a bent needle, moved and turned, is found without error.

    Its proximal 40 mm, which only one of the two has, do not count.
    """

    def bent(s):
        turned = np.asarray(s, dtype=float) / 100.0
        return 100.0 * np.column_stack([np.sin(turned), 1 - np.cos(turned), np.zeros(len(turned))])

    c, d = math.cos(2.0), math.sin(2.0)
    seen = bent(np.arange(40.0, 100.5))[:, :2] @ np.array([[c, d], [-d, c]]) + [300.0, 1.0]
    simulated, shown = align_points(select_points("free", 5.0, measured(100.0, seen), 56), bent)
    assert_allclose(simulated, shown, atol=1e-9)
    goal = select_points("free", 5.0, measured(101.0, seen), 56)
    simulated, shown = align_points(goal, lambda s: bent(s - 1.0))
    assert_allclose(simulated, shown, atol=1e-9)


@pytest.mark.parametrize("pose", ["known", "direction", "free"])
def test_the_gradient_is_that_of_differences(pose):
    p = two_layers(medium() if pose == "free" else medium(guide_distance_mm={"bounds": [5.0, 60.0]}))
    if pose == "direction":
        p = replace(p, insertions=tuple(map(from_first_point, p.insertions)))
    p = replace(p, dataset=replace(p.dataset, pose="free" if pose == "free" else "known"))
    theta = p.parameters.theta({**TRUTH, "mu1_pa": 5e5, "bevel_mm": 0.1, "guide_distance_mm": 20.0})
    assert_objective_slope(p, theta)


@pytest.mark.parametrize("nodes_at_once", [batch.NODES_AT_ONCE, 100])
def test_what_a_set_gives_does_not_depend_on_the_sets_beside_it(nodes_at_once, monkeypatch):
    monkeypatch.setattr(batch, "NODES_AT_ONCE", nodes_at_once)
    p = two_layers()
    thetas = p.lower + default_rng(1).uniform(0.4, 0.6, (16, len(p.names))) * (p.upper - p.lower)
    for evaluate in (p._objectives, p._log_densities):
        alone = [evaluate(theta[None], 1)[0] for theta in thetas]
        assert_array_equal(evaluate(thetas, 1), alone)
    for theta, (value, slopes) in zip(thetas, p._jacobians(thetas, 1), strict=True):
        ((value_alone, slopes_alone),) = p._jacobians(theta[None], 1)
        assert_array_equal(value, value_alone)
        assert_array_equal(slopes, slopes_alone)
    for theta, found in zip(thetas, p._distances(thetas, 1), strict=True):
        (alone,) = p._distances(theta[None], 1)
        assert found.total == alone.total
        assert_array_equal(found.differentiate(), alone.differentiate())
