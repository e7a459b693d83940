"""What a new specimen costs: how it is counted, the prior of an old medium, and a medium that is not new."""

import pickle

import numpy as np
import pytest
from scipy.stats import norm

from needlefit.errors import ConfigError
from needlefit.inference.parameters import (
    BEVEL_SPREAD_BOUNDS,
    Parameters,
    choose_hyperparameters,
    with_bevel_spread,
)
from needlefit.inference.problem import Problem
from needlefit.inference.transferred_prior import (
    MIN_SPREAD,
    TransferProblem,
    TransferredPrior,
    widen_posterior,
)
from needlefit.schemas.study import FitRecord
from needlefit.studies.job import Fold, Job, Settings
from needlefit.studies.kinds.adaptation import (
    REPORT,
    AdaptationRecord,
    AdaptationTask,
    Resampling,
    draw_orders,
    estimate,
    estimate_needed_count,
    plan,
)
from needlefit.studies.runner import run_analysis
from tests.inference_cases import dataset, insertion, measure, medium, squares_recipe


def _even(values, again):
    """Curves (O, N) as if they were of one needle."""
    return again.means(np.asarray(values)[:, :, None])


@pytest.mark.parametrize(("limit", "value"), [(2.5, 3), (3.0, 1), (5.0, 0), (0.5, np.inf)])
def test_a_count_is_the_first_from_which_on_the_mean_stays_within_the_limit(limit, value):
    # the mean is 5, 1, 3, 1: one insertion is enough for a moment, three are for good
    means = _even(
        [[6.0, 1.0, 4.0, 1.0], [4.0, 1.0, 2.0, 1.0]], Resampling.draw(2, 1, np.random.default_rng(1))
    )
    found = estimate_needed_count(means, (0, 1, 2, 3), np.full(len(means), limit))
    assert found.value == value
    assert np.isfinite(value) or (found.low, found.high) == (np.inf, np.inf)


def test_the_interval_of_a_count_is_what_other_orders_would_have_given():
    # with the first order alone one insertion is enough, with the second alone two
    means = _even([[9.0, 1.0, 1.0], [9.0, 5.0, 1.0]], Resampling.draw(2, 1, np.random.default_rng(1)))
    found = estimate_needed_count(means, (0, 1, 2), np.full(len(means), 2.0))
    assert (found.value, found.low, found.high) == (2, 1, 2)


def test_an_interval_is_of_needles_even_where_all_orders_agree_and_a_gain_is_paired_order_by_order():
    # two needles gain 0 and 1, whatever the order: their mean is 0.5, drawn again 0, 0.5 or 1
    again = Resampling.draw(3, 2, np.random.default_rng(1))
    found = estimate(again.means(np.tile([0.0, 1.0], (3, 1, 1)))[:, 0])
    assert (found.value, found.low, found.high) == (0.5, 0.0, 1.0)
    # orders differ by far more than the ways do, which leaves the difference sure
    again, methods = Resampling.draw(3, 1, np.random.default_rng(1)), np.array([[1.0], [10.0], [100.0]])
    found = estimate((_even(methods, again) - _even(methods - 0.5, again))[:, 0])
    assert (found.value, found.low, found.high) == pytest.approx((0.5, 0.5, 0.5))


def test_orders_differ_and_end_with_all_there_are():
    names = ("a", "b", "c", "d")
    drawn = draw_orders(names, 6, np.random.default_rng(3))
    assert len(set(drawn)) == 6 and all(sorted(order) == sorted(names) for order in drawn)
    assert len({tuple(sorted(order[:2])) for order in drawn}) > 3  # no rotations of one another
    assert len(set(draw_orders(("a", "b", "c"), 99, np.random.default_rng(3)))) == 6


def test_an_inflated_prior_is_the_old_posterior_widened_by_twice_the_spreads_square():
    old = Parameters.from_record(medium(layers=1))
    rng = np.random.default_rng(5)
    covariance = np.array([[0.4, -0.1], [-0.1, 0.05]])
    centre = old.theta({"mu1_pa": 3e5, "alpha1": 1.0, "bevel_mm": 0.08})
    thetas = centre + rng.multivariate_normal([0.0, 0.0], covariance, size=20000)
    fit = old.values(centre)
    same = widen_posterior(old, fit, thetas, old, {})
    wider = widen_posterior(old, fit, thetas, old, {"mu1_pa": 0.6, "bevel_mm": 0.2})
    assert [same.marginals[name][0] for name in old.free] == pytest.approx(centre)
    found, more = (np.linalg.inv(prior.information(old.free)) for prior in (same, wider))
    assert found == pytest.approx(covariance, abs=0.02)
    assert more - found == pytest.approx(np.diag([2 * 0.6**2, 2 * 0.2**2]), abs=1e-9)


