import math
from dataclasses import replace

import numpy as np
import pytest
from inference_cases import TRUTH, insertion, measure, medium, problem, two_layers
from numpy.random import default_rng
from pytest import approx

from needlefit.datasets.insertion import Noise
from needlefit.inference.fit import Fit, Start
from needlefit.inference.identifiability import design_gain
from needlefit.inference.identifiability.directions import KNOWN_BY_PRIOR, principal_directions
from needlefit.inference.identifiability.fit_profiles import profile_parameters
from needlefit.inference.identifiability.loosened_assumptions import STATED_TIES
from needlefit.inference.identifiability.verdict import identify
from needlefit.inference.likelihood.nodes import ErrorAxis, Nodes, make_group
from needlefit.inference.parameters import loosen_ties

FINE = Noise(point_sd=0.02)


def fit_at(p, values, *others):
    """A fit whose best point is known; `others` are (values, objective) of further starts."""
    theta = tuple(p.parameters.theta(values).tolist())
    best = p.objective(np.array(theta))
    starts = [Start(0, theta, theta, best, 1, 0, "tolerance")]
    for k, (other, objective) in enumerate(others, start=1):
        place = tuple(p.parameters.theta(other).tolist())
        starts.append(Start(k, place, place, objective, 1, 0, "tolerance"))
    return Fit(theta, p.values(theta), best, tuple(starts), len(starts), 0, False)


def test_undetermined_alpha_is_reported_and_takes_nothing_from_the_rest():
    record = medium(1, alpha1={"bounds": [-3, 5]})
    p = problem(record, [measure(TRUTH, record, insertion(d)) for d in (35.0, 50.0)], noise=FINE)
    verdict = identify(p, fit_at(p, TRUTH))
    assert not verdict.determined["alpha1"] and verdict.determined["bevel_mm"]
    assert verdict.sds["alpha1"] == approx(8 / math.sqrt(12), rel=0.01)  # its bounds, nothing more
    fixed, freed = medium(1), medium(1, alpha1={"bounds": [-3, 5]})
    made = [measure(TRUTH, fixed, insertion(d)) for d in (35.0, 50.0)]
    problems = (problem(record, made, noise=FINE) for record in (fixed, freed))
    sds = [identify(p, fit_at(p, TRUTH)).sds for p in problems]
    for name in ("mu1_pa", "bevel_mm"):
        assert sds[1][name] == approx(sds[0][name], rel=0.05)


def test_the_ridge_of_mu_and_b_is_found_and_named():
    """One short insertion in one layer tells one number: a combination of mu and b."""
    record = medium(1)
    p = problem(record, [measure(TRUTH, record, insertion(25.0, angle_sd=0.0))], noise=Noise(point_sd=0.2))
    verdict = identify(p, fit_at(p, TRUTH))
    assert not verdict.determined["mu1_pa"]
    best, worst = verdict.directions
    assert worst.sd > 5 * best.sd and best.words in verdict.notes["mu1_pa"]
    # moving along the ridge keeps the shape, moving across does not
    theta, step = np.array(p.parameters.theta(TRUTH)), 0.2
    along, across = (p.objective(theta + step * np.array(d.weights)) for d in (worst, best))
    assert across > 5 * along


def test_equally_good_starts_that_disagree_leave_nothing_determined():
    p = replace(two_layers(), noise=FINE)
    far = {**TRUTH, "mu2_pa": 2e9 / 100 * 50, "bevel_mm": 0.08}
    fits = [fit_at(p, TRUTH), fit_at(p, TRUTH, (far, 1e-3)), fit_at(p, TRUTH, (far, 0.5))]
    agreed, split, worse = (identify(p, fit) for fit in fits)
    assert worse.spread_high == agreed.spread_high
    assert split.spread_low["mu2_pa"] == approx(2e7) and split.spread_high["mu2_pa"] == approx(1e9)
    assert agreed.determined["mu2_pa"] and not split.determined["mu2_pa"]


@pytest.mark.parametrize(("name", "value", "bound"), [("mu1_pa", 1e9, "upper"), ("bevel_mm", 1e-3, "lower")])
def test_a_parameter_at_its_bound_is_flagged(name, value, bound):
    p = two_layers()
    verdict = identify(p, fit_at(p, {**TRUTH, name: value}))
    assert verdict.at_bound[name] == bound and not verdict.determined[name]


