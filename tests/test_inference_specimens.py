"""Two stages against the joint Gaussian model in closed form, where posteriors of specimens are Gaussian."""

import math

import numpy as np
import pytest
from inference_cases import TRUTH, insertion, measure, medium, problem
from numpy.random import default_rng
from pytest import approx
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm, truncnorm

from needlefit.inference.fit import Callbacks
from needlefit.inference.forward_model import predict
from needlefit.inference.parameters import Parameters
from needlefit.inference.prior import Prior
from needlefit.inference.sampling.sample import sample_density
from needlefit.inference.specimens import (
    Population,
    Specimen,
    SpreadModel,
    differentiate_log_tip,
    draw_population,
    draw_specimens,
    make_spread_model,
)
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import BetweenSpecimensRecord, SampleRecord

RIDGE = np.array([[0.05, -0.024], [-0.024, 0.0144]])
BOUNDS = np.array([4.0, -7.0]), np.array([18.0, -0.5])
MEAN = np.array([10.0, -1.6])
SDS = math.log(2.0), math.log(1.8)


def parameters(**changed):
    return Parameters.from_record(MediumRecord.model_validate({**medium().model_dump(), **changed}))


def one_layer():
    bounds = {"mu1_pa": {"bounds": (1e2, 1e8)}, "alpha1": {"fixed": 1.0}, "bevel_mm": {"bounds": (1e-3, 0.6)}}
    return parameters(layers=1, parameters=bounds)


def three_layers():
    layers = {f"mu{n}_pa": {"bounds": (1e3, 1e9)} for n in (1, 2)} | {
        "mu3_pa": {"tie": "mu1_pa", "spread": 1.2},
        **{f"alpha{n}": {"fixed": 1.0} for n in (1, 2, 3)},
        "bevel_mm": {"bounds": (1e-3, 0.5)},
    }
    return parameters(layers=3, parameters=layers)


MODEL = SpreadModel.of(one_layer(), *SDS)


def test_the_prior_is_half_normal_and_of_uniform_correlation_and_share():
    model = SpreadModel.of(three_layers(), *SDS)
    covariances = model.covariances(model.draw(20_000, default_rng(3)))
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    assert np.sqrt(variances.mean(axis=0)) == approx([SDS[0], SDS[0], SDS[1]], rel=0.02)
    share = covariances[:, 0, 1] / variances[:, 0]
    rho = covariances[:, 0, 2] / np.sqrt(variances[:, 0] * variances[:, 2] * share)
    assert np.quantile(share, [0.1, 0.5, 0.9]) == approx([0.1, 0.5, 0.9], abs=0.02)
    assert np.quantile(rho, [0.1, 0.5, 0.9]) == approx([-0.8, 0.0, 0.8], abs=0.03)
    # the density is of the logarithms and of atanh and logit: its ratio at two places
    one, two = np.array([-1.0, -2.0, 0.5, 0.3]), np.array([-0.5, -1.0, -1.0, 2.0])

    def density(at):
        logs = sum(norm.logpdf(math.exp(x), scale=sd) + x for x, sd in zip(at[:2], SDS, strict=True))
        return logs - 2 * math.log(math.cosh(at[2])) - 2 * math.log(math.cosh(at[3] / 2))

    found = model.log_prior(np.array([one, two]))
    assert found[0] - found[1] == approx(density(one) - density(two))


@pytest.mark.parametrize("layers", [one_layer, three_layers])
def test_draws_and_density_of_the_spread_are_one_prior_also_with_tips(layers):
    known = layers()
    plain = SpreadModel.of(known, *SDS)
    tips = SpreadModel.of(known, *SDS, {"mu1_pa": 2.0, "mu2_pa": 1.0, "bevel_mm": 5.0})
    free, drawn = (one.draw(40_000, default_rng(3)) for one in (plain, tips))
    factor = np.exp(tips.log_prior(free) - plain.log_prior(free))
    assert factor.max() <= 1.0 and factor.mean() < 0.25
    # of those that are not too rare, as many as without tips once the factor is taken off again
    near = [tips.log_prior(some) - plain.log_prior(some) > -2.0 for some in (free, drawn)]
    back = np.exp(plain.log_prior(drawn) - tips.log_prior(drawn))[near[1]]
    assert factor.mean() * back.sum() / len(drawn) == approx(np.mean(near[0]), rel=0.05)
    tip = np.einsum("p,wpq,q->w", tips.tip_slopes, tips.covariances(drawn), tips.tip_slopes)
    assert np.mean(tip) < 2.0  # in squares of the stated standard deviation


