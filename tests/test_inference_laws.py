"""Fits of laws with any number of shape parameters: derivatives, lanes, information, profiles, scenes."""

import numpy as np
import pytest
from inference_cases import BEVEL, MU, assert_one_density, insertion, measure, problem
from test_inference_identify import fit_at

from needlefit.datasets.insertion import Noise
from needlefit.inference.identifiability.verdict import identify
from needlefit.mechanics.laws import LAWS
from needlefit.schemas.medium import MediumRecord

SHAPE = {
    "linear": {},
    "fung": {"alpha1": 2.0, "alpha2": 0.7},
    "gent": {"jm1": 1.4, "jm2": 6.0},
    "two_term_ogden": {"alpha1": 3.1, "alpha2": 1.7, "beta1": -2.3, "beta2": -3.9}
    | {"share1": 0.3, "share2": 0.6},
}
NEEDLES = ((34.3, 1), (41.0, -1))


def make_case(law):
    """Two layers, met twice, so thin that the law matters; the shape is free."""
    truth = {"mu1_pa": 3e5, "mu2_pa": 2e6, **SHAPE[law], "bevel_mm": 0.08}
    table = {"mu1_pa": {"bounds": MU}, "mu2_pa": {"bounds": MU}, "bevel_mm": {"bounds": BEVEL}}
    record = MediumRecord.model_validate(
        {"schema": 1, "layers": 2, "law": law, "thickness_mm": 3.0, "parameters": table}
    )
    layers = {"boundaries": (9.0, 17.0, 26.0), "sequence": (1, 2, 1, 2)}
    made = [measure(truth, record, insertion(d, **layers, side=side)) for d, side in NEEDLES]
    return problem(record, made, noise=Noise(point_sd=0.02)), truth


@pytest.mark.parametrize("law", SHAPE)
def test_information_verdict_and_scene_have_every_parameter_of_a_law(law):
    p, truth = make_case(law)
    assert set(p.names) == set(truth)
    usual = {f"{one.name}{layer}": one.usual for one in LAWS[law].parameters for layer in (1, 2)}
    assert {name: p.parameters.bounds[name] for name in usual} == usual
    verdict = identify(p, fit_at(p, truth))
    assert set(verdict.sds) == set(truth) and all(np.isfinite(sd) for sd in verdict.sds.values())
    for name, (low, high) in usual.items():
        assert name.endswith("2") or verdict.sds[name] <= 1.01 * (high - low) / np.sqrt(12)


@pytest.mark.parametrize("law", SHAPE)
def test_values_and_derivatives_are_of_one_density(law):
    p, truth = make_case(law)
    theta = p.parameters.theta(truth)
    assert np.all(np.linalg.norm(p.jacobian(theta)[1], axis=0) > 1e-3)
    assert_one_density(p, theta + 0.01, rtol=2e-3, shape_step=2e-2)
