"""Parameters whose posterior is their prior: held, drawn from it, and freed where they move the needles."""

from dataclasses import replace

import numpy as np
import pytest
from inference_cases import NOISE, TRUTH, insertion, measure, medium, problem, squares_recipe
from numpy.random import default_rng
from problem_cases import make_problem
from pytest import approx

from needlefit.datasets.read import read
from needlefit.inference.forward_model import predict
from needlefit.inference.identifiability.information import posterior_sds
from needlefit.inference.identifiability.verdict import identify
from needlefit.inference.likelihood.observations import make_observation
from needlefit.inference.optimize import minimize
from needlefit.inference.parameter_changes import change_parameters, name_layers, search_freed
from needlefit.inference.parameters import Parameters
from needlefit.inference.prior_shift import central_range, draw_held, log_prior_integral, measure_shifts
from needlefit.inference.sampling.importance import resample_draws, sample_about_fit
from needlefit.inference.sampling.sample import sample
from needlefit.mechanics.shape import sample_inserted_points
from needlefit.project.locate import find_file
from needlefit.project.toml import load
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import SampleRecord

ALPHA = {"bounds": [-7, 9], "prior": {"mean": 1.0, "sd": 2.0}}
RECIPE = squares_recipe(starts=2)


def held_medium(**changed):
    """Two layers, alpha known by its prior: of the second one it is minus that of the first."""
    return medium(2, **({"alpha1": ALPHA, "alpha2": {"tie": "-1 * alpha1"}} | changed))


@pytest.fixture(scope="module")
def held():
    record = held_medium()
    planned = (insertion(d, [20.0], (1, 2)) for d in (35.0, 50.0))
    return problem(record, [measure(TRUTH, record, one) for one in planned], noise=NOISE)


def test_what_is_searched_is_the_same_at_the_centre_of_the_prior(held):
    assert held.names == ("mu1_pa", "alpha1", "mu2_pa", "bevel_mm")
    assert held.searched.names == ("mu1_pa", "mu2_pa", "bevel_mm")
    assert held.parameters.status["alpha1"] == held.parameters.status["alpha2"] == "prior"
    theta = held.parameters.theta(TRUTH)
    searched = held.parameters.restrict(theta)
    assert held.parameters.extend(searched) == approx(theta)
    assert held.searched.values(searched) == approx(held.values(theta))
    assert held.searched.log_posterior(searched) == approx(held.log_posterior(theta), abs=1e-9)
    assert held.holding(()).searched.names == held.names


def test_points_are_compared_with_the_standard_deviations_of_their_own_errors(held):
    """Errors of the pose are common to all points of a needle; each counts in the SD of every point."""
    one = held.insertions[1]
    sds = np.sqrt(np.diag(make_observation(held.dataset, one).covariance()))
    assert sds[-1] > 1.5 * sds[0]
    alphas = (1.0, *central_range(held.parameters, "alpha1"))
    assert alphas[1:] == approx((-2.92, 4.92), abs=1e-3)
    sets = [TRUTH | {"alpha1": alpha, "alpha2": -alpha} for alpha in alphas]
    shapes = [sample_inserted_points(predict(values, held.medium, one), 101) for values in sets]
    points = [shape[-len(sds) :, 1] for shape in shapes]
    expected = np.max(np.abs(np.subtract(points[1:], points[0])) / sds)
    alone = problem(held.medium, [one], noise=NOISE)
    (found,) = measure_shifts(alone, held.parameters.theta(TRUTH)[None]).values()
    assert found.in_noise == approx(expected, rel=0.02)


def test_each_of_three_parameters_has_its_own_shift():
    record = medium(3, **{f"alpha{n}": ALPHA for n in (1, 2, 3)})
    values = TRUTH | {"alpha2": 1.0, "mu3_pa": 3e5, "alpha3": 1.0}
    one = measure(values, record, insertion(50.0, [10.0, 20.0], (1, 2, 3)))
    known = problem(record, [one], noise=NOISE)
    found = measure_shifts(known, known.parameters.theta(values)[None])
    assert list(found) == ["alpha1", "alpha2", "alpha3"]
    for name, shift in found.items():
        ends = [values | {name: end} for end in (1.0, *central_range(known.parameters, name))]
        tips = [sample_inserted_points(predict(end, record, one), 2)[-1] for end in ends]
        assert shift.tip_mm == approx(max(np.linalg.norm(tips[1:] - tips[0], axis=1)), rel=1e-3)


