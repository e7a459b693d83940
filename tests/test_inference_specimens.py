"""Two stages against the joint Gaussian model in closed form, where posteriors of specimens are Gaussian."""

import math

import numpy as np
import pytest
from inference_cases import medium
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm, truncnorm

from needlefit.inference.parameters import Parameters
from needlefit.inference.specimens import (
    KERNELS_PER_SPECIMEN,
    Population,
    Specimen,
    SpecimenEstimate,
    SpecimenSpread,
    best_determined,
    highest_density_interval,
    learn_spread,
    make_specimen,
    move_to_new_specimen,
)
from needlefit.schemas.medium import MediumRecord

RIDGE = np.array([[0.05, -0.024], [-0.024, 0.0144]])
BOUNDS = np.array([4.0, -7.0]), np.array([18.0, -0.5])
MEAN = np.array([10.0, -1.6])


def population(tau: float, count: int, seed: int) -> Population:
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        theta = MEAN + tau * rng.standard_normal(2)
        estimate = rng.multivariate_normal(theta, RIDGE)
        found.append(make_specimen(rng.multivariate_normal(estimate, RIDGE, size=KERNELS_PER_SPECIMEN)))
    return Population(tuple(found), BOUNDS, spread_sd=1.0)


def test_kernels_bounds_directions_and_shortest_intervals():
    draws = np.random.default_rng(1).multivariate_normal([1.0, 2.0], RIDGE, size=50)
    found = make_specimen(draws)
    assert found.mean == pytest.approx(draws.mean(axis=0))
    assert found.covariance == pytest.approx(np.cov(draws.T, bias=True))
    at = np.array([[*MEAN, -0.1, 0.1], [3.0, -1.6, 0.1, 0.1]])
    assert np.all(population(0.3, 3, 1).log_density(at) == -np.inf)
    draws = np.random.default_rng(7).multivariate_normal([0, 0], RIDGE, size=400)
    stiff = np.linalg.eigh(RIDGE)[1][:, 0]
    assert abs(best_determined([make_specimen(draws)]) @ stiff) == pytest.approx(1.0, abs=0.01)
    values = np.abs(np.random.default_rng(8).standard_normal(4000))
    low, high = highest_density_interval(values, np.full(4000, 1 / 4000), 0.95, 0.0)
    assert low == 0.0
    assert high == pytest.approx(1.96, abs=0.1)
    low, high = highest_density_interval(values, np.full(4000, 1 / 4000), 0.5, 0.0)
    assert high == pytest.approx(0.674, abs=0.06)


@pytest.mark.parametrize("tau", [(0.0, 0.0), (0.3, 0.1)])
def test_density_is_that_of_gaussian_estimates_whose_variances_add(tau):
    """One kernel a specimen: estimates are N(m, S + T), and tau has a half-normal prior."""
    estimates = [np.array([10.2, -1.7]), np.array([9.7, -1.5])]
    one = Population(tuple(Specimen(at[None], RIDGE) for at in estimates), BOUNDS, spread_sd=0.5)
    spread = RIDGE + np.diag(np.square(tau))
    expected = sum(multivariate_normal.logpdf(at, MEAN, spread) for at in estimates)
    expected += 2 * np.log(2 * np.pi) - 0.5 * float(np.sum(np.square(tau))) / 0.5**2
    assert one.log_density(np.array([[*MEAN, *tau]])) == pytest.approx([expected])


# ---- what is learned of the spread from some specimens, against integrals; a new specimen

PRIOR = (math.log(2.0), math.log(1.2))
WELL_KNOWN, UNKNOWN = 1e-4, 1e4


def parameters(**changed: object) -> Parameters:
    return Parameters.from_record(MediumRecord.model_validate({**medium().model_dump(), **changed}))


def one_layer() -> Parameters:
    bounds = {"mu1_pa": {"bounds": (1e3, 1e6)}, "alpha1": {"fixed": 1.0}, "bevel_mm": {"bounds": (1e-3, 0.5)}}
    return parameters(layers=1, parameters=bounds)


