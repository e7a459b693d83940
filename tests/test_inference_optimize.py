import json
import math
import threading

import numpy as np
import pytest
from inference_cases import Analytic, box, recipe

from needlefit.errors import ConfigError, FitError, ModelError
from needlefit.inference.optimize import ALGORITHMS, minimize, starting_points
from needlefit.inference.starts import Start, Watch, from_dict, to_dict

SINGLE = sorted(name for name, a in ALGORITHMS.items() if a.asks != "jacobian")


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


def test_a_curved_valley_is_followed_to_its_end():
    fit = minimize(box(rosenbrock), recipe(algorithm="bobyqa+neldermead", evaluations=400), rng())
    assert fit.theta == pytest.approx([1, 1], abs=1e-2)


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
        minimize(box(bug), recipe(), rng(), Watch(jobs=jobs))


@pytest.mark.parametrize("algorithm", SINGLE)
def test_the_result_does_not_depend_on_the_number_of_threads(algorithm):
    fits = [minimize(box(rosenbrock), recipe(algorithm=algorithm), rng(), Watch(jobs=j)) for j in (1, 2, 3)]
    assert fits[0] == fits[1] == fits[2]


def test_the_budget_is_kept_exactly():
    calls = []
    fit = minimize(box(lambda t: calls.append(0) or rosenbrock(t)), recipe(evaluations=17, starts=3), rng())
    assert [s.evaluations for s in fit.starts] == [17, 17, 17] and len(calls) == 51
    assert {s.stopped for s in fit.starts} == {"budget"}


@pytest.mark.parametrize("algorithm", ["neldermead", "praxis", "crs2"])
@pytest.mark.parametrize("jobs", [1, 2])
def test_an_interrupted_search_resumes_to_the_very_same_fit(algorithm, jobs):
    whole = minimize(box(rosenbrock), recipe(algorithm=algorithm), rng())
    reported, calls, lock = [], [0], threading.Lock()

    def stop():
        with lock:
            calls[0] += 1
            return calls[0] > 300

    watch = Watch(report=reported.append, stop=stop, jobs=jobs)
    part = minimize(box(rosenbrock), recipe(algorithm=algorithm), rng(), watch)
    assert part.interrupted and not whole.interrupted
    assert math.isfinite(part.objective) and part.objective == rosenbrock(np.array(part.theta))
    assert all(s.stopped != "interrupted" for s in reported)
    finished = {s.index: from_dict(json.loads(json.dumps(to_dict(s), allow_nan=False))) for s in reported}
    assert finished == {i: whole.starts[i] for i in finished} and 0 < len(finished) < 4
    evaluated = []

    def counted(theta):
        evaluated.append(0)
        return rosenbrock(theta)

    again = minimize(box(counted), recipe(algorithm=algorithm), rng(), Watch(finished=finished, jobs=jobs))
    assert again == whole
    assert len(evaluated) == whole.evaluations - sum(s.evaluations for s in reported)


def test_a_stop_before_the_first_evaluation_is_an_interrupted_fit_of_no_worth():
    fit = minimize(box(bowl), recipe(), rng(), Watch(stop=lambda: True))
    assert fit.interrupted and fit.objective == math.inf and fit.starts == ()


def test_a_checkpoint_of_another_fit_is_refused():
    start = minimize(box(bowl), recipe(), rng()).starts[0]
    with pytest.raises(FitError, match="began elsewhere"):
        minimize(box(bowl), recipe(), np.random.default_rng(6), Watch(finished={0: start}))


def test_starts_go_through_json_exactly():
    theta = tuple(np.random.default_rng(1).normal(size=5).tolist())
    start = Start(3, theta, theta[::-1], math.inf, 7, 7, "no finite value")
    assert from_dict(json.loads(json.dumps(to_dict(start), allow_nan=False))) == start
    with pytest.raises(FitError, match="damaged"):
        from_dict({"index": 1})


def test_more_starts_extend_fewer_and_fill_the_box():
    lower, upper = np.array([0.0, 10.0]), np.array([1.0, 20.0])
    few, many = (starting_points(lower, upper, n, np.random.default_rng(2)) for n in (8, 64))
    assert np.array_equal(few, many[:8])
    cells = np.histogram2d(*many.T, bins=4, range=[[0, 1], [10, 20]])[0]
    assert cells.min() >= 1  # 64 points leave none of 16 cells empty


def test_an_unknown_algorithm_is_named():
    with pytest.raises(ConfigError, match="newton"):
        minimize(box(bowl), recipe(algorithm="sbplx+newton"), rng())


def test_with_nothing_free_the_one_point_is_evaluated():
    fit = minimize(Analytic(lambda theta: 0.25, np.empty(0), np.empty(0)), recipe(), rng())
    assert fit.objective == 0.25 and fit.theta == () and fit.evaluations == 1 and not fit.interrupted