def test_the_draws_of_what_is_held_are_those_of_its_prior(held):
    draws = draw_held(held.parameters, np.zeros((20_000, 3)), default_rng(1))
    assert draws[:, [0, 2, 3]] == approx(0.0)
    assert (draws[:, 1].mean(), draws[:, 1].std()) == approx((1.0, 2.0), abs=0.05)
    # the integral of exp(-(x - 1)^2 / 8) over four standard deviations on either side
    assert log_prior_integral(held.parameters) == approx(np.log(2 * np.sqrt(2 * np.pi)), abs=1e-4)


def test_a_fit_that_cannot_tell_alpha_holds_it_and_draws_it(held):
    fit = minimize(held, RECIPE, default_rng(1))
    assert fit.held == ("alpha1",) and fit.values["alpha1"] == 1.0 and len(fit.theta) == 4
    plain = minimize(held.searched, RECIPE, default_rng(1))
    assert held.parameters.restrict(np.array(fit.theta)) == approx(np.array(plain.theta))
    found = sample_about_fit(held, fit, default_rng(2))
    draws = resample_draws(found, 500, default_rng(3))
    alone = resample_draws(replace(found, parameters=None), 500, default_rng(3))
    assert held.parameters.restrict(draws.thetas) == approx(alone.thetas)
    assert draws.thetas[:, 1].std() == approx(2.0, abs=0.25)
    verdict = identify(held, fit, draws.thetas)
    assert set(verdict.sds) == {"mu1_pa", "mu2_pa", "bevel_mm"}
    settings = SampleRecord(walkers=8, densities=400, independent_draws=1)
    posterior = sample(held, found, settings, default_rng(4))
    assert posterior is not None and posterior.names == held.names
    alpha = posterior.draws[..., 1]
    assert (alpha.mean(), alpha.std()) == approx((1.0, 2.0), abs=0.3)
    assert posterior.convergence.loc["alpha1", "r_hat"] == 1.0


def test_a_prior_correlated_with_a_modulus_is_searched():
    modulus = {"bounds": [1e3, 1e9], "prior": {"median": 1e5, "factor": 2.0, "correlation": 0.5}}
    assert Parameters.from_record(held_medium(mu1_pa=modulus)).held == ()
    flat = {"bounds": [-3, 5]}
    assert Parameters.from_record(held_medium(alpha1=flat)).held == ()
    # an exponent that the tissue model leaves out has the usual prior of its law
    table = held_medium(alpha2=ALPHA).model_dump(by_alias=True)
    del table["parameters"]["alpha2"]
    left_out = Parameters.from_record(MediumRecord.model_validate(table))
    assert left_out.held == ("alpha1", "alpha2") and left_out.prior.marginals["alpha2"] == (1.0, 2.0)


def test_alpha_stands_for_that_of_every_layer_that_is_not_tied():
    record = medium(3, alpha1=ALPHA, alpha2={"tie": "alpha1"}, alpha3=ALPHA)
    assert name_layers(record, ["alpha", "alpha3"]) == ["alpha1", "alpha3"]
    known = Parameters.from_record(record)
    assert known.held == ("alpha1", "alpha3")
    assert search_freed(known, record, ["alpha3"]).held == ("alpha1",)
    assert search_freed(known, record, ["alpha"]).held == ()
    assert change_parameters(record, ["alpha"], {}).parameters == record.parameters
    assert Parameters.from_record(change_parameters(record, [], {"alpha1": 2.0})).fixed["alpha2"] == 2.0


def test_a_thin_gel_that_is_compressed_determines_alpha():
    """The dataset was made with alpha 2.643, mu 5546.2 Pa and b 0.03313 mm."""
    dataset, record = (
        read(find_file("dataset", "thin_gel")),
        load(find_file("medium", "thin_gel"), MediumRecord),
    )
    known = make_problem(dataset, dataset.insertions, record)
    assert known.parameters.held == ("alpha1",)
    first = minimize(known, RECIPE, default_rng(1))
    assert first.held == ()
    asked = known.with_parameters(search_freed(known.parameters, record, ["alpha"]))
    for fit in (first, minimize(asked, RECIPE, default_rng(1))):
        sds = posterior_sds(asked, np.array(fit.theta))
        assert sds["alpha1"] < 0.6  # of the prior it is 2
        truth = asked.parameters.theta({"alpha1": 2.643, "mu1_pa": 5546.2, "bevel_mm": 0.03313})
        away = (np.array(fit.theta) - truth) / list(sds.values())
        assert np.all(np.abs(away) < 2.0)
        assert fit.objective == approx(first.objective, abs=1e-3)
