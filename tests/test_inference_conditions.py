"""Under which assumptions alone a parameter is determined: ties, and a model without error."""

import math

import numpy as np
import pytest
from inference_cases import TRUTH, insertion, measure, medium, problem
from test_inference_identify import fit_at

from needlefit.datasets.insertion import Noise
from needlefit.inference.identifiability.identify import identify
from needlefit.inference.identifiability.precision import (
    MIN_MODEL_ERROR,
    NO_MODEL_ERROR,
    STATED_TIES,
    estimate_model_error,
)
from needlefit.inference.likelihood.observation import Discrepancy
from needlefit.inference.parameters import loosen_ties

VALUES = {**TRUTH, "mu3_pa": 3e5, "alpha3": 1.0}


def tied_problem(spread=1):
    """Three layers; the third, deep one is tied to the first, which is thin."""
    record = medium(3, mu3_pa={"tie": "mu1_pa", "spread": spread})
    made = [
        measure(VALUES, record, insertion(depth, (4.0, 9.0), (1, 2, 3), angle_sd=0.0))
        for depth in (30.0, 40.0, 50.0)
    ]
    return problem(record, made, noise=Noise(point_sd=0.005))


def test_exact_ties_are_loosened_and_those_with_a_spread_left_out():
    exact, spread = tied_problem().parameters, tied_problem(spread=1.2).parameters
    loose = loosen_ties(exact)
    assert "mu3_pa" in loose.names and not loose.ties
    assert loose.prior.ties[0].name == "mu3_pa"
    assert not loosen_ties(spread).prior.ties
    assert loosen_ties(loosen_ties(spread)) == loosen_ties(spread)


def test_what_only_a_tie_determines_is_not_determined():
    p = tied_problem(spread=1.2)
    verdict = identify(p, fit_at(p, VALUES))
    assert verdict.sds["mu1_pa"] == pytest.approx(math.log(1.2), rel=0.05)  # from the third layer
    assert verdict.conditions["mu1_pa"] == STATED_TIES and not verdict.determined["mu1_pa"]
    assert STATED_TIES in verdict.notes["mu1_pa"]
    assert verdict.determined["mu3_pa"] and verdict.determined["bevel_mm"]


def test_each_loosened_assumption_widens_what_exact_ties_give():
    p = tied_problem()
    verdict = identify(p, fit_at(p, VALUES))
    loose = {one.condition: one.sds for one in verdict.loosened}
    assert list(loose) == [STATED_TIES, NO_MODEL_ERROR]
    for name in p.names:
        assert verdict.sds[name] < loose[STATED_TIES][name] < loose[NO_MODEL_ERROR][name]
    assert loose[STATED_TIES]["mu1_pa"] > 10 * verdict.sds["mu1_pa"]
    assert verdict.conditions["mu3_pa"] == NO_MODEL_ERROR  # the tie says as much


def test_a_model_error_of_at_least_one_percent_of_the_deflection_widens_what_tiny_noise_gives():
    record = medium(1)
    made = [measure(TRUTH, record, insertion(d, angle_sd=0.0)) for d in (35.0, 50.0)]
    p = problem(record, made, noise=Noise(point_sd=1e-4))
    theta = np.array(p.parameters.theta(TRUTH))
    least = MIN_MODEL_ERROR * math.sqrt(np.mean([one.deflection**2 for one in p.insertions]))
    assert estimate_model_error(p, theta).sd == pytest.approx(least)
    verdict = identify(p, fit_at(p, TRUTH))
    assert verdict.loosened[-1].sds["mu1_pa"] > 3 * verdict.sds["mu1_pa"]


def test_the_model_error_has_the_size_of_the_misfit_beyond_the_noise():
    def bend(planar):
        wave = 0.2 * np.sin(2 * np.pi * planar[:, 0] / 30.0)
        return planar + np.column_stack((0 * wave, wave))

    record = medium(1)
    made = [measure(TRUTH, record, insertion(d, angle_sd=0.0), error=bend) for d in (60.0, 70.0, 80.0)]
    p = problem(record, made, noise=Noise(point_sd=0.01))
    found = estimate_model_error(p, np.array(p.parameters.theta(TRUTH)))
    assert 0.1 < found.sd < 0.3  # rms 0.14 mm


def test_the_covariance_of_a_discrepancy_fades_along_the_needle():
    found = Discrepancy(0.5, 10.0).covariance(np.array([0.0, 10.0]))
    assert found == pytest.approx(0.25 * np.array([[1, math.exp(-0.5)], [math.exp(-0.5), 1]]))
