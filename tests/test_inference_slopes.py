"""Exact derivatives of a problem, against central differences of what they differentiate."""

import math
from dataclasses import replace

import numpy as np
import pytest
from inference_cases import TRUTH, assert_one_density, insertion, measure, medium, problem

from needlefit.geometry.frames import align_rigid, differentiate_align_rigid
from needlefit.inference.identifiability.precision import difference_jacobian

PRIOR = {"bounds": [1e3, 1e9], "prior": {"median": 2e5, "factor": 2.0, "correlation": -0.6}}
ALPHA = {"bounds": [-30.0, 50.0], "prior": {"mean": 3.0, "sd": 2.0}}
LAYERS = {"boundaries": (9.0, 17.0, 26.0), "sequence": (1, 2, 1, 2)}

CASES = {
    "two layers, met twice": medium(),
    "tied": medium(mu2_pa={"tie": "40 * mu1_pa"}),
    "fixed bevel": medium(bevel_mm={"fixed": 0.08}),
    "stated before": medium(mu1_pa=PRIOR, alpha1=ALPHA),
    "guide": medium(guide_distance_mm={"bounds": [2.0, 60.0]}),
}


def case(name, **options):
    record = CASES[name]
    truth = {**TRUTH, "guide_distance_mm": 15.0} if name == "guide" else TRUTH
    made = [measure(truth, record, insertion(d, **LAYERS, side=side)) for d, side in ((34.3, 1), (41.0, -1))]
    p = problem(record, made, **options)
    return p, p.parameters.theta(truth) + 0.1 * np.cos(np.arange(len(p.names)))


@pytest.mark.parametrize("pose", ["known", "free"])
@pytest.mark.parametrize("name", CASES)
def test_values_and_derivatives_are_of_one_density(name, pose):
    assert_one_density(*case(name, pose=pose, drop=3.0 if pose == "free" else 0.0))


def test_a_solve_that_fails_has_no_derivatives():
    p, _ = case("fixed bevel")
    broken = replace(p, parameters=replace(p.parameters, fixed={**p.parameters.fixed, "bevel_mm": 30.0}))
    theta = np.log([1e9, 1e9])
    residuals, slopes = broken.jacobian(theta)
    assert np.isnan(residuals).any() and np.isnan(slopes).any()
    value, gradient = broken.gradient(theta)
    assert math.isnan(value) and np.isnan(gradient).all()


def test_outside_the_bounds_there_is_no_gradient():
    p, _ = case("tied")
    value, gradient = p.gradient(p.upper + 1e-3)
    assert value == -math.inf and np.isnan(gradient).all()


def test_an_alignment_is_differentiated_exactly():
    rng = np.random.default_rng(5)
    moving, fixed, slopes = rng.normal(size=(7, 2)), rng.normal(size=(7, 2)), rng.normal(size=(7, 2, 3))

    def aligned(t):
        return align_rigid(moving + slopes @ t, fixed).ravel()

    differences = difference_jacobian(aligned, np.zeros(3), np.full(3, 1e-5))
    exact = differentiate_align_rigid(moving, fixed, slopes).reshape(14, 3)
    np.testing.assert_allclose(exact, differences, atol=1e-8)