def test_a_tip_is_differentiated_with_all_that_is_tied():
    record = medium(mu2_pa={"tie": "mu1_pa", "spread": 1.2})
    made = [measure(TRUTH, record, insertion(30.0 + 6 * k, (12.0,), (1, 2), (-1) ** k)) for k in range(2)]
    p = problem(record, made)
    theta = p.parameters.theta(TRUTH)

    def log_tip(at):
        return 0.5 * math.log(
            np.mean([predict(p.values(at), p.medium, one).tip_lateral ** 2 for one in p.insertions])
        )

    both = np.array([float(name in ("mu1_pa", "mu2_pa")) for name in p.names])
    bevel = np.array([float(name == "bevel_mm") for name in p.names])
    found = dict(zip(p.names, differentiate_log_tip(p, theta), strict=True))
    for name, along in (("mu1_pa", both), ("bevel_mm", bevel)):
        slope = (log_tip(theta + 1e-4 * along) - log_tip(theta - 1e-4 * along)) / 2e-4
        assert found[name] == approx(slope, rel=1e-3)
    model = make_spread_model(p, BetweenSpecimensRecord(tip_factor=1.1), theta)
    slopes = np.array([found[name] for name in model.names])
    implied = np.sum((slopes * np.log([2.0, 1.8])) ** 2)  # of the tip, by the other two priors
    stated = 1 / math.log(1.1) ** 2 - 1 / implied
    assert model.tip_slopes == approx(slopes * math.sqrt(stated))
    assert make_spread_model(p, BetweenSpecimensRecord(tip_factor=3.0), theta).tip_slopes == approx(0.0)


@pytest.mark.parametrize("rho", [0.0, -0.9])
def test_density_is_that_of_gaussian_estimates_whose_covariances_add(rho):
    """One kernel a specimen: estimates are N(m, S + T)."""
    estimates = [np.array([10.2, -1.7]), np.array([9.7, -1.5])]
    one = Population(tuple(Specimen(at[None], RIDGE) for at in estimates), BOUNDS, MODEL, Prior())
    spread = np.array([math.log(0.3), math.log(0.1), math.atanh(rho)])
    between = np.array([[0.09, rho * 0.03], [rho * 0.03, 0.01]])
    expected = sum(multivariate_normal.logpdf(at, MEAN, RIDGE + between) for at in estimates)
    expected += 2 * np.log(2 * np.pi) + float(MODEL.log_prior(spread[None])[0])
    assert one.log_density(np.array([[*MEAN, *spread]])) == approx([expected])


# ---- what is learned of the spread from some specimens; a new specimen


def gaussian(mean, covariance, seed):
    """Return draws with exactly this mean and covariance."""
    rough = default_rng(seed).standard_normal((1000, len(mean)))
    rough -= rough.mean(axis=0)
    white = rough @ np.linalg.inv(np.linalg.cholesky(np.cov(rough.T, bias=True))).T
    return mean + white @ np.linalg.cholesky(covariance).T


def walk(log_density, names, begin):
    """Go on from weighted draws by the ensemble of walkers of the default recipe."""
    assert len(names) == begin.thetas.shape[1] == 5
    settings = SampleRecord(independent_draws=2000, densities=60_000)
    return sample_density(log_density, names, begin, settings, default_rng(2), Callbacks())