def test_residuals_stand_for_the_noise_or_widen_the_deviations():
    record = medium(1)
    rough = [
        measure(TRUTH, record, insertion(d), error=lambda xy: xy + 0.05 * np.sin(xy[:, :1] * 9))
        for d in (35.0, 50.0)
    ]
    unstated = problem(record, rough, noise=Noise())
    verdict = identify(unstated, fit_at(unstated, TRUTH))
    assert all(map(math.isfinite, verdict.sds.values()))
    still = insertion(45.0, angle_sd=0.0)
    wavy = [measure(TRUTH, record, still, error=lambda xy: xy + 0.2 * np.sin(xy[:, :1] * 9))]
    fine, coarse = (problem(record, wavy, noise=Noise(point_sd=sd)) for sd in (0.01, 0.1))
    first, second = (identify(p, fit_at(p, TRUTH)) for p in (fine, coarse))
    assert first.sds["bevel_mm"] == approx(second.sds["bevel_mm"], rel=0.1)


def test_a_direction_that_a_tie_alone_knows_is_marked():
    names, tie = ("mu1_pa", "mu3_pa"), math.log(1.2)
    prior = np.eye(2) / 4**2 + np.outer([1, -1], [1, -1]) / tie**2
    data = np.outer([1, 1], [1, 1]) / 0.1**2
    known, tied = principal_directions(data + prior, names, prior)
    assert known.is_informed and KNOWN_BY_PRIOR not in known.words
    assert tied.sd_ratio == approx(1.0) and not tied.is_informed and KNOWN_BY_PRIOR in tied.words
    assert tied.sd == approx(1 / math.sqrt(1 / 4**2 + 2 / tie**2))
    assert all(one.is_informed for one in principal_directions(data + prior, names))


def test_needles_that_differ_widen_the_deviations_and_repeats_of_one_do_not_count_twice():
    """Every needle has a bevel of its own: their scatter, not the noise, says how well b is known."""
    record = medium(1, mu1_pa={"fixed": TRUTH["mu1_pa"]})
    offsets = 0.08 * np.exp(0.2 * np.array([-1.5, -0.5, 0.5, 1.5, -1.0, 1.0, 0.0, 0.0]))
    made = [measure({**TRUTH, "bevel_mm": b}, record, insertion(40.0 + k)) for k, b in enumerate(offsets)]
    p = problem(record, made, noise=FINE)
    verdict = identify(p, fit_at(p, TRUTH))
    spread = 0.2 * np.std([-1.5, -0.5, 0.5, 1.5, -1.0, 1.0, 0.0, 0.0], ddof=1) / math.sqrt(8)
    assert verdict.sds["bevel_mm"] == approx(spread, rel=0.2)
    twice = [replace(i, id=f"{i.id}-{n}") for i in made for n in "ab"]
    again = identify(problem(record, twice, noise=FINE), fit_at(problem(record, twice, noise=FINE), TRUTH))
    assert again.sds["bevel_mm"] == approx(verdict.sds["bevel_mm"], rel=0.01)


# ---- under which assumptions alone a parameter is determined: ties, and a model without error

VALUES = {**TRUTH, "mu3_pa": 3e5, "alpha3": 1.0}


def tied_problem(spread=1):
    """Three layers; the third, deep one is tied to the first, which is thin."""
    record = medium(3, mu3_pa={"tie": "mu1_pa", "spread": spread})
    made = [
        measure(VALUES, record, insertion(depth, (4.0, 9.0), (1, 2, 3), angle_sd=0.0))
        for depth in (30.0, 40.0, 50.0)
    ]
    return problem(record, made, noise=Noise(point_sd=0.005))


def test_ties_are_loosened_and_what_only_a_tie_determines_is_not_determined():
    exact, spread = tied_problem().parameters, tied_problem(spread=1.2).parameters
    loose = loosen_ties(exact)
    assert "mu3_pa" in loose.names and not loose.ties
    assert loose.prior.ties[0].name == "mu3_pa"
    assert not loosen_ties(spread).prior.ties
    assert loosen_ties(loosen_ties(spread)) == loosen_ties(spread)
    p = tied_problem(spread=1.15)
    verdict = identify(p, fit_at(p, VALUES))
    assert verdict.sds["mu1_pa"] == approx(math.log(1.15), rel=0.05)  # from the third layer
    assert verdict.conditions["mu1_pa"] == STATED_TIES and not verdict.determined["mu1_pa"]
    # what a model error alone forbids is no matter of the tie
    assert verdict.conditions["mu3_pa"] != STATED_TIES and verdict.determined["bevel_mm"]