def test_layers_that_the_old_medium_ties_may_differ_in_the_new_one():
    old = Parameters.from_record(medium(layers=2, mu2_pa={"tie": "2 * mu1_pa"}))
    new = Parameters.from_record(medium(layers=2))
    fit = old.values(old.theta({"mu1_pa": 1e5, "bevel_mm": 0.1}))
    thetas = np.array([old.theta(fit), old.theta({**fit, "mu1_pa": 1.2e5})])
    prior = widen_posterior(old, fit, thetas, new, {"mu1_pa": 0.5, "mu2_pa": 0.5})
    assert {name: np.exp(mean) for name, (mean, _) in prior.marginals.items()} == pytest.approx(
        {"mu1_pa": 1e5, "mu2_pa": 2e5, "bevel_mm": 0.1}
    )
    cov = np.linalg.inv(prior.information(new.free))
    together = np.log(1.2) ** 2 / 2
    assert cov[0, 1] == pytest.approx(together)
    assert cov[1, 1] == pytest.approx(together + 2 * 0.5**2 + MIN_SPREAD**2)


def test_the_mixture_has_both_parts_of_an_old_posterior():
    """A peak, and a plateau 6 away with a tenth of the draws: their Gaussian is far too wide at the peak."""
    parameters = Parameters.from_record(medium(layers=1))
    rng = np.random.default_rng(5)
    centre = parameters.theta({"mu1_pa": 3e5, "alpha1": 1.0, "bevel_mm": 0.08})
    thetas = centre + 0.1 * rng.standard_normal((1000, 2))
    thetas[:100, 0] += 6.0
    spread = {"mu1_pa": 0.3, "bevel_mm": 0.2}
    fit = parameters.values(centre)
    transferred = TransferredPrior.from_draws(parameters, fit, thetas, parameters, spread)
    prior = transferred.parameters.prior
    drawn = transferred.draw(4000, rng)
    assert np.mean(drawn[:, 0] > centre[0] + 3) == pytest.approx(0.1, abs=0.02)
    near = drawn[drawn[:, 0] < centre[0] + 3]
    assert np.std(near, axis=0) == pytest.approx(np.hypot(0.1, np.sqrt(2) * np.array([0.3, 0.2])), rel=0.05)
    # the mixture's density beside that of the two Gaussians from which all this was drawn
    sd = np.hypot(0.1, np.sqrt(2) * np.array([0.3, 0.2]))
    at = centre + np.array([[0.0, 0.0], [0.8, 0.3], [6.0, 0.0]])
    expected = [
        np.log(sum(w * np.prod(norm.pdf(one, centre + off, sd)) for w, off in ((0.9, [0, 0]), (0.1, [6, 0]))))
        for one in at
    ]
    found = transferred.correct(at) + [prior.log_density(parameters.values(one)) for one in at]
    assert found - found[0] == pytest.approx(np.array(expected) - expected[0], abs=0.1)
    problem = TransferProblem.of(_problem(parameters), transferred)
    plain = _problem(transferred.parameters)
    assert problem.log_posteriors(at) - plain.log_posteriors(at) == pytest.approx(transferred.correct(at))
    assert pickle.loads(pickle.dumps(problem)).transferred is not None


def _problem(parameters):
    one = measure(TRUTH, medium(layers=1), insertion(30.0), points=31)
    return Problem(dataset((one,)), (one,), medium(layers=1), parameters, squares_recipe().weights)


def test_the_prior_of_a_bevel_spread_counts_once():
    """Without data: draws of the half-normal prior of the old medium give the new one the same prior."""
    parameters = with_bevel_spread(Parameters.from_record(medium(layers=1)), 0.2)
    spreads = 0.2 * np.abs(np.random.default_rng(6).standard_normal(4000))
    fit = {"mu1_pa": 3e5, "alpha1": 1.0, "bevel_mm": 0.08, "bevel_spread": 0.2}
    thetas = np.tile(parameters.theta(fit), (4000, 1))
    thetas[:, -1] = np.log(np.maximum(spreads, 0.2 * BEVEL_SPREAD_BOUNDS[0]))
    transferred = TransferredPrior.from_draws(parameters, fit, thetas, parameters, {})
    problem = TransferProblem.of(_problem(transferred.parameters), transferred)
    at = np.tile(parameters.theta(fit), (2, 1))
    at[:, -1] = np.log([0.1, 0.4])
    transferred_density, stated_density = (p.log_posteriors(at) for p in (problem, _problem(parameters)))
    # smoothing the draws costs 0.1; the prior counted twice would add half of 2^2 - 0.5^2, less ln 4
    assert np.diff(transferred_density) == pytest.approx(np.diff(stated_density), abs=0.2)
    assert choose_hyperparameters(transferred.parameters)["bevel_spread"] == pytest.approx(0.2)


