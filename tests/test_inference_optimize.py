import math

import numpy as np
import pytest
from inference_cases import Analytic, Squares, box, recipe, squares_recipe
from numpy.random import default_rng
from pytest import approx

from needlefit.errors import FitError, ModelError
from needlefit.inference.fit import Callbacks, EvaluationRecorder, Fit, ObjectiveFunction, Start
from needlefit.inference.metric_objective import WeightedDistances
from needlefit.inference.optimize import minimize, run_gauss_newton, starting_points
from needlefit.project.callbacks import never_stop
from needlefit.project.checkpoint import open_checkpoint


def bowl(theta):
    return float(np.sum((theta - 0.3) ** 2))


def rosenbrock(theta):
    return float(100 * (theta[1] - theta[0] ** 2) ** 2 + (1 - theta[0]) ** 2)


def rng():
    return default_rng(5)


def test_valleys_budgets_and_stops():
    fit = minimize(box(rosenbrock), recipe(evaluations=400), rng())
    assert fit.theta == approx([1, 1], abs=1e-2) and fit.objective == rosenbrock(np.array(fit.theta))
    assert fit.evaluations == sum(s.evaluations for s in fit.starts)
    fit = minimize(box(rosenbrock), recipe(evaluations=17, starts=3), rng())
    assert [s.evaluations for s in fit.starts] == [16, 16, 16]
    assert {s.stopped for s in fit.starts} == {"budget"}
    fit = minimize(box(bowl), recipe(), rng(), Callbacks(stop=lambda: True))
    assert fit.interrupted and fit.objective == math.inf and fit.starts == ()


def test_nan_and_errors_of_the_model_in_half_the_box_are_counted_and_never_win():
    fit = minimize(box(half), recipe(), rng())
    assert fit.objective < 0.05 and fit.theta[0] >= 0
    lost = [s for s in fit.starts if s.stopped == "no finite value"]
    assert all(s.objective == math.inf and s.failures == s.evaluations for s in lost)
    assert fit.failures > 0


def test_a_function_that_is_never_finite_is_no_success():
    with pytest.raises(FitError, match="could be solved"):
        minimize(box(lambda theta: -math.inf), recipe(evaluations=50), rng())


def test_fits_go_through_a_checkpoint_and_more_starts_fill_the_box(tmp_path):
    theta = tuple(default_rng(1).normal(size=5).tolist())
    start = Start(3, theta, theta[::-1], math.inf, 7, 7, "no finite value")
    fit = Fit(theta, {"mu1_pa": theta[0]}, theta[1], (start,), 7, 7, False, held=("alpha1",))
    checkpoint = open_checkpoint(tmp_path / "c", False, {})
    checkpoint.keep_row("fold", {"index": 1})
    assert checkpoint.read("fold", Fit) is None
    checkpoint.keep("fold", fit)
    assert checkpoint.read("fold", Fit) == fit
    lower, upper = np.array([0.0, 10.0]), np.array([1.0, 20.0])
    few, many = (starting_points(lower, upper, n, default_rng(2)) for n in (8, 64))
    assert np.array_equal(few, many[:8])
    cells = np.histogram2d(*many.T, bins=4, range=[[0, 1], [10, 20]])[0]
    assert cells.min() >= 1  # 64 points leave none of 16 cells empty
    fit = minimize(Analytic(lambda theta: 0.25, np.empty(0), np.empty(0)), recipe(), rng())
    assert fit.objective == 0.25 and fit.theta == () and fit.evaluations == 2 and not fit.interrupted


# ---- the posterior: a sum of squares with exact derivatives


def valley(theta):
    """Rosenbrock's valley as residuals, with its Jacobian."""
    residuals = np.array([10 * (theta[1] - theta[0] ** 2), 1 - theta[0]])
    return residuals, np.array([[-20 * theta[0], 10.0], [-1.0, 0.0]])


def squares(function, half=2.0):
    return Squares(function, np.full(2, -half), np.full(2, half))


def test_a_minimum_at_a_bound_is_found_and_flagged():
    fit = minimize(squares(valley, half=0.5), squares_recipe(), rng())
    # at theta0 = 0.5 the best theta1 is 0.25: half of (1 - 0.5)^2 is left
    assert fit.objective == approx(0.125 - 7.0, abs=1e-6)
    assert "bound" in {start.stopped for start in fit.starts}
    assert not any(start.stopped == "tolerance" for start in fit.starts)