# ---- words of profiles, designs, and what one more insertion tells


def test_a_point_better_than_the_fit_is_reported_with_its_gain():
    p = two_layers()
    worse = {**TRUTH, "bevel_mm": 1.1 * TRUTH["bevel_mm"]}
    found = profile_parameters(p, fit_at(p, worse))
    lost = p.log_posterior(p.parameters.theta(TRUTH)) - p.log_posterior(p.parameters.theta(worse))
    assert found.gain >= lost - 0.01 and found.gain > 1
    assert abs(profile_parameters(p, fit_at(p, TRUTH)).gain) < 0.01


def test_four_equal_insertions_halve_the_deviations():
    # Fisher information of a design adds up over its insertions.
    record = medium(1)

    def predict_deviations(count):
        p = problem(record, [measure(TRUTH, record, insertion(40.0)) for _ in range(count)])
        return np.linalg.eigvalsh(design_gain.fisher_information(p, p.parameters.theta(TRUTH)))[-1] ** -0.5

    assert predict_deviations(4) == approx(predict_deviations(1) / 2, rel=0.02)


def test_draws_that_are_wider_than_the_information_decide_what_is_determined():
    p = two_layers()
    fit = fit_at(p, TRUTH)
    local = identify(p, fit)
    k, rng = p.names.index("bevel_mm"), default_rng(1)
    covariance = np.diag(np.square([local.sds[name] for name in p.names]))
    covariance[k, k] = 0.35**2
    found = identify(p, fit, rng.multivariate_normal(np.array(fit.theta), covariance, 4000))
    assert local.determined["bevel_mm"] and not found.determined["bevel_mm"]
    assert found.sds["bevel_mm"] == approx(0.35, rel=0.05)
    assert min(one.sd for one in found.directions) > min(one.sd for one in local.directions)


# ---- what one more insertion tells, of data linear in Gaussian parameters

COVARIANCE = np.array([[1.0, -0.6], [-0.6, 0.5]])
SLOPES = np.array([[1.5, 0.4], [0.2, 1.1], [-0.7, 0.9]])  # (R, P), whitened


def predict_data(thetas, by_depth):
    """Draws of equal weight whose data are SLOPES theta; one uncertain depth moves them by `by_depth`."""
    first = thetas @ SLOPES.T
    white = np.stack([first, first + by_depth, first - by_depth], axis=1)  # (B, m, R)
    turns = np.array([[1.0, 0.0, 0.0], [0.0, 0.5, -0.5]])
    one = insertion(30.0)
    nodes = Nodes((one,) * 3, np.empty((3, 0)), (ErrorAxis(),), turns, np.zeros((0, 3)), bevel=False)
    count = len(thetas)
    logs = np.full(count, -np.log(count))
    return design_gain.PredictedData(logs, np.ones(count), np.zeros(count), white, make_group(nodes))


@pytest.mark.parametrize("by_depth", [np.zeros(3), np.array([0.5, -1.0, 2.0])])
def test_nested_gain_and_deviations_are_those_of_the_linear_gaussian_case(by_depth):
    rng = default_rng(1)
    thetas = rng.multivariate_normal([0.0, 0.0], COVARIANCE, size=1200)
    found = design_gain.nested_gain(predict_data(thetas, by_depth), np.arange(400), thetas, rng)
    noise = np.eye(3) + np.outer(by_depth, by_depth)  # the depth, integrated over
    after = np.linalg.inv(np.linalg.inv(COVARIANCE) + SLOPES.T @ np.linalg.solve(noise, SLOPES))
    nats = 0.5 * np.log(np.linalg.det(COVARIANCE) / np.linalg.det(after))
    assert found.nats == approx(nats, abs=3.5 * found.nats_se)
    assert found.nats_se < 0.06
    assert found.sds == approx(np.sqrt(np.diag(after)), rel=0.05)
