"""Processes that stay, and the parts of one fit that go to a pool where they are long."""

import math
import os
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from inference_cases import squares_recipe, two_layers

from needlefit.errors import ConfigError
from needlefit.inference.fit import Callbacks, Start
from needlefit.inference.identifiability.identify import profile_parameters
from needlefit.inference.optimize import minimize
from needlefit.project import tasks
from needlefit.project.cluster import connect
from needlefit.project.progress import never_stop
from needlefit.project.random_streams import random_stream
from needlefit.project.tasks import THIS_PROCESS, LocalPool, TaskStop, run_in_order, run_parts
from tests.cluster_processes import start_scheduler, start_worker
from tests.cluster_work import fail, find_process, nap_until, square, wait_for_stop


@pytest.fixture(autouse=True)
def spawned(monkeypatch):
    """Processes that begin anew, as where this process has threads."""
    monkeypatch.setattr(tasks, "can_fork", lambda: False)


@pytest.fixture(scope="module")
def pool():
    with LocalPool(2) as kept:
        yield kept


COPIES = """
import os, signal, sys, threading, time
from needlefit.errors import ConfigError
from needlefit.project import forked, tasks

def tell(n):
    time.sleep(0.2)
    return n, os.getpid(), sys.modules["__main__"].loaded

def fail_or_die(n):
    if n == 0:
        raise ZeroDivisionError
    if n == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(60)

if __name__ == "__main__":
    loaded = "before"
    signal.signal(signal.SIGTERM, lambda *_: None)
    forked.count_cores = lambda: 2
    with tasks.LocalPool(2) as pool:
        for expected in ("before", "since"):
            loaded = expected
            found = list(tasks.run_in_order(tell, [1, 2, 3, 4], pool))
            assert [n for n, _, _ in found] == [1, 2, 3, 4] and {one for *_, one in found} == {expected}
            assert len({process for _, process, _ in found} - {os.getpid()}) == 2
            assert threading.active_count() == 1
        for items, error in (([0, 0], ZeroDivisionError), ([1, 2], ConfigError)):
            try:
                list(pool.run(fail_or_die, items))
            except error:
                continue
            raise AssertionError(items)
        print(os.getpid(), flush=True)
        if sys.argv[1:] == ["pool"]:
            list(pool.run(time.sleep, [60, 60]))
    if sys.argv[1:] == ["beside"]:
        with forked.compute_beside([lambda: time.sleep(60)] * 2):
            time.sleep(60)
"""
"""A program whose tasks know what was loaded before them."""


@pytest.fixture
def long(monkeypatch):
    monkeypatch.setattr(tasks, "MIN_SHARED_S", 0.0)


@pytest.fixture
def remote(pool):
    """The same processes, as if they were on another machine."""
    return replace(pool, remote=True)


@pytest.mark.sweep
def test_processes_stay_until_the_end_of_the_with_statement(pool):
    first, second = (set(run_in_order(find_process, [0.3] * 4, pool)) for _ in range(2))
    assert first == second and len(first) == 2 and os.getpid() not in first


@pytest.mark.sweep
@pytest.mark.skipif(sys.platform != "linux", reason="processes are copied on Linux only")
def test_copies_of_this_process_have_what_it_has_loaded_and_end_with_each_run(tmp_path):
    (tmp_path / "copies.py").write_text(COPIES)
    subprocess.run((sys.executable, "copies.py"), cwd=tmp_path, check=True, timeout=50)


@pytest.mark.sweep
@pytest.mark.skipif(sys.platform != "linux", reason="processes are copied on Linux only")
@pytest.mark.parametrize(("where", "expected"), [("pool", 2), ("beside", 1)])
def test_copies_end_with_a_killed_process(tmp_path, where, expected):
    (tmp_path / "copies.py").write_text(COPIES)
    command = (sys.executable, "copies.py", where)
    deadline = time.monotonic() + 30
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True) as running:
        assert running.stdout.readline()
        children = Path(f"/proc/{running.pid}/task/{running.pid}/children")
        while len(copies := children.read_text().split()) < expected and time.monotonic() < deadline:
            time.sleep(0.05)
        running.kill()
    while any(_is_running(one) for one in copies) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert len(copies) == expected and not any(_is_running(one) for one in copies)


