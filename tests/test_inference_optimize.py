import json
import math
import threading

import numpy as np
import pytest
from inference_cases import Analytic, Squares, box, recipe, squares_recipe

from needlefit.errors import ConfigError, FitError, ModelError
from needlefit.inference.fit import Callbacks, Start, start_from_dict, start_to_dict
from needlefit.inference.objective import EvaluationRecorder, ObjectiveFunction
from needlefit.inference.optimize import ALGORITHMS, minimize, starting_points
from needlefit.inference.optimize.local_search import certify_minimum

SINGLE = sorted(name for name, a in ALGORITHMS.items() if a.needs != "jacobian")


def bowl(theta):
    return float(np.sum((theta - 0.3) ** 2))


def rosenbrock(theta):
    return float(100 * (theta[1] - theta[0] ** 2) ** 2 + (1 - theta[0]) ** 2)


def rng():
    return np.random.default_rng(5)


@pytest.mark.parametrize("algorithm", [*SINGLE, "bobyqa+neldermead"])
@pytest.mark.parametrize("dimensions", [1, 2])
def test_every_algorithm_finds_the_bottom_of_a_bowl(algorithm, dimensions):
    fit = minimize(box(bowl, dimensions), recipe(algorithm=algorithm, evaluations=600), rng())
    assert fit.theta == pytest.approx(
        [0.3] * dimensions, abs=0.15 if algorithm in ("isres", "esch") else 0.02
    )
    assert fit.objective == bowl(np.array(fit.theta))
    assert fit.evaluations == sum(s.evaluations for s in fit.starts) <= 4 * 600


def test_valleys_budgets_stops_and_other_checkpoints():
    fit = minimize(box(rosenbrock), recipe(algorithm="bobyqa+neldermead", evaluations=400), rng())
    assert fit.theta == pytest.approx([1, 1], abs=1e-2)
    calls = []
    fit = minimize(box(lambda t: calls.append(0) or rosenbrock(t)), recipe(evaluations=17, starts=3), rng())
    assert [s.evaluations for s in fit.starts] == [17, 17, 17] and len(calls) == 51
    assert {s.stopped for s in fit.starts} == {"budget"}
    fit = minimize(box(bowl), recipe(), rng(), Callbacks(stop=lambda: True))
    assert fit.interrupted and fit.objective == math.inf and fit.starts == ()
    start = minimize(box(bowl), recipe(), rng()).starts[0]
    with pytest.raises(FitError, match="began elsewhere"):
        minimize(box(bowl), recipe(), np.random.default_rng(6), Callbacks(finished={0: start}))


@pytest.mark.parametrize("algorithm", SINGLE)
def test_nan_in_half_the_box_is_counted_and_never_wins(algorithm):
    def half(theta):
        return float("nan") if theta[0] < 0 else bowl(theta)

    fit = minimize(box(half), recipe(algorithm=algorithm), rng())
    assert fit.objective < 0.05 and fit.theta[0] >= 0
    lost = [s for s in fit.starts if s.stopped == "no finite value"]
    assert all(s.objective == math.inf and s.failures == s.evaluations for s in lost)
    assert fit.failures > 0


@pytest.mark.parametrize("algorithm", SINGLE)
@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_a_function_that_is_never_finite_is_no_success(algorithm, value):
    with pytest.raises(FitError, match="could be solved"):
        minimize(box(lambda theta: value), recipe(algorithm=algorithm, evaluations=50), rng())


@pytest.mark.parametrize("algorithm", SINGLE)
def test_errors_of_the_model_count_as_failed_solves(algorithm):
    def raising(theta):
        if theta[1] < -0.5:
            raise ModelError("the needle is too short")
        return bowl(theta)

    fit = minimize(box(raising), recipe(algorithm=algorithm), rng())
    assert fit.theta == pytest.approx([0.3, 0.3], abs=0.1)


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_bug_is_raised_not_counted(jobs):
    def bug(theta):
        raise KeyError("mu7_pa")

    with pytest.raises(KeyError, match="mu7_pa"):
        minimize(box(bug), recipe(), rng(), Callbacks(jobs=jobs))


@pytest.mark.parametrize("algorithm", SINGLE)
def test_the_result_does_not_depend_on_the_number_of_threads(algorithm):
    fits = [
        minimize(box(rosenbrock), recipe(algorithm=algorithm), rng(), Callbacks(jobs=j)) for j in (1, 2, 3)
    ]
    assert fits[0] == fits[1] == fits[2]


