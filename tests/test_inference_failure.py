"""What could not be solved is counted, its first points are kept, and they fail again for the same reason."""

import json
import math

import numpy as np
import pytest
from inference_cases import TRUTH, box, insertion, measure, medium, problem, recipe, two_layers

from needlefit.errors import ModelError
from needlefit.inference.fit import Callbacks, start_from_dict, start_to_dict
from needlefit.inference.objective import MAX_FAILED_POINTS
from needlefit.inference.optimize import minimize
from needlefit.inference.problem import EvaluationFailure, explain_failure
from needlefit.inference.sampling.posterior import load, save
from needlefit.inference.sampling.sample import sample
from needlefit.schemas.recipe import SampleRecord


def rng():
    return np.random.default_rng(5)


def half(theta):
    """A bowl; no number, or an error, left of 0."""
    if theta[0] < -1:
        raise ModelError("the needle is too short", expected="a longer one")
    return math.nan if theta[0] < 0 else float(np.sum((theta - 0.3) ** 2))


def violent():
    """Two insertions and bevels of 1 to 500 mm a millimetre: half of them press the tissue flat."""
    record = medium(bevel_mm={"bounds": [1.0, 500.0]}, mu1_pa={"fixed": 3e5})
    made = [measure(TRUTH, record, one) for one in (insertion(6.0), insertion(24.0, (12.0,), (1, 2)))]
    return problem(record, made)


def test_the_first_failures_of_a_start_are_kept_and_all_are_counted():
    asked = []

    def noted(theta):
        asked.append(tuple(theta.tolist()))
        return half(theta)

    start = minimize(box(noted), recipe(algorithm="crs2", starts=1, evaluations=200), rng()).starts[0]
    lost = [theta for theta in asked if theta[0] < 0]
    assert start.failures == len(lost) > MAX_FAILED_POINTS
    assert start.failed == tuple(lost[:MAX_FAILED_POINTS])


@pytest.mark.parametrize("jobs", [1, 2])
def test_failures_survive_a_checkpoint_to_the_last_bit(jobs):
    search = recipe(algorithm="neldermead", evaluations=60)
    whole = minimize(box(half), search, rng())
    assert whole.failures > 0
    finished = {s.index: start_from_dict(json.loads(json.dumps(start_to_dict(s)))) for s in whole.starts[:2]}
    assert finished == {s.index: s for s in whole.starts[:2]}
    assert minimize(box(half), search, rng(), Callbacks(finished=finished, jobs=jobs)) == whole


def test_recorded_points_fail_again_and_say_where_and_why():
    p = violent()
    fit = minimize(p, recipe(evaluations=60), rng())
    recorded = [theta for start in fit.starts for theta in start.failed]
    assert 0 < len(recorded) <= fit.failures
    for theta in recorded:
        found = explain_failure(p, theta)
        assert p.objective(np.array(theta)) == math.inf and math.isnan(p.log_posterior(theta))
        at = [i.id for i in p.insertions].index(found.insertion)
        assert found.reason == p.shapes(theta)[at].status != "converged"
        assert all(shape.converged for shape in p.shapes(theta)[:at])


@pytest.mark.parametrize(("bevel", "named"), [(36.0, "at24"), (60.0, "at6")])
def test_the_insertion_named_is_the_first_without_a_solution(bevel, named):
    p = violent()
    alone = [problem(p.medium, [i]).objective(np.log([2e7, bevel])) for i in p.insertions]
    assert [math.isinf(value) for value in alone] == [named == "at6", True]
    assert explain_failure(p, np.log([2e7, bevel])) == EvaluationFailure(named, "over-compressed")


def test_what_is_said_of_a_model_error_and_what_is_no_failure():
    record = medium(1, guide_distance_mm={"bounds": [2.0, 140.0]}, mu1_pa={"fixed": 3e5})
    p = problem(record, [measure({**TRUTH, "guide_distance_mm": 15.0}, record, insertion(55.0))])
    found = explain_failure(p, p.parameters.theta({**TRUTH, "guide_distance_mm": 120.0}))
    assert found.insertion == "at55"
    assert found.reason.startswith("ModelError: ") and "\n" not in found.reason
    p = two_layers(count=1)
    assert explain_failure(p, p.parameters.theta(TRUTH)) == EvaluationFailure("", "value not finite")
    got = sample(
        box(lambda theta: -math.inf if theta[0] < 0 else 0.0),
        (0.1, 0.1),
        SampleRecord(ensembles=1, walkers=8, steps=30),
        rng(),
    )
    assert (got.failures, got.failed) == (0, ((),))


def test_the_sampler_counts_failed_solves_and_keeps_the_first_of_each_ensemble(tmp_path):
    p = violent()
    settings = SampleRecord(ensembles=2, walkers=8, steps=60, moves="stretch")  # steps far out
    got = sample(p, np.log([2e7, 30.0]), settings, rng())
    assert got.failures >= sum(len(thetas) for thetas in got.failed) > 0
    assert len(got.failed) == 2 and max(len(thetas) for thetas in got.failed) <= MAX_FAILED_POINTS
    for theta in (theta for ensemble in got.failed for theta in ensemble):
        assert explain_failure(p, theta).reason == "over-compressed"
    assert np.all(np.isfinite(got.log_posterior))
    save(got, tmp_path / "posterior.nc")
    assert load(tmp_path / "posterior.nc").failed == got.failed