def _is_running(process):
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.sweep
def test_processes_serve_again_after_a_stop_and_an_error(pool):
    begun = time.monotonic()
    assert list(pool.run(wait_for_stop, [60.0, 60.0], lambda: time.monotonic() > begun + 0.5)) == []
    with pytest.raises(ConfigError, match="of task 1"):
        list(pool.run(fail, [1, 1]))
    assert list(run_in_order(square, [1.0, 2.0, 3.0], pool)) == [1.0, 4.0, 9.0]
    assert time.monotonic() < begun + 60


def test_short_parts_stay_in_this_process(remote):
    found = dict(run_parts(find_process, [0.0] * 4, remote, 1, TaskStop(never_stop)))
    assert found == dict.fromkeys(range(4), os.getpid())


@pytest.mark.sweep
def test_long_parts_go_to_a_remote_pool_after_the_first(remote, long):
    found = dict(run_parts(find_process, [0.3] * 5, remote, 1, TaskStop(never_stop)))
    assert sorted(found) == [0, 1, 2, 3, 4] and found.pop(0) == os.getpid()
    assert os.getpid() not in found.values() and len(set(found.values())) == 2


@pytest.mark.sweep
@pytest.mark.parametrize(
    "changed", [{}, {"algorithm": "praxis"}, {"minimize": "metric", "algorithm": "slsqp"}]
)
def test_a_search_in_processes_has_the_same_bytes(remote, long, changed):
    problem, search = two_layers(count=2), squares_recipe(starts=5, evaluations=60, **changed)
    fits = [
        minimize(problem, search, random_stream(1, "starts"), Callbacks(pool=where))
        for where in (THIS_PROCESS, remote)
    ]
    assert fits[0] == fits[1]


@pytest.mark.sweep
def test_a_part_that_is_stopped_returns_what_it_has(pool):
    begun = time.monotonic()
    stop = TaskStop(lambda: time.monotonic() > begun + 0.5)
    found = list(pool.run(partial(nap_until, stop), [60.0, 60.0, 60.0], stop))
    assert len(found) == 2 and all(slept < 60 for _, slept in found)


def test_a_search_that_is_stopped_in_processes_keeps_its_best_point(remote, long):
    problem, search = two_layers(count=2), squares_recipe(starts=50, algorithm="praxis", evaluations=20_000)
    ended: list[Start] = []
    # once the first start has ended, the others are in the processes
    callbacks = Callbacks(report=ended.append, stop=lambda: bool(ended), pool=remote)
    part = minimize(problem, search, random_stream(1, "starts"), callbacks)
    assert part.interrupted and math.isfinite(part.objective)


@pytest.mark.sweep
def test_profiles_in_processes_have_the_same_bytes(remote, long):
    problem = two_layers(count=2)
    fit = minimize(problem, squares_recipe(starts=2), random_stream(1, "starts"))
    found = [profile_parameters(problem, fit, pool=where) for where in (THIS_PROCESS, remote)]
    assert len(found[0].parameters) >= 3 and repr(found[0]) == repr(found[1])


@pytest.mark.sweep
def test_a_search_on_a_cluster_has_the_same_bytes(tmp_path, long):
    pytest.importorskip("distributed")
    problem, search = two_layers(count=2), squares_recipe(starts=4, evaluations=60)
    run = partial(minimize, problem, search)
    with start_scheduler(tmp_path) as (address, _), start_worker(address), connect(address) as cluster:
        found = run(random_stream(1, "starts"), Callbacks(pool=cluster))
    assert found == run(random_stream(1, "starts"))