@pytest.mark.parametrize("algorithm", ["neldermead", "praxis", "crs2"])
@pytest.mark.parametrize("jobs", [1, 2])
def test_an_interrupted_search_resumes_to_the_identical_fit(algorithm, jobs):
    whole = minimize(box(rosenbrock), recipe(algorithm=algorithm), rng())
    reported, calls, lock = [], [0], threading.Lock()

    def stop():
        with lock:
            calls[0] += 1
            return calls[0] > 300

    callbacks = Callbacks(report=reported.append, stop=stop, jobs=jobs)
    part = minimize(box(rosenbrock), recipe(algorithm=algorithm), rng(), callbacks)
    assert part.interrupted and not whole.interrupted
    assert math.isfinite(part.objective) and part.objective == rosenbrock(np.array(part.theta))
    assert all(s.stopped != "interrupted" for s in reported)
    finished = {
        s.index: start_from_dict(json.loads(json.dumps(start_to_dict(s), allow_nan=False))) for s in reported
    }
    assert finished == {i: whole.starts[i] for i in finished} and 0 < len(finished) < 4
    evaluated = []

    def counted(theta):
        evaluated.append(0)
        return rosenbrock(theta)

    again = minimize(
        box(counted), recipe(algorithm=algorithm), rng(), Callbacks(finished=finished, jobs=jobs)
    )
    assert again == whole
    assert len(evaluated) == whole.evaluations - sum(s.evaluations for s in reported)


def test_starts_go_through_json_and_more_of_them_fill_the_box():
    theta = tuple(np.random.default_rng(1).normal(size=5).tolist())
    start = Start(3, theta, theta[::-1], math.inf, 7, 7, "no finite value")
    assert start_from_dict(json.loads(json.dumps(start_to_dict(start), allow_nan=False))) == start
    with pytest.raises(FitError, match="damaged"):
        start_from_dict({"index": 1})
    lower, upper = np.array([0.0, 10.0]), np.array([1.0, 20.0])
    few, many = (starting_points(lower, upper, n, np.random.default_rng(2)) for n in (8, 64))
    assert np.array_equal(few, many[:8])
    cells = np.histogram2d(*many.T, bins=4, range=[[0, 1], [10, 20]])[0]
    assert cells.min() >= 1  # 64 points leave none of 16 cells empty
    with pytest.raises(ConfigError, match="newton"):
        minimize(box(bowl), recipe(algorithm="sbplx+newton"), rng())
    fit = minimize(Analytic(lambda theta: 0.25, np.empty(0), np.empty(0)), recipe(), rng())
    assert fit.objective == 0.25 and fit.theta == () and fit.evaluations == 1 and not fit.interrupted


# ---- the posterior: a sum of squares with exact derivatives

BOTH = ("leastsquares", "slsqp", "lbfgs", "var2", "tnewton", "mma", "ccsaq", "bobyqa+neldermead", "sbplx")


def valley(theta):
    """Rosenbrock's valley as residuals, with its Jacobian."""
    residuals = np.array([10 * (theta[1] - theta[0] ** 2), 1 - theta[0]])
    return residuals, np.array([[-20 * theta[0], 10.0], [-1.0, 0.0]])


def squares(function, half=2.0, **changed):
    return Squares(function, np.full(2, -half), np.full(2, half), **changed)


@pytest.mark.parametrize("algorithm", BOTH)
def test_every_way_ends_at_the_same_log_posterior(algorithm):
    fit = minimize(
        squares(valley), squares_recipe(algorithm=algorithm, evaluations=20_000, tolerance=1e-10), rng()
    )
    assert fit.objective == pytest.approx(-7.0, abs=1e-6)
    assert fit.minimized == "posterior"
    assert sum(start.succeeded for start in fit.starts) >= 1


@pytest.mark.parametrize("algorithm", ["leastsquares", "slsqp", "lbfgs"])
def test_a_minimum_at_a_bound_is_found_and_flagged(algorithm):
    fit = minimize(squares(valley, half=0.5), squares_recipe(algorithm=algorithm), rng())
    # at theta0 = 0.5 the best theta1 is 0.25: half of (1 - 0.5)^2 is left
    assert fit.objective == pytest.approx(0.125 - 7.0, abs=1e-6)
    assert "bound" in {start.stopped for start in fit.starts}
    assert not any(start.succeeded for start in fit.starts)


