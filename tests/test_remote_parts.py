"""Parts of one fit on a remote pool, here copies of this process: they give the same bytes as without."""

import sys

import numpy as np
import pytest
from inference_cases import squares_recipe, two_layers

from needlefit.inference.fit import Callbacks
from needlefit.inference.identifiability.identify import profile_parameters
from needlefit.inference.optimize import minimize
from needlefit.inference.sampling.importance import trace_profiles
from needlefit.project import tasks
from needlefit.project.random_streams import random_stream
from needlefit.project.tasks import THIS_PROCESS, LocalPool

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are copied on Linux only")
POOLS = THIS_PROCESS, LocalPool(2, remote=True)


@pytest.fixture(autouse=True)
def copied(monkeypatch):
    monkeypatch.setattr(tasks, "can_fork", lambda: True)
    monkeypatch.setattr(tasks, "MIN_SHARED_S", 0.0)


@pytest.fixture(scope="module")
def problem():
    return two_layers(count=2)


@pytest.fixture(scope="module")
def fit(problem):
    return minimize(problem, squares_recipe(starts=2), random_stream(1, "starts"))


@pytest.mark.parametrize("changed", [{}, {"minimize": "metric", "algorithm": "slsqp"}])
def test_a_search(problem, changed):
    search = squares_recipe(starts=4, evaluations=60, **changed)
    fits = [
        minimize(problem, search, random_stream(1, "starts"), Callbacks(pool=where, jobs=2))
        for where in POOLS
    ]
    assert fits[0] == fits[1]


def test_profiles_of_parameters(problem, fit):
    found = [profile_parameters(problem, fit, pool=where) for where in POOLS]
    assert len(found[0].parameters) >= 3 and repr(found[0]) == repr(found[1])


def test_profiles_along_which_draws_begin(problem, fit):
    alone, copied = (trace_profiles(problem, np.array(fit.theta), 2, where) for where in POOLS)
    assert len(alone) > 3
    assert [one.theta.tobytes() for one in alone] == [one.theta.tobytes() for one in copied]
    assert [one.information.tobytes() for one in alone] == [one.information.tobytes() for one in copied]
