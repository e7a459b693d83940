"""The verdict's parts on problems whose answer is known: design, freed alpha, words of agreement."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from inference_cases import TRUTH, insertion, measure, medium, problem, two_layers

from needlefit.inference.fit import Fit
from needlefit.inference.identifiability.design_gain import OTHER_POINTS, expect_precision
from needlefit.inference.identifiability.identify import (
    AGREEMENT,
    Identifiability,
    ParameterProfile,
    assess_parameter,
    find_fixed_shape,
    free_shape,
    identify,
    profile_parameters,
)
from needlefit.inference.identifiability.precision import format_sd
from needlefit.inference.identifiability.profile import DEVIANCE_95, LikelihoodProfile
from needlefit.studies.identification import identify_parameters, reconcile_verdict

MIDDLE = math.log(0.1)


def fit_at(p, values):
    theta = tuple(p.parameters.theta(values).tolist())
    return Fit(theta, p.values(theta), 0.0, (), 0, 0, False)


def parabola(name="bevel_mm", best=MIDDLE, sd=0.1, ends=("closed", "closed"), **changed):
    """The profile of a Gaussian."""
    at = best + sd * np.linspace(-2.5, 2.5, 9)
    half = math.sqrt(DEVIANCE_95) * sd
    made = LikelihoodProfile(
        name, at, ((at - best) / sd) ** 2, 2 * (at - best) / sd**2, at[:, None], best, sd,
        best - half, best + half, ends, 1, 9, 0,
    )  # fmt: skip
    return replace(made, **changed)


BOUNDS = (math.log(1e-3), math.log(0.5))
PRIOR_SD = (BOUNDS[1] - BOUNDS[0]) / math.sqrt(12)


@pytest.mark.parametrize(
    ("sd", "logarithm", "text"),
    [
        (0.118, True, "12 %"), (1.06, True, "factor 2.9"), (4.87, True, "factor 130"), (0.118, False, "0.12"),
    ],
)  # fmt: skip
def test_the_sd_of_a_logarithm_is_a_percentage_or_a_factor(sd, logarithm, text):
    assert format_sd(sd, logarithm) == text


def test_a_modulus_is_printed_in_one_unit():
    profile = parabola("mu1_pa", math.log(1e6), low=math.log(71.2e3), high=math.log(14.4e6))
    judged = assess_parameter(ParameterProfile(profile, (math.log(1e3), math.log(1e9))), (1.0, PRIOR_SD))
    assert judged.profile_verdict.startswith("0.0712 to 14.4 MPa")


def test_agreeing_information_profile_and_draws_are_reported_as_consistent():
    judged = assess_parameter(ParameterProfile(parabola(), BOUNDS), (0.1, PRIOR_SD))
    assert judged.determined and judged.agreement == AGREEMENT
    assert judged.profile_verdict == "0.0822 to 0.122 mm (95 %)"


def test_a_curved_ridge_is_reported_as_wider_than_its_information():
    profile = parabola()
    wide = replace(profile, low=profile.best - 10 * 0.196)
    judged = assess_parameter(ParameterProfile(wide, BOUNDS), (0.1, PRIOR_SD))
    assert "10 times" in judged.agreement and "below" in judged.agreement
    assert not judged.determined
    assert "in part" in judged.agreement


def test_an_open_profile_leaves_a_parameter_undetermined():
    judged = assess_parameter(
        ParameterProfile(parabola(ends=("bound", "closed"), low=BOUNDS[0]), BOUNDS), (0.1, PRIOR_SD)
    )
    assert not judged.determined
    assert judged.profile_verdict.startswith("not identifiable")
    assert re.findall(r"\d+\.\d+", judged.profile_verdict) == ["0.122", "0.001"]  # the limit and the bound


def test_starts_outside_the_interval_are_reported():
    judged = assess_parameter(
        ParameterProfile(parabola(), BOUNDS), (0.1, PRIOR_SD), (math.log(0.05), math.log(0.1))
    )
    assert re.findall(r"[\d.]*\d", judged.agreement)[-2:] == ["0.05", "0.1"]


def test_layers_of_one_material_share_the_alpha_that_is_freed():
    record = medium(
        4, mu3_pa={"tie": "mu1_pa", "spread": 1}, mu4_pa={"tie": "10 * mu2_pa"}, alpha3={"fixed": 1.0}
    )
    made = [measure({**TRUTH, "mu3_pa": 3e5, "alpha3": 1.0, "mu4_pa": 2e8, "alpha4": 1.0}, record,
                    insertion(40.0, (12.0, 25.0), (1, 2, 3)))]  # fmt: skip
    p = problem(record, made)
    assert find_fixed_shape(p) == {"alpha1": ("alpha3",), "alpha2": ()}  # layer 4 is not met
    opened = free_shape(p, "alpha1").parameters
    assert opened.bounds["alpha1"] == (-3.0, 5.0) and opened.ties["alpha3"] == (1.0, "alpha1")
    theta = opened.theta({**TRUTH, "alpha1": 2.5})
    assert opened.values(theta)["alpha3"] == 2.5


def test_a_fit_of_good_data_closes_and_its_fixed_alphas_are_flat():
    p = two_layers()
    examination = profile_parameters(p, fit_at(p, TRUTH))
    alphas = {one.name: one for one in examination.parameters if one.fixed_at is not None}
    assert set(alphas) == {"alpha1", "alpha2"} and all(one.profile.flat for one in alphas.values())
    assert all(one.tip_range_mm is not None and one.tip_range_mm < 0.02 for one in alphas.values())
    b = next(one.profile for one in examination.parameters if one.name == "bevel_mm")
    assert b.low < math.log(TRUTH["bevel_mm"]) < b.high
    found = identify_parameters(p, examination, {})
    assert {row["parameter"] for row in found.rows} == {*p.names, "alpha1", "alpha2"}
    assert all(not row["determined"] for row in found.rows if row["status"] == "fixed")
    assert min(row["deviance"] for row in found.points) == 0.0


def test_a_point_better_than_the_fit_is_reported_with_its_gain():
    p = two_layers()
    worse = {**TRUTH, "bevel_mm": 1.1 * TRUTH["bevel_mm"]}
    found = profile_parameters(p, fit_at(p, worse))
    lost = p.log_posterior(p.parameters.theta(TRUTH)) - p.log_posterior(p.parameters.theta(worse))
    assert found.gain >= lost - 0.01 and found.gain > 1
    assert p.log_posterior(np.array(found.best)) == pytest.approx(
        p.log_posterior(p.parameters.theta(worse)) + found.gain, abs=0.01
    )
    assert abs(profile_parameters(p, fit_at(p, TRUTH)).gain) < 0.01


def test_threads_change_nothing_and_a_stop_leaves_out_what_has_not_begun():
    p = two_layers(count=1)
    one, two = (identify_parameters(p, profile_parameters(p, fit_at(p, TRUTH), jobs), {}) for jobs in (1, 2))
    assert one.points == two.points
    assert profile_parameters(p, fit_at(p, TRUTH), stop=lambda: True).parameters == ()


def test_a_profile_overrules_a_verdict_that_the_information_gave():
    names = {"bevel_mm": True}
    verdict = Identifiability(
        {"bevel_mm": 0.1}, names, {"bevel_mm": ""}, {}, {}, 1, (), {"bevel_mm": "known"}, 1.0, False
    )
    kept = reconcile_verdict(
        verdict, {"bevel_mm": assess_parameter(ParameterProfile(parabola(), BOUNDS), (0.1, PRIOR_SD))}
    )
    assert kept.determined["bevel_mm"] and kept.notes["bevel_mm"] == "known"
    cut = assess_parameter(ParameterProfile(parabola(ends=("closed", "bound")), BOUNDS), (0.1, PRIOR_SD))
    lost = reconcile_verdict(verdict, {"bevel_mm": cut})
    assert not lost.determined["bevel_mm"] and "profile" in lost.notes["bevel_mm"]


def test_four_equal_insertions_halve_the_deviations():
    """Fisher information of a design adds up over its insertions."""
    record = medium(1)

    def predict_deviations(count):
        p = problem(record, [measure(TRUTH, record, insertion(40.0)) for _ in range(count)])
        return expect_precision(lambda values: p, TRUTH, np.random.default_rng(1))

    one, four = predict_deviations(1), predict_deviations(4)
    assert len(one.sds) == 1 + OTHER_POINTS
    assert four.directions[0].sd == pytest.approx(one.directions[0].sd / 2, rel=0.02)
    assert one.prior_sds == pytest.approx([math.log(1e6) / math.sqrt(12), math.log(500) / math.sqrt(12)])
    assert np.all(one.sds <= one.prior_sds * (1 + 1e-9))


def test_a_design_without_a_solution_is_none():
    assert expect_precision(lambda values: None, TRUTH, np.random.default_rng(1)) is None


def test_a_posterior_sd_that_the_information_does_not_imply_is_reported():
    judged = assess_parameter(ParameterProfile(parabola(), BOUNDS), (0.25, PRIOR_SD))
    assert "2.5 times" in judged.agreement


def test_draws_that_are_wider_than_the_information_decide_what_is_determined():
    p = two_layers()
    fit = fit_at(p, TRUTH)
    local = identify(p, fit)
    k, rng = p.names.index("bevel_mm"), np.random.default_rng(1)
    covariance = np.diag(np.square([local.sds[name] for name in p.names]))
    covariance[k, k] = 0.35**2
    found = identify(p, fit, rng.multivariate_normal(np.array(fit.theta), covariance, 4000))
    assert local.determined["bevel_mm"] and not found.determined["bevel_mm"]
    assert found.sds["bevel_mm"] == pytest.approx(0.35, rel=0.05)
    assert min(one.sd for one in found.directions) > min(one.sd for one in local.directions)
