import math

import numpy as np
import pytest
from inference_cases import MU, TRUTH, medium
from pytest import approx
from refusals import refusal
from scipy.stats import kstest

from needlefit.errors import ConfigError
from needlefit.inference.draws import draw_from_prior
from needlefit.inference.parameters import Parameters, make_tissue, with_hyperparameters, without_prior
from needlefit.schemas.medium import ParameterRecord
from needlefit.schemas.recipe import LikelihoodRecord


def test_theta_tissue_and_what_stays_free():
    p = Parameters.from_record(medium(alpha1={"bounds": [-3, 5]}, guide_distance_mm={"bounds": [1, 60]}))
    assert p.free == ("mu1_pa", "alpha1", "mu2_pa", "bevel_mm", "guide_distance_mm")
    theta = p.theta({"mu1_pa": 1e5, "alpha1": -2.5, "mu2_pa": 1e7, "bevel_mm": 0.1, "guide_distance_mm": 20})
    assert theta.tolist() == [math.log(1e5), -2.5, math.log(1e7), math.log(0.1), math.log(20)]
    assert p.values(theta)["mu2_pa"] == approx(1e7, rel=1e-12)
    assert p.lower.tolist() == [math.log(1e3), -3, math.log(1e3), math.log(1e-3), 0.0]
    met = make_tissue(TRUTH, (1, 2, 1), np.array([10.0, 20.0]), medium())
    assert met.mu == approx([0.3, 20.0, 0.3])
    assert met.alpha.tolist() == [1.0, -1.0, 1.0]
    refusal(ConfigError, "meets layer 3", lambda: make_tissue(TRUTH, (1, 3), np.array([10.0]), medium()))
    p = Parameters.from_record(medium(3, mu3_pa={"tie": "mu1_pa", "spread": 1}))
    paper = {"mu1_pa": 2e5, "alpha1": 1.0, "mu2_pa": 3e7, "alpha2": -1.0, "mu3_pa": 2e6, "alpha3": 0.5}
    b = p.with_only(["bevel_mm"], {**paper, "bevel_mm": 0.03})
    assert b.free == ("bevel_mm",)
    values = b.values(np.log([0.07]))
    assert values == approx({**paper, "bevel_mm": 0.07})
    mu = p.with_only(["mu1_pa"], {**paper, "bevel_mm": 0.03})
    assert mu.values(np.log([5e5]))["mu3_pa"] == approx(5e5)
    refusal(ConfigError, "alpha1", p.with_only, ["alpha1"], paper)


def test_a_tie_with_a_spread_reaches_no_modulus_that_cannot_be_simulated():
    record = medium(3, mu1_pa={"bounds": [1e4, 1e9]}, mu3_pa={"tie": "mu1_pa", "spread": 5.0})
    p = Parameters.from_record(record)
    assert p.bounds["mu3_pa"] == approx((1e4 / 5.0**6, 1e10))
    assert make_tissue(p.values(p.upper), (1, 2, 3), np.array([10.0, 20.0]), record).mu[2] == approx(
        1e4
    )  # MPa


def test_ties_follow_chains_multiply_factors_and_may_have_a_spread():
    record = medium(
        4,
        mu2_pa={"tie": "10 * mu1_pa"},
        mu3_pa={"tie": "0.5*mu2_pa"},
        mu4_pa={"tie": "mu3_pa", "spread": 1},
        alpha2={"tie": "-1 * alpha1"},
    )
    p = Parameters.from_record(record)
    values = p.values(p.theta({"mu1_pa": 2e4, "bevel_mm": 0.1}))
    got = [values[f"mu{k}_pa"] for k in (1, 2, 3, 4)]
    assert got == approx([2e4, 2e5, 1e5, 1e5])
    assert values["alpha2"] == -1.0
    assert p.status["mu4_pa"] == "tied" and p.status["alpha1"] == "fixed" and p.status["mu1_pa"] == "free"
    record = medium(
        4,
        mu2_pa={"tie": "10 * mu1_pa", "spread": 2.0},
        mu3_pa={"tie": "mu2_pa", "spread": 1},
        mu4_pa={"tie": "mu3_pa"},
    )
    p = Parameters.from_record(record)
    assert p.free == ("mu1_pa", "mu2_pa", "mu4_pa", "bevel_mm") and set(p.ties) == {"mu3_pa"}
    at = p.values(p.theta({"mu1_pa": 1e4, "mu2_pa": 2e5, "mu4_pa": 2.4e5, "bevel_mm": 0.1}))
    # ln 2 / ln 2 from ten times mu1, and ln 1.2 / ln 1.2 from mu3, which is mu2
    assert p.prior.residuals([at]) == approx(np.ones((1, 2)))
    assert p.prior.sd("mu1_pa") == p.prior.sd("mu4_pa") == math.inf
    assert p.bounds["mu2_pa"] == approx((MU[0] * 10 / 2**6, 1e10))
    exact = without_prior(p)
    assert exact.free == ("mu1_pa", "bevel_mm")
    assert exact.values(np.log([1e4, 0.1]))["mu4_pa"] == approx(1e5)


@pytest.mark.parametrize(
    "changed",
    [
        {"mu1_pa": {"tie": "mu9_pa"}},
        {"mu1_pa": {"tie": "mu2_pa"}, "mu2_pa": {"tie": "mu1_pa", "spread": 1}},
        {"mu1_pa": {"tie": "alpha1"}},
        {"alpha2": {"tie": "alpha1", "spread": 1.2}},
        {"mu1_pa": {"tie": "-2 * mu2_pa"}},
        {"mu1_pa": {"tie": "mu2_pa + 1"}},
        {"mu1_pa": {"bounds": [0, 1]}},
        {"mu1_pa": {"bounds": [1e4, 2e10]}},
    ],
)
def test_an_invalid_parameter_is_refused(changed):
    refusal(ConfigError, "", lambda: Parameters.from_record(medium(**changed)))


def test_missing_and_mistyped_parameters_are_named():
    record = medium()
    table = {name: p for name, p in record.parameters.items() if name != "mu2_pa"}
    with pytest.raises(ConfigError, match="`mu2_pa`"):
        Parameters.from_record(record.model_copy(update={"parameters": table}))
    mistyped = {**record.parameters, "alhpa1": ParameterRecord(fixed=1.0)}
    with pytest.raises(ConfigError, match="`alhpa1`"):
        Parameters.from_record(record.model_copy(update={"parameters": mistyped}))


def test_draws_of_the_prior_are_flat_where_only_ties_are_stated():
    record = medium(
        3,
        mu1_pa={"bounds": [1e4, 1e5]},
        mu2_pa={"tie": "2 * mu1_pa", "spread": 1.1},
        mu3_pa={"bounds": MU, "prior": {"median": 1e6, "factor": 2.0}},
    )
    p = with_hyperparameters(Parameters.from_record(record), LikelihoodRecord(bevel_spread=0.2))
    sets = [p.values(theta) for theta in draw_from_prior(p, 4000, np.random.default_rng(1))]
    drawn = {name: np.array([values[name] for values in sets]) for name in p.names}
    place = np.log(drawn["mu1_pa"] / 1e4) / math.log(10)
    assert kstest(place, "uniform").pvalue > 0.01
    ratio = np.log(drawn["mu2_pa"] / drawn["mu1_pa"] / 2) / math.log(1.1)
    assert kstest(ratio, "norm").pvalue > 0.01
    assert kstest(np.log(drawn["mu3_pa"] / 1e6) / math.log(2), "norm").pvalue > 0.01
    assert np.sqrt(np.mean(drawn["bevel_spread"] ** 2)) == approx(0.2, rel=0.05)