def test_media_without_a_common_parameter_and_bounds_that_miss_the_old_fit_are_refused():
    old = Parameters.from_record(medium(layers=1))
    fit = old.values(old.theta({"mu1_pa": 3e5, "bevel_mm": 0.08}))
    narrow = Parameters.from_record(medium(layers=1, mu1_pa={"bounds": [1e6, 1e8]}))
    with pytest.raises(ConfigError, match="mu1_pa"):
        widen_posterior(old, fit, old.theta(fit)[None], narrow, {})
    nothing = old.with_only((), fit)
    with pytest.raises(ConfigError, match=r"parameter.* common"):
        widen_posterior(old, fit, old.theta(fit)[None], nothing, {})


TRUTH = {"mu1_pa": 3e5, "alpha1": 1.0, "bevel_mm": 0.08}


def _job(name, insertions, every):
    record = medium(layers=1)
    fit = FitRecord.model_validate({"schema": 1, "dataset": "cases", "medium": "test"})
    recipe = squares_recipe(starts=2)
    parameters = Parameters.from_record(record)
    return Job(name, fit, dataset(every), record, parameters, recipe, None, (Fold("all", insertions, ()),))


@pytest.fixture(scope="module")
def not_new():
    """The old posterior in the same medium, without spread between media; needles without errors."""
    planned = [insertion(30.0 + 6 * k, side=(1, -1)[k % 2]) for k in range(4)]
    made = tuple(measure(TRUTH, medium(layers=1), one, points=31) for one in planned)
    sides = {"medium": "test", "insertions": {}}
    table = {"schema": 1, "kind": "adaptation", "dataset": "cases", "old": sides}
    table |= {"new": {**sides, "held_out": ("x",)}, "counts": (0, 1)}
    table["between_media"] = {"ln_mu_sd": 0, "ln_bevel_sd": 0, "source": "none"}
    record = AdaptationRecord.model_validate(table)
    old, new = _job("old", made[:2], made), _job("new", made[2:], made)
    training = {one.id: one for one in made[2:3]}
    task = AdaptationTask(record, Settings(), old, new, made[3:], training, (tuple(training),))
    return run_analysis("same", record, Settings(), plan(task))


def test_a_medium_that_is_not_new_costs_nothing(not_new):
    table = not_new.frames["insertions_needed"]
    counts = table[table["target"] == "floor"].set_index(["method", "metric"])["n"]
    assert [counts[one, "te_mm"] for one in ("none", "inflated", "new")] == [0, 0, 1]
    curves = not_new.frames["adaptation"].set_index(["method", "n"])
    errors, scores = curves["te_mm"], curves["tip_crps_mm"]
    assert errors["none", 0] < 1e-3
    assert errors["inflated", 0] == pytest.approx(errors["none", 0], abs=1e-6)
    assert scores["inflated", 0] == pytest.approx(scores["none", 0], rel=1e-6)  # the old posterior itself
    assert not_new.faults == ()
    # held-out insertions are never fitted
    assert set(not_new.frames["errors"]["insertion"]) == {"at48"}
    assert set(not_new.frames["fits"]["learned_from"]) == {"nothing", "at42"}


def test_the_report_has_a_line_per_approach_and_count(not_new):
    assert REPORT.summarize(not_new)
    curves, needed = REPORT.lay_out(not_new)
    # New insertions alone need one; without an update there is nothing to learn from.
    heads_and_counts = [(row[0] != "", row[1]) for row in curves.rows]
    assert heads_and_counts == [(True, "0"), (False, "1"), (True, "1"), (True, "0")]
    heads = [(column.label, column.unit) for column in curves.columns]
    assert len(set(heads)) == len(heads) and ("TE", "range, mm") in heads
    assert len(needed.rows) == 2 * len({row[0] for row in needed.rows}) and len(needed.columns) == 7