@pytest.mark.parametrize("gap", [0.05, 0.4, 2.0])
def test_two_specimens_tell_of_the_spread_of_b_what_their_difference_does(gap):
    found = learn_spread(
        [SpecimenEstimate(np.array([11.0, b]), np.diag([UNKNOWN, WELL_KNOWN])) for b in (-2.0, gap - 2.0)],
        one_layer(),
        PRIOR,
    )

    def density(tau: float, power: int) -> float:
        sd = math.sqrt(2 * (tau**2 + WELL_KNOWN))
        return tau**power * norm.pdf(tau, scale=PRIOR[1]) * norm.pdf(gap, scale=sd)

    moments = [quad(density, 0, 3, args=(power,), points=(0.05, 0.2, 0.5, 1))[0] for power in (0, 2)]
    assert found.specimens == 2
    assert found.rms[1] == pytest.approx(math.sqrt(moments[1] / moments[0]), rel=0.01)
    assert found.rms[0] == pytest.approx(PRIOR[0], rel=0.01)  # of mu nothing is known


def test_one_specimen_leaves_the_prior_and_a_new_one_stays_within_the_bounds():
    found = learn_spread([SpecimenEstimate(np.zeros(2), np.eye(2))], one_layer(), PRIOR)
    assert found.rms == pytest.approx(PRIOR, rel=1e-3) and found.weights.sum() == pytest.approx(1)
    known = one_layer()
    spread = SpecimenSpread(np.array([[3.0, 1.5]]), np.ones(1), 3)
    tuned = known.theta({"mu1_pa": 1e5, "bevel_mm": 0.4})
    moved = move_to_new_specimen(known, np.tile(tuned, (4000, 1)), spread, 1, np.random.default_rng(1))
    assert np.all((moved >= known.lower) & (moved <= known.upper))
    # drawn again, not put on the bounds
    assert len(np.unique(moved[:, 1])) == len(moved)
    kept = truncnorm(
        (known.lower - tuned) / [3, 1.5] / math.sqrt(2), (known.upper - tuned) / [3, 1.5] / math.sqrt(2)
    )
    assert np.mean(moved - tuned, axis=0) == pytest.approx(kept.mean() * [3, 1.5] * math.sqrt(2), abs=0.1)


def test_a_new_specimen_has_its_own_mean_of_the_moduli_and_its_own_ratio_between_layers():
    layers = {f"mu{n}_pa": {"bounds": (1e3, 1e9)} for n in (1, 2)} | {
        "mu3_pa": {"tie": "mu1_pa", "spread": 1.2},
        **{f"alpha{n}": {"fixed": 1.0} for n in (1, 2, 3)},
        "bevel_mm": {"bounds": (1e-3, 0.5)},
    }
    known = parameters(layers=3, parameters=layers)
    spread = SpecimenSpread(np.array([[0.6, 0.3]]), np.ones(1), 3)
    tuned = known.theta({"mu1_pa": 1e5, "mu2_pa": 1e7, "mu3_pa": 2e5, "bevel_mm": 0.1})
    moved = move_to_new_specimen(known, np.tile(tuned, (40000, 1)), spread, 2, np.random.default_rng(1))
    at = {name: moved[:, known.free.index(name)] - tuned[known.free.index(name)] for name in known.free}
    widen = math.sqrt(1 + 1 / 2)
    assert np.std(at["mu1_pa"]) == pytest.approx(0.6 * widen, rel=0.02)
    assert np.std(at["bevel_mm"]) == pytest.approx(0.3 * widen, rel=0.02)
    assert np.corrcoef(at["mu1_pa"], at["mu2_pa"])[0, 1] == pytest.approx(0.0, abs=0.02)
    ratio = at["mu3_pa"] - at["mu1_pa"] + math.log(2)
    assert (np.mean(ratio), np.std(ratio)) == pytest.approx((0.0, math.log(1.2)), abs=0.01)


def test_the_spread_is_learned_from_the_sources_of_ties_alone():
    """Layer 3 of one specimen is another material: it says nothing of how much specimens differ."""
    layers = {
        "mu1_pa": {"bounds": (1e3, 1e9)},
        "mu2_pa": {"tie": "mu1_pa", "spread": 1.2},
        "alpha1": {"fixed": 1.0},
        "alpha2": {"fixed": 1.0},
        "bevel_mm": {"bounds": (1e-3, 0.5)},
    }
    known, one = parameters(layers=2, parameters=layers), one_layer()
    covariance = np.array([[0.04, 0.01, 0.002], [0.01, 0.09, 0.0], [0.002, 0.0, 0.01]])
    means = (np.array([11.0, 11.1, -2.0]), np.array([11.3, 16.0, -2.2]))
    found = learn_spread([SpecimenEstimate(mean, covariance) for mean in means], known, PRIOR)
    kept = [0, 2]
    alone = [SpecimenEstimate(mean[kept], covariance[np.ix_(kept, kept)]) for mean in means]
    assert found.rms == pytest.approx(learn_spread(alone, one, PRIOR).rms, rel=1e-12)