@pytest.mark.parametrize("gap", [0.05, 2.0])
def test_two_specimens_tell_of_the_spread_of_b_what_their_difference_does(gap):
    """Of mu nothing is known: the marginal of tau_b is an integral."""
    covariance = np.diag([0.5, 1e-4])
    posteriors = {
        str(n): gaussian(np.array([11.0, b]), covariance, n) for n, b in enumerate((-3.0, gap - 3.0))
    }
    found = draw_population(one_layer(), MODEL, posteriors, 4000, default_rng(1))

    def density(tau, power):
        return tau**power * norm.pdf(tau, scale=SDS[1]) * norm.pdf(gap, scale=math.sqrt(2 * (tau**2 + 1e-4)))

    moments = [quad(density, 0, 3, args=(power,), points=(0.05, 0.2, 0.5, 1))[0] for power in (0, 2)]
    walked = draw_population(one_layer(), MODEL, posteriors, 4000, default_rng(1), walk)
    for one, source in ((found, "importance"), (walked, "posterior")):
        assert not one.faults and one.source == source
        assert one.rms[1] == approx(math.sqrt(moments[1] / moments[0]), rel=0.15)


def test_a_ridge_of_specimens_is_learned_along_and_across():
    """Specimens differ along mu^0.5 b = const by 0.8 in ln mu, across it by 0.03; a new one does as well."""
    rng = default_rng(5)
    along, across = np.array([1.0, -0.5]) * 0.8, np.array([0.5, 1.0]) * 0.03 / math.sqrt(1.25)
    posteriors = {}
    for n in range(12):
        theta = np.array([10.0, -3.0]) + rng.standard_normal() * along + rng.standard_normal() * across
        estimate = np.outer(along, along) / 9 + np.outer(across, across) / 9
        posteriors[str(n)] = gaussian(rng.multivariate_normal(theta, estimate), estimate, n)
    found = draw_population(one_layer(), MODEL, posteriors, 2000, rng)
    assert not found.faults and found.correlation < -0.97
    stiff = np.array([0.5, 1.0]) / math.sqrt(1.25)
    assert np.std(found.new[:, :2] @ stiff) < 0.1
    assert np.std(found.new[:, 0]) == approx(0.8, rel=0.4)
    # the mean is known better than one specimen, and each specimen as well as by itself at most
    assert np.std(found.mean[:, 0]) == approx(0.8 / math.sqrt(12), rel=0.4)
    assert np.std(found.tuned["0"][:, 0]) < 1.05 * np.std(posteriors["0"][:, 0])


def test_one_specimen_leaves_the_prior_and_a_new_one_stays_within_the_bounds():
    known = one_layer()
    tuned = known.theta({"mu1_pa": 1e5, "bevel_mm": 0.4})
    thetas = np.tile(tuned, (4000, 1))
    found = draw_population(known, MODEL, {"a": thetas}, 4000, default_rng(1))
    assert found.mean is thetas and found.rms == approx(SDS, rel=0.05)
    assert np.std(found.new[:, 0] - tuned[0]) == approx(math.sqrt(2) * SDS[0], rel=0.08)
    covariances = np.tile(np.diag([18.0, 4.5]), (4000, 1, 1))
    moved = draw_specimens(known, MODEL, thetas, covariances, default_rng(1))
    assert np.all((moved >= known.lower) & (moved <= known.upper))
    assert len(np.unique(moved[:, 1])) == len(moved)  # drawn again, not put on the bounds
    sds = np.sqrt([18.0, 4.5])
    kept = truncnorm((known.lower - tuned) / sds, (known.upper - tuned) / sds)
    assert np.mean(moved - tuned, axis=0) == approx(kept.mean() * sds, abs=0.1)


def test_a_new_specimen_has_its_own_moduli_and_its_own_ratio_between_layers():
    known = three_layers()
    model = SpreadModel.of(known, *SDS)
    tuned = known.theta({"mu1_pa": 1e5, "mu2_pa": 1e7, "mu3_pa": 2e5, "bevel_mm": 0.1})
    covariance = np.array([[0.36, 0.18, -0.09], [0.18, 0.36, 0.0], [-0.09, 0.0, 0.09]])
    covariances = np.tile(covariance, (40_000, 1, 1))
    moved = draw_specimens(known, model, np.tile(tuned, (40_000, 1)), covariances, default_rng(1))
    at = {name: moved[:, known.free.index(name)] - tuned[known.free.index(name)] for name in known.free}
    found = np.cov([at[name] for name in model.names])
    assert found == approx(covariance, abs=0.02)
    ratio = at["mu3_pa"] - at["mu1_pa"] + math.log(2)
    assert (np.mean(ratio), np.std(ratio)) == approx((0.0, math.log(1.2)), abs=0.01)
