"""The verdict's parts on problems whose answer is known: design, freed alpha, words of agreement."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from inference_cases import TRUTH, insertion, measure, medium, problem, two_layers

from needlefit.inference.fit import Fit
from needlefit.inference.identifiability import design_gain
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
from needlefit.inference.likelihood.nodes import ErrorAxis, Nodes, make_group, make_nodes
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


def test_words_of_a_profile_and_of_its_agreement_with_information_and_draws():
    profile = parabola("mu1_pa", math.log(1e6), low=math.log(71.2e3), high=math.log(14.4e6))
    judged = assess_parameter(ParameterProfile(profile, (math.log(1e3), math.log(1e9))), (1.0, PRIOR_SD))
    assert judged.profile_verdict.startswith("0.0712 to 14.4 MPa")
    judged = assess_parameter(ParameterProfile(parabola(), BOUNDS), (0.1, PRIOR_SD))
    assert judged.determined and judged.agreement == AGREEMENT
    assert judged.profile_verdict == "0.0822 to 0.122 mm (95 %)"
    profile = parabola()
    wide = replace(profile, low=profile.best - 10 * 0.196)
    judged = assess_parameter(ParameterProfile(wide, BOUNDS), (0.1, PRIOR_SD))
    assert "10 times" in judged.agreement and "below" in judged.agreement
    assert not judged.determined
    assert "in part" in judged.agreement
    judged = assess_parameter(
        ParameterProfile(parabola(ends=("bound", "closed"), low=BOUNDS[0]), BOUNDS), (0.1, PRIOR_SD)
    )
    assert not judged.determined
    assert judged.profile_verdict.startswith("not identifiable")
    assert re.findall(r"\d+\.\d+", judged.profile_verdict) == ["0.122", "0.001"]  # the limit and the bound
    judged = assess_parameter(
        ParameterProfile(parabola(), BOUNDS), (0.1, PRIOR_SD), (math.log(0.05), math.log(0.1))
    )
    assert re.findall(r"[\d.]*\d", judged.agreement)[-2:] == ["0.05", "0.1"]
    judged = assess_parameter(ParameterProfile(parabola(), BOUNDS), (0.25, PRIOR_SD))
    assert "2.5 times" in judged.agreement


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
    p = two_layers(count=1)
    one, two = (identify_parameters(p, profile_parameters(p, fit_at(p, TRUTH), jobs), {}) for jobs in (1, 2))
    assert one.points == two.points
    assert profile_parameters(p, fit_at(p, TRUTH), stop=lambda: True).parameters == ()


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
    # Fisher information of a design adds up over its insertions.
    record = medium(1)

    def predict_deviations(count):
        p = problem(record, [measure(TRUTH, record, insertion(40.0)) for _ in range(count)])
        return design_gain.expect_precision(lambda values: p, TRUTH, np.random.default_rng(1))

    one, four = predict_deviations(1), predict_deviations(4)
    assert len(one.sds) == 1 + design_gain.OTHER_POINTS
    assert four.directions[0].sd == pytest.approx(one.directions[0].sd / 2, rel=0.02)
    assert one.prior_sds == pytest.approx([math.log(1e6) / math.sqrt(12), math.log(500) / math.sqrt(12)])
    assert np.all(one.sds <= one.prior_sds * (1 + 1e-9))
    assert design_gain.expect_precision(lambda values: None, TRUTH, np.random.default_rng(1)) is None


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


# ---- what one more insertion tells, of data linear in Gaussian parameters

COVARIANCE = np.array([[1.0, -0.6], [-0.6, 0.5]])
SLOPES = np.array([[1.5, 0.4], [0.2, 1.1], [-0.7, 0.9]])  # (R, P), whitened


def predict_data(thetas: np.ndarray, by_depth: np.ndarray) -> design_gain.PredictedData:
    """Draws of equal weight whose data are SLOPES theta; one uncertain depth moves them by `by_depth`."""
    first = thetas @ SLOPES.T
    white = np.stack([first, first + by_depth, first - by_depth], axis=1)  # (B, m, R)
    turns = np.array([[1.0, 0.0, 0.0], [0.0, 0.5, -0.5]])
    one = insertion(30.0)
    nodes = Nodes(
        (one,) * 3, np.empty((3, 0)), (ErrorAxis(),), turns, np.zeros((0, 3)), bevel=False, rule=None
    )
    count = len(thetas)
    logs = np.full(count, -np.log(count))
    return design_gain.PredictedData(logs, np.ones(count), np.zeros(count), white, make_group(nodes))


@pytest.mark.parametrize("by_depth", [np.zeros(3), np.array([0.5, -1.0, 2.0])])
def test_nested_gain_and_deviations_are_those_of_the_linear_gaussian_case(by_depth):
    rng = np.random.default_rng(1)
    thetas = rng.multivariate_normal([0.0, 0.0], COVARIANCE, size=1200)
    found = design_gain.nested_gain(predict_data(thetas, by_depth), np.arange(400), thetas, rng)
    noise = np.eye(3) + np.outer(by_depth, by_depth)  # the depth, integrated over
    after = np.linalg.inv(np.linalg.inv(COVARIANCE) + SLOPES.T @ np.linalg.solve(noise, SLOPES))
    nats = 0.5 * np.log(np.linalg.det(COVARIANCE) / np.linalg.det(after))
    assert found.nats == pytest.approx(nats, abs=3.5 * found.nats_se)
    assert found.nats_se < 0.06
    assert found.sds == pytest.approx(np.sqrt(np.diag(after)), rel=0.05)
    fall = 0.5 * np.log(np.diag(COVARIANCE) / np.diag(after))
    assert found.quantity_nats == pytest.approx(fall, abs=0.05)


def test_linear_gain_is_half_the_log_determinant_and_uninformative_data_have_none():
    after = np.linalg.inv(np.linalg.inv(COVARIANCE) + SLOPES.T @ SLOPES)
    nats = 0.5 * np.log(np.linalg.det(COVARIANCE) / np.linalg.det(after))
    assert design_gain.linearized_gain(COVARIANCE, SLOPES) == pytest.approx(nats, rel=1e-9)
    rng = np.random.default_rng(4)
    thetas = rng.standard_normal((100, 1))
    group = make_group(make_nodes(insertion(30.0), np.empty(0), "fixed"))
    logs = np.full(100, -np.log(100.0))
    blind = design_gain.PredictedData(logs, np.ones(100), np.zeros(100), np.zeros((100, 1, 5)), group)
    found = design_gain.nested_gain(blind, np.arange(30), thetas, rng)
    assert found.nats == pytest.approx(0.0, abs=1e-12)
    assert found.quantity_nats == pytest.approx([0.0], abs=1e-12)
    assert found.effective_sample_size == pytest.approx(100.0)
