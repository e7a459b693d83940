import itertools
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from inference_cases import TRUTH, Squares, insertion, measure, medium, problem, squares_recipe, two_layers

from needlefit.inference.fit import Callbacks, Start, start_from_dict, start_to_dict
from needlefit.inference.likelihood.observation import PLAIN_LIKELIHOOD
from needlefit.inference.optimize import minimize
from needlefit.inference.optimize.multistart import group_approaches
from needlefit.schemas.recipe import LikelihoodRecord


def rng():
    return np.random.default_rng(5)


def hills(theta):
    """Two minima of the first coordinate, at 0.5 (of value 0) and -1.5 (0.02)."""
    x, y = theta
    low = 0.2 * (x < -0.5)
    slope = np.sign(x + 0.5)
    return np.array([abs(x + 0.5) - 1, low, y - 0.1]), np.array([[slope, 0.0], [0.0, 0.0], [0.0, 1.0]])


def shifted(by):
    def moved(theta):
        return hills(np.asarray(theta) - by)

    return moved


def squares(function=hills, easier=None):
    return Squares(function, np.full(2, -2.0), np.full(2, 2.0), easier=easier)


def led(calls=None):
    """The two hills, approached by way of the same hills a little aside."""

    def counted(theta):
        if calls is not None:
            calls.append(0)
        return hills(theta)

    return squares(counted, squares(shifted(np.array([0.05, -0.05]))))


def test_starts_that_converge_are_merged():
    calls = []
    fit = minimize(led(calls), squares_recipe(starts=12), rng())
    alone = [start for start in fit.starts if start.joined is None]
    assert len(alone) == 2  # as many as there are hills
    assert {round(start.objective + 7.0, 6) for start in alone} == {0.0, 0.02}
    for start in fit.starts:
        leader = fit.starts[start.index if start.joined is None else start.joined]
        assert (start.theta, start.objective, start.stopped) == (leader.theta, leader.objective, "tolerance")
        assert start.theta0 != leader.theta0 or start is leader
    apart = minimize(squares(), squares_recipe(starts=12), rng())
    assert fit.theta == pytest.approx(apart.theta, abs=1e-6)
    assert [s.theta0 for s in fit.starts] == [s.theta0 for s in apart.starts]
    assert len(calls) < 0.4 * apart.evaluations


def test_what_is_not_merged():
    fit = minimize(led(), squares_recipe(approach=False), rng())
    assert {start.joined for start in fit.starts} == {None}
    nothing = squares(lambda theta: (np.full(2, np.nan), np.zeros((2, 2))))
    fit = minimize(squares(easier=nothing), squares_recipe(starts=4), rng())
    assert fit.objective == pytest.approx(-7.0, abs=1e-6)
    assert {start.joined for start in fit.starts} == {None} and fit.failures >= 4

    def end(index, theta, value):
        return Start(index, (0.0,), theta, value, 1, 0, "tolerance")

    ends = [end(0, (1.0, 5.0), 2.0), end(1, (1.0, 3.0), 2.0), end(2, (1.005, 3.0), 2.0 - 1e-4)]
    ends += [end(3, (1.0, 3.0), 2.1), end(4, (0.0, 0.0), math.inf), end(5, (0.0, 0.0), math.inf)]
    assert group_approaches(ends) == {0: 0, 1: 2, 2: 2, 3: 3, 4: 4, 5: 5}


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_resumed_fit_is_identical(jobs):
    search = squares_recipe(starts=8)
    whole = minimize(led(), search, rng())
    for kept in ([0], [3, 4, 5], range(7), range(8)):
        finished = {k: start_from_dict(json.loads(json.dumps(start_to_dict(whole.starts[k])))) for k in kept}
        assert minimize(led(), search, rng(), Callbacks(finished=finished, jobs=jobs)) == whole


def test_an_interrupted_approach_leaves_its_best_point():
    count = itertools.count()
    reported, steps = [], []
    callbacks = Callbacks(
        report=reported.append, stop=lambda: next(count) > 40, step=lambda *a: steps.append(a)
    )
    fit = minimize(led(), squares_recipe(starts=12), rng(), callbacks)
    assert fit.interrupted and reported == [] and len(steps) >= 2 and steps[0] == (1, 12)
    assert [start.stopped for start in fit.starts] == ["interrupted"]
    assert fit.objective == led().constant * -1 + 0.5 * float(np.sum(hills(np.array(fit.theta))[0] ** 2))


def test_uncertain_depths_are_approached_as_stated_and_a_metric_by_plain_squares():
    made = measure(TRUTH, medium(), insertion(40.0, (15.0,), (1, 2)))
    plain = PLAIN_LIKELIHOOD
    certain, uncertain = (
        problem(medium(), [made], plain.model_copy(update={"depths": d})) for d in ("fixed", "linear")
    )
    assert certain.approach("posterior") is None
    assert uncertain.approach("posterior") is None  # for no deviation of a depth is stated
    assert problem(medium(), [made], LikelihoodRecord()).approach("posterior") is None  # b is its own bevel
    bevels = problem(medium(), [made, replace(made, id="other")], LikelihoodRecord())
    assert bevels.approach("posterior").likelihood.bevel_spread == 0
    doubtful = problem(medium(), [replace(made, boundary_sd=0.1)], plain)
    assert doubtful.approach("posterior").likelihood.depths == "fixed"
    plain = doubtful.approach("metric")
    theta = plain.parameters.theta(TRUTH) + np.array([0.5, 0.0, 0.2])
    (simulated, measured), residuals = plain.points(theta)[0], plain.residuals(theta)
    off = simulated[:, 1] - measured[:, 1]
    # every point weighs as the next one does, but for what the pose's angle does to it
    assert np.corrcoef(off[1:], residuals[1:])[0, 1] > 0.95


@pytest.mark.sweep
def test_the_metric_ends_where_it_does_without_approach():
    task = two_layers()
    search = squares_recipe(minimize="metric", algorithm="slsqp", starts=4, evaluations=400)
    ends = [minimize(task, search.model_copy(update={"approach": a}), rng()) for a in (True, False)]
    assert ends[0].objective <= ends[1].objective + 1e-4
    assert ends[0].evaluations < ends[1].evaluations


@pytest.mark.parametrize("approach", [True, False])
def test_squares_and_gradients_end_at_the_same_posterior_of_needles(approach):
    made = measure(TRUTH, medium(), insertion(24.0, (9.0,), (1, 2)))
    task = problem(medium(), [replace(made, boundary_sd=0.1)])
    ways = ("leastsquares", "slsqp")
    fits = [minimize(task, squares_recipe(algorithm=way, starts=2, approach=approach), rng()) for way in ways]
    assert fits[0].objective == pytest.approx(fits[1].objective, abs=1e-6)
    assert task.log_posterior(np.array(fits[1].theta)) == -fits[1].objective