def test_why_a_search_of_squares_stopped():
    # at the minimum the second derivatives are 0.28, and 1 by J^T J alone: that took 43 evaluations
    def bent(theta):
        x, y = theta
        return np.array([x, y, 0.9 - 0.4 * (x**2 + y**2)]), np.array([[1, 0], [0, 1], [-0.8 * x, -0.8 * y]])

    fit = minimize(squares(bent), squares_recipe(), rng())
    assert all(start.stopped == "tolerance" for start in fit.starts)
    assert fit.objective == approx(0.5 * 0.9**2 - 7.0, abs=1e-9)
    assert max(start.evaluations for start in fit.starts) <= 20
    fit = minimize(
        squares(lambda t: (np.array([1.0, t[0]]), np.array([[0, 0], [1.0, 0]]))), squares_recipe(), rng()
    )
    assert fit.objective == approx(0.5 - 7.0)
    assert {start.stopped for start in fit.starts} == {"flat"}


# ---- what could not be solved is counted, and its first points fail again for the same reason


def half(theta):
    """A bowl; no number, or an error, left of 0."""
    if theta[0] < -1:
        raise ModelError("the needle is too short", expected="a longer one")
    return math.nan if theta[0] < 0 else float(np.sum((theta - 0.3) ** 2))


# ---- starts are approached by an easier problem, and those that converge merged


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


def hill_squares(function=hills, easier=None):
    return Squares(function, np.full(2, -2.0), np.full(2, 2.0), plain=easier)


def led(calls=None):
    """The two hills, approached by way of the same hills a little aside."""

    def counted(theta):
        if calls is not None:
            calls.append(0)
        return hills(theta)

    return hill_squares(counted, hill_squares(shifted(np.array([0.05, -0.05]))))


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
    apart = minimize(hill_squares(), squares_recipe(starts=12), rng())
    assert fit.theta == approx(apart.theta, abs=1e-6)
    assert [s.theta0 for s in fit.starts] == [s.theta0 for s in apart.starts]
    assert len(calls) < 0.4 * apart.evaluations


def far_hills(theta):
    """The second hill is 50 high."""
    residuals, jacobian = hills(theta)
    return np.array([residuals[0], 50 * residuals[1], residuals[2]]), jacobian


def test_starts_far_behind_the_best_are_not_continued():
    fit = minimize(hill_squares(far_hills, hill_squares(far_hills)), squares_recipe(starts=12), rng())
    left = [start for start in fit.starts if start.stopped == "behind"]
    assert len(left) >= 2 and {start.stopped for start in fit.starts} == {"tolerance", "behind"}
    assert {round(start.objective + 7.0, 6) for start in left} == {50.0}
    assert all(start.theta[0] == approx(-1.5, abs=1e-4) for start in left)


BY_THREADS = [
    (lambda: box(rosenbrock), recipe()),
    (lambda: squares(valley), squares_recipe(starts=6)),
    (led, squares_recipe(starts=8)),
]


@pytest.mark.parametrize(("build", "search"), BY_THREADS)
def test_threads_do_not_change_a_fit_and_its_progress_grows_to_the_whole(build, search):
    done = []
    whole = minimize(build(), search, rng(), Callbacks(step=lambda part, of: done.append(part / of)))
    assert done == sorted(done) and done[0] > 0 and done[-1] == 1
    assert minimize(build(), search, rng(), Callbacks(jobs=3)) == whole


# ---- a sum of distances, whose least value lies on kinks


def test_distances_that_are_0_are_reached_in_few_steps():
    # the weighted median of places e^x: 7.0, the third of five, beyond which weigh 2 of 5
    places, weights = np.array([1.0, 3.0, 7.0, 20.0, 90.0]), np.array([1.0, 1.0, 1.0, 1.5, 0.5])

    def distances(theta):
        off = np.stack([np.exp(theta[0]) - places, 0 * places], axis=1)
        slopes = np.stack([np.full(5, np.exp(theta[0])), 0 * places], axis=1)[..., None]
        return WeightedDistances(weights, off, slopes)

    for start, upper, budget, end, reason in (
        (-4.0, 9.0, 15, 7.0, "tolerance"),
        (8.5, 9.0, 15, 7.0, "tolerance"),
        (-4.0, 1.5, 15, np.exp(1.5), "tolerance"),  # its bound
        (-4.0, 9.0, 1, np.exp(-4.0), "budget"),
    ):
        box = np.full(1, -5.0), np.full(1, upper)
        known = ObjectiveFunction(*box, lambda theta: distances(theta).total, distances=distances)
        recorder = EvaluationRecorder(known, budget, never_stop)
        assert recorder.run(run_gauss_newton, np.array([start])) == reason
        assert np.exp(recorder.theta[0]) == approx(end, abs=1e-3)