def test_why_a_search_of_squares_stopped():
    # at the minimum the second derivatives are 0.28, and 1 by J^T J alone: that took 43 evaluations
    def bent(theta):
        x, y = theta
        return np.array([x, y, 0.9 - 0.4 * (x**2 + y**2)]), np.array([[1, 0], [0, 1], [-0.8 * x, -0.8 * y]])

    fit = minimize(squares(bent), squares_recipe(), rng())
    assert all(start.succeeded for start in fit.starts)
    assert fit.objective == pytest.approx(0.5 * 0.9**2 - 7.0, abs=1e-9)
    assert max(start.evaluations for start in fit.starts) <= 20
    fit = minimize(
        squares(lambda t: (np.array([1.0, t[0]]), np.array([[0, 0], [1.0, 0]]))), squares_recipe(), rng()
    )
    assert fit.objective == pytest.approx(0.5 - 7.0)
    assert {start.stopped for start in fit.starts} == {"flat"}
    loose = squares_recipe(algorithm="neldermead", tolerance=0.2)
    starts = minimize(squares(valley), loose, rng()).starts
    assert {start.stopped for start in starts if start.objective > -7 + 1e-4} == {"stalled"}

    class Wrong(Squares):
        def log_posterior(self, theta):
            return super().log_posterior(theta) - float(theta[0])

    fit = minimize(Wrong(valley, np.full(2, -2.0), np.full(2, 2.0)), squares_recipe(), rng())
    assert {start.stopped for start in fit.starts} == {"no sum of squares"}


@pytest.mark.parametrize(("misfit", "reason"), [(0.1, "stalled"), (100.0, "tolerance")])
def test_a_remaining_gain_counts_in_units_of_the_misfit(misfit, reason):
    def jacobian(theta):
        return np.append(np.full(20, misfit), theta), np.append(np.zeros((20, 1)), [[1.0]], axis=0)

    objective = ObjectiveFunction(
        np.array([-1.0]), np.array([1.0]), lambda theta: 0.0, jacobian=jacobian, absolute_tolerance=1e-9
    )
    recorder = EvaluationRecorder(objective, 10, lambda: False)
    recorder.theta = np.array([3e-3])  # a further step gains 4.5e-6
    assert certify_minimum(recorder, "tolerance") == reason


def test_least_squares_keeps_the_best_value_and_needs_a_sum_of_squares():
    whole = minimize(squares(valley), squares_recipe(starts=1), rng()).starts[0]
    for spent in range(whole.evaluations - 4, whole.evaluations + 1):
        start = minimize(squares(valley), squares_recipe(starts=1, evaluations=spent), rng()).starts[0]
        assert start.objective == pytest.approx(whole.objective, abs=1e-3)
    with pytest.raises(ConfigError, match="leastsquares"):
        minimize(squares(valley, squares=False), squares_recipe(), rng())
    with pytest.raises(ConfigError, match="leastsquares"):
        minimize(box(bowl), recipe(algorithm="leastsquares"), rng())

    def half(theta):
        residuals, slopes = valley(theta)
        return (residuals, slopes) if theta[0] > -1 else (residuals * np.nan, slopes)

    fit = minimize(squares(half), squares_recipe(starts=8), rng())
    assert fit.objective == pytest.approx(-7.0, abs=1e-6)
    assert {s.stopped for s in fit.starts if s.theta0[0] < -1} == {"no finite value"}


@pytest.mark.parametrize("algorithm", ["leastsquares", "slsqp"])
def test_evaluations_with_derivatives_are_counted_among_all_and_within_the_budget(algorithm):
    fit = minimize(squares(valley), squares_recipe(algorithm=algorithm, evaluations=15, starts=3), rng())
    assert {start.stopped for start in fit.starts} == {"budget"}
    assert all(0 < start.gradients < start.evaluations == 15 for start in fit.starts)
    assert fit.gradients == sum(start.gradients for start in fit.starts)


@pytest.mark.parametrize("algorithm", ["leastsquares", "slsqp", "crs2+leastsquares"])
@pytest.mark.parametrize("jobs", [1, 2])
def test_a_fit_by_derivatives_resumes_to_the_identical_fit(algorithm, jobs):
    search = squares_recipe(algorithm=algorithm, starts=6)
    whole = minimize(squares(valley), search, rng())
    finished = {s.index: start_from_dict(json.loads(json.dumps(start_to_dict(s)))) for s in whole.starts[1:4]}
    assert minimize(squares(valley), search, rng(), Callbacks(finished=finished, jobs=jobs)) == whole
