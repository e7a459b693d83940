"""The evidence is the integral of the density, also where most nodes are interpolated.

What is left out is predicted by the density of all data over that of the rest.
"""

from dataclasses import replace

import numpy as np
import pytest
from inference_cases import TRUTH, insertion, measure, medium, problem
from numpy.random import default_rng

from needlefit.inference.identifiability.profile import minimize_squares
from needlefit.inference.sampling import interpolated_density
from needlefit.inference.sampling.importance import Effort, sample_about_modes
from needlefit.inference.sampling.interpolated_density import InterpolatedDensity
from needlefit.inference.sampling.pareto_smoothing import leave_out_parts
from needlefit.schemas.recipe import LikelihoodRecord


@pytest.fixture(scope="module")
def layered():
    """mu1 and b of insertions through two layers, whose depths are uncertain."""
    record = medium(mu2_pa={"fixed": TRUTH["mu2_pa"]})
    planned = [
        replace(
            insertion(30.0 + 5 * k, (12.0 + 3 * k,), (1, 2), (1, -1)[k % 2]), boundary_sd=0.3, depth_sd=0.2
        )
        for k in range(3)
    ]
    return problem(
        record, [measure(TRUTH, record, one) for one in planned], LikelihoodRecord(bevel_spread=0.0)
    )


@pytest.mark.parametrize("bound", [0.02, 0.0])
def test_interpolated_densities_err_less_than_the_bound(layered, bound, monkeypatch):
    mode = minimize_squares(layered, layered.parameters.theta(TRUTH))
    draws = sample_about_modes(layered, [mode], default_rng(1), efforts=(Effort(),))
    thetas, counted = draws.thetas[:600], list[int]()
    monkeypatch.setattr(interpolated_density, "MAX_RMS_ERROR", bound)
    monkeypatch.setattr(
        InterpolatedDensity,
        "_evaluate",
        lambda self, at, own=InterpolatedDensity._evaluate: counted.append(len(at)) or own(self, at),
    )
    exact, found = layered.log_posteriors(thetas), InterpolatedDensity(layered, 1)(thetas)
    near = exact > exact.max() - 8
    errors = (found - exact)[near]
    assert np.sqrt(np.mean(errors**2)) <= max(bound, 1e-9) and near.sum() > 300
    # With a bound that cannot be met all that matter are evaluated; else a fifth.
    assert (sum(counted) >= near.sum()) if bound == 0 else (sum(counted) <= 140)


def test_what_is_left_out_is_predicted_by_the_density_of_all_over_that_of_the_rest():
    record = medium(mu2_pa={"fixed": TRUTH["mu2_pa"]})
    conditions = {"specimen": "one", "boundary_sd": 0.3, "boundary_shared_sd": 0.2, "depth_sd": 0.2}
    planned = [
        replace(insertion(30.0 + 5 * k, (12.0,), (1, 2), (1, -1)[k % 2]), **conditions) for k in range(3)
    ]
    made = [measure(TRUTH, record, one, error=lambda planar: planar * [1.0, 1.02]) for one in planned]
    how = LikelihoodRecord(noise_scale="estimated")
    # of centred bevels the rest would be another model: their mean is that of the insertions fitted to
    whole = replace(problem(record, made, how), centred_bevels=False)
    thetas = whole.parameters.theta({**TRUTH, "noise_scale": 0.5, "bevel_spread": 0.1}) + np.array(
        [[0.0] * 4, [0.1, 0.0, 0.4, 0.3]]
    )
    found = whole.log_predictive(thetas, [[0], [1, 2], [0, 1, 2]])
    for column, kept in enumerate(([1, 2], [0])):
        rest = replace(whole, insertions=tuple(made[k] for k in kept))
        expected = whole.log_posteriors(thetas) - rest.log_posteriors(thetas)
        assert found[:, column] == pytest.approx(expected, abs=1e-8)
    assert np.all(np.isfinite(found)) and np.ptp(found, axis=0).min() > 0.1


def test_values_left_out_of_a_known_mean_have_their_known_density():
    """n values with SD 1 about a mean with a flat prior: n - 1 predict one with variance 1 + 1 / (n - 1)."""
    rng = default_rng(5)
    values = rng.normal(size=10)
    means = rng.normal(values.mean(), 10**-0.5, size=4000)
    elpd, k = leave_out_parts(-0.5 * (values - means[:, None]) ** 2 - 0.5 * np.log(2 * np.pi))
    others, variance = (values.sum() - values) / 9, 1 + 1 / 9
    expected = -0.5 * (values - others) ** 2 / variance - 0.5 * np.log(2 * np.pi * variance)
    assert elpd == pytest.approx(expected, abs=0.02) and k.max() < 0.5
