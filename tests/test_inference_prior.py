"""Priors of a layer's mu and alpha: their density, what is refused, and the layer that takes one."""

import math

import numpy as np
import pytest
from inference_cases import medium
from numpy.random import default_rng
from pytest import approx
from refusals import refusal
from scipy import stats

from needlefit.errors import ConfigError
from needlefit.inference.draws import draw_from_prior
from needlefit.inference.parameter_changes import set_material_prior
from needlefit.inference.parameters import Parameters
from needlefit.project.toml import check
from needlefit.schemas.medium import MaterialRecord, MediumRecord, PriorRecord

ALPHA = {"mean": 3.0, "sd": 0.5}
MODULUS = {"median": 1e5, "factor": math.e, "correlation": 0.5}
BOUNDED = {"alpha1": {"bounds": [-3, 9], "prior": ALPHA}, "mu1_pa": {"bounds": [1e3, 1e9], "prior": MODULUS}}


def test_a_priors_density_is_gaussian_in_ln_mu_and_alpha():
    prior = Parameters.from_record(medium(1, alpha1=BOUNDED["alpha1"])).prior
    assert prior.log_density([{"alpha1": 4.0}]) == approx([-2.0])  # two deviations
    joint = Parameters.from_record(medium(1, **BOUNDED)).prior
    sets = [{"mu1_pa": 1e5, "alpha1": 3.0}, {"mu1_pa": 1e5 * math.e, "alpha1": 3.5}]
    assert joint.log_density(sets) == approx([0.0, -0.5 / 0.75])  # (1 - 2 r + 1) / (1 - r^2), r = 1/2
    precision = joint.information(("mu1_pa", "bevel_mm", "alpha1"))
    assert precision == approx(np.array([[1, 0, -1], [0, 0, 0], [-1, 0, 4]]) / 0.75)
    assert joint.sd("alpha1") == approx(0.5) and joint.sd("bevel_mm") == math.inf


@pytest.mark.parametrize("count", [1, 2, 4, 7])
def test_the_residuals_of_a_set_do_not_depend_on_those_beside_it(count):
    """To the bit: searches that run side by side ask for as many at once as happen to wait."""
    prior = Parameters.from_record(medium(1, **BOUNDED)).prior
    rng = default_rng(3)
    sets = [{"mu1_pa": 1e5 * math.exp(x), "alpha1": 3.0 + y} for x, y in rng.normal(size=(28, 2))]
    parts = [prior.residuals(sets[n : n + count]) for n in range(0, len(sets), count)]
    assert np.array_equal(np.concatenate(parts), prior.residuals(sets))


@pytest.mark.parametrize(
    ("stated", "distribution"),
    [
        ({"mean": 0.1, "sd": 0.05}, stats.gamma(4.0, scale=0.025)),
        ({"sd": 0.2}, stats.halfnorm(scale=0.2)),
        ("uniform", stats.uniform(scale=10.0)),
    ],
)
def test_a_positive_parameter_has_a_gamma_half_normal_or_uniform_prior(stated, distribution):
    """Of ln b, whose density is that of b times b; the residuals' slopes are differences of them."""
    parameters = Parameters.from_record(
        medium(1, bevel_mm={"bounds": [1e-6, 10.0], "prior": stated}, mu1_pa={"fixed": 1e5})
    )
    prior, values = parameters.prior, np.array([0.003, 0.1, 0.2, 0.5])
    density = prior.log_density([{"bevel_mm": value} for value in values])
    expected = distribution.logpdf(values) + np.log(values)
    alone = prior.log_marginals(("mu1_pa", "bevel_mm"), np.column_stack([0 * values, np.log(values)]))
    assert np.diff(density) == approx(np.diff(expected), rel=1e-9)
    assert np.diff(alone) == approx(np.diff(expected), rel=1e-9)
    for value in (0.02, 0.1 + 1e-7, 0.3):
        above, below = prior.residuals([{"bevel_mm": value * f} for f in (1 + 1e-6, 1 - 1e-6)])
        slope = prior.slopes(("bevel_mm",), {"bevel_mm": value})[:, 0]
        assert slope == approx((above - below) / 2e-6, rel=1e-4)
    drawn = np.exp(draw_from_prior(parameters, 4000, default_rng(1))[:, parameters.free.index("bevel_mm")])
    assert stats.kstest(drawn, distribution.cdf).pvalue > 0.01
    assert np.log(drawn).std() == approx(prior.sd("bevel_mm"), rel=0.05)


@pytest.mark.parametrize(
    "changed",
    [
        {"alpha1": {"fixed": 1.0, "prior": ALPHA}},
        {"alpha1": {"bounds": [-3, 9], "prior": {"mean": 1.0}}},
        {"alpha1": {"bounds": [-3, 9], "prior": {"median": 2, "factor": 2}}},
        {"mu1_pa": {"bounds": [1e3, 1e9], "prior": ALPHA}},
        {"mu1_pa": {"bounds": [1e3, 1e9], "prior": MODULUS}},
    ],
)
def test_an_invalid_prior_is_refused(changed):
    free = {"mu1_pa": {"bounds": [1e3, 1e9]}, "alpha1": {"fixed": 1.0}, "bevel_mm": {"bounds": [1e-3, 0.5]}}
    table = {"schema": 1, "layers": 1, "parameters": free | changed}
    refusal(ConfigError, "", lambda: Parameters.from_record(check(table, MediumRecord, "medium.toml")))


def test_a_test_of_the_material_frees_the_alpha_of_its_layer():
    tested = MaterialRecord(schema=1, alpha=PriorRecord(**ALPHA), mu_pa=PriorRecord(**MODULUS))
    parameters = Parameters.from_record(set_material_prior(medium(2), "2", tested))
    assert parameters.bounds["alpha2"] == (1.0, 5.0)  # four deviations
    assert parameters.prior.names == ("mu2_pa", "alpha2") and "alpha1" in parameters.fixed
    refusal(ConfigError, "no layer `3`", lambda: set_material_prior(medium(2), "3", tested))
