"""Tasks in processes, copied or begun anew, and on a cluster: the same bytes everywhere."""

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path

import pandas as pd
import pytest
from distributed.client import Future
from distributed.utils import LoopRunner
from made_again import read_files
from refusals import refusal
from test_cli import run
from world import SHORT, copy_project

from needlefit.errors import ConfigError, UnfinishedWorkError
from needlefit.project import cluster, copies, locate, tasks
from needlefit.project.cluster import connect_cluster, require_secured
from needlefit.project.copies import compute_beside, compute_in_copies
from needlefit.project.locate import find_file, shipped_folder
from needlefit.project.processes import THREAD_VARIABLES
from needlefit.project.tasks import LocalPool
from tests.cluster_processes import start_scheduler, start_worker
from tests.cluster_work import fail, kill_once, nap, square, wait_for_stop

on_linux = pytest.mark.skipif(sys.platform != "linux", reason="processes are copied on Linux only")
COPIES = """
import os, signal, sys, threading, time
from needlefit.errors import ConfigError
from needlefit.project import copies, tasks

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
    tasks.count_cores = lambda: 2
    pool = tasks.LocalPool(2)
    for expected in ("before", "since"):
        loaded = expected
        found = [one for _, one in sorted(pool.run(tell, [1, 2, 3, 4]))]
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
        with copies.compute_beside([lambda: time.sleep(60)] * 2):
            time.sleep(60)
"""
"""A program whose tasks know what was loaded before them."""


@pytest.fixture(params=[False, pytest.param(True, marks=on_linux)], ids=["spawned", "copied"])
def processes(request, monkeypatch):
    for module in (tasks, copies):
        monkeypatch.setattr(module, "can_fork", lambda: request.param)


@on_linux
@pytest.mark.sweep
@pytest.mark.parametrize(("where", "expected"), [("pool", 2), ("beside", 1)])
def test_copies_have_what_is_loaded_and_end_with_each_run_and_with_a_killed_process(
    tmp_path, where, expected
):
    (tmp_path / "copies.py").write_text(COPIES)
    command = (sys.executable, "copies.py", where)
    deadline = time.monotonic() + 50
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
def test_a_stop_and_an_error_end_the_processes(processes):
    pool, begun = LocalPool(2), time.monotonic()
    assert list(pool.run(wait_for_stop, [60.0, 60.0], lambda: time.monotonic() > begun + 0.5)) == []
    with pytest.raises(ConfigError, match="of task 1"):
        list(pool.run(fail, [1, 1]))
    with pytest.raises(UnfinishedWorkError):  # what other processes have kept stays
        list(pool.run(os._exit, [1, 1]))
    asked = iter([False])  # after the first question a signal came, to all of them
    assert list(pool.run(os._exit, [1, 1], lambda: next(asked, True))) == []
    assert run_in_order(square, [1.0, 2.0, 3.0], pool) == [1.0, 4.0, 9.0]
    assert time.monotonic() < begun + 60


# --- work beside this process ---------------------------------------------------------------------------


def compute(work):
    with compute_beside(work) as end:
        return end()


def tell_process(number):
    return f"{number} {os.getpid()}".encode()


def run_in_order(work, items, pool):
    return [result for _, result in sorted(pool.run(work, items))]


def test_results_come_in_order():
    found = compute([lambda n=n: tell_process(n) for n in range(40)])
    assert [int(one.split()[0]) for one in found] == list(range(40))


@pytest.mark.parametrize("cores", [1, 2])
@pytest.mark.parametrize("jobs", [1, 3])
def test_items_shared_with_copies_come_back_in_order(monkeypatch, cores, jobs):
    monkeypatch.setattr(tasks, "count_cores", lambda: cores)
    steps = list[tuple[int, int]]()
    assert compute_in_copies(square, [3, 1, 2], jobs, lambda *step: steps.append(step)) == [9, 1, 4]
    assert steps == sorted(steps) and steps[-1] == (3, 3)
    assert compute_in_copies(square, [], jobs, lambda *step: steps.append(step)) == []
    assert steps[-1] == (3, 3)


def test_what_killed_copies_have_begun_is_done_here(monkeypatch):
    here = os.getpid()
    monkeypatch.setattr(tasks, "count_cores", lambda: 3)

    def work(number):
        if number == 0 and os.getpid() != here:
            os.kill(os.getpid(), signal.SIGKILL)
        time.sleep(0.1)
        return number

    assert compute_in_copies(work, range(6), 3) == [*range(6)]


def test_what_a_copy_cannot_do_is_done_here_and_errors_are_raised():
    here = os.getpid()

    def fail_in_copy():
        if os.getpid() != here:
            raise ValueError
        return tell_process(0)

    assert compute([fail_in_copy] * 9) == [tell_process(0)] * 9
    with pytest.raises(ZeroDivisionError):
        compute([lambda: bytes(1 // 0)] * 3)


@on_linux
def test_a_process_with_threads_is_not_copied():
    ended = threading.Event()
    other = threading.Thread(target=ended.wait)
    other.start()
    try:
        found = compute([lambda: tell_process(0)] * 9)
    finally:
        ended.set()
        other.join()
    assert found == [tell_process(0)] * 9


# --- one thread for linear algebra ----------------------------------------------------------------------

COMMAND = """
import sys
from needlefit.cli import main
try:
    main(["--version"])
except SystemExit:
    pass
assert "numpy" not in sys.modules
import scipy.linalg
from threadpoolctl import threadpool_info
print(*[found["num_threads"] for found in threadpool_info() if found["user_api"] == "blas"])
"""


def test_the_command_line_has_one_thread_whatever_the_environment():
    environment = {**os.environ, **dict.fromkeys(THREAD_VARIABLES, "2")}
    done = subprocess.run(
        [sys.executable, "-c", COMMAND], env=environment, capture_output=True, text=True, check=True
    )
    _, found = done.stdout.splitlines()
    assert set(found.split()) == {"1"}


LOOPBACK = "tcp://127.0.0.1"


@pytest.fixture(scope="module", autouse=True)
def end_threads_of_dask():
    """They outlive its clients, and a process that has further threads is not copied."""
    yield
    for _, runner in [*LoopRunner._all_loops.values()]:
        runner.stop()
    if executor := Future._cb_executor:
        executor.shutdown()
        Future._cb_executor = None


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    with (
        start_scheduler(tmp_path_factory.mktemp("scheduler")) as (address, _),
        start_worker(address),
        start_worker(address),
    ):
        yield address


def test_a_worker_that_dies_costs_its_task_alone(address, tmp_path):
    work = partial(kill_once, folder=str(tmp_path))
    with connect_cluster(address) as pool:
        assert run_in_order(work, list(range(6)), pool) == list(range(6))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["killed"]


@pytest.mark.sweep
def test_scans_reconstructed_on_workers_are_those_of_this_machine(address, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scan = shipped_folder() / "data/sample_scan/volumes/sample.nrrd"
    for name in ("a.nrrd", "b.nrrd"):
        shutil.copyfile(scan, name)
    for out, where in (("here/scans", ()), ("there/scans", ("--scheduler", address))):
        volumes = (str(tmp_path / name) for name in ("a.nrrd", "b.nrrd"))  # workers start elsewhere
        assert run("reconstruct", *volumes, *where, "--out", out, "-q") == 0
    assert read_files(Path("here/scans")) == read_files(Path("there/scans"))


def test_a_cohort_fitted_on_workers_is_that_of_this_machine(address, world, tmp_path):
    """Of three datasets one is broken."""
    for name in ("a", "b"):
        shutil.copytree(world.folder / "data/needles", tmp_path / name)
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken/dataset.toml").write_text("schema = 1\n")
    words = [sys.executable, str(shipped_folder() / "studies/cohort.py"), "configs/media/gel.toml"]
    words += [*map(str, sorted(tmp_path.glob("*"))), "--recipe", "configs/recipes/tiny.toml", "--out"]
    found = {}
    for name, where in (("here", "--jobs=1"), ("there", f"--scheduler={address}")):
        out = tmp_path / f"{name}.png"
        done = subprocess.run(
            [*words, str(out), where], cwd=world.folder, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0 and out.stat().st_size > 5_000, done.stderr
        rows = pd.read_csv(out.with_suffix(".csv"))
        found[name] = rows.sort_values(["dataset", "specimen", "parameter"], ignore_index=True)
    pd.testing.assert_frame_equal(found["here"], found["there"])
    fits, failed = (found["here"][found["here"]["parameter"].isna() == lost] for lost in (False, True))
    assert [Path(name).name for name in failed["dataset"]] == ["broken"]
    counts = fits.groupby("specimen")["insertions"].unique().map(list)
    assert counts.to_dict() == {"piece1": [2], "piece2": [1]}
    assert (fits["interval_low"] < fits["value"]).all() and (fits["value"] < fits["interval_high"]).all()


def test_folds_on_workers_give_the_files_of_this_machine(address, world, tmp_path, monkeypatch):
    """Of two studies at once; workers start in another folder."""
    monkeypatch.chdir(copy_project(world, tmp_path))
    study = (tmp_path / "studies/held_out.toml").read_text(encoding="utf-8")
    folds = study.partition("tune = ")[0] + 'leave_out = "specimen"\n'
    (tmp_path / "studies/folds.toml").write_text(folds, encoding="utf-8")
    monkeypatch.setattr(
        locate, "find_studies", lambda name: {n: find_file("study", n) for n in name.split(",")}
    )
    for out, where in (("here", ("--jobs", "2")), ("there", ("--scheduler", address))):
        assert run("validate", "folds,held_out", *where, "--out", out, "-q") in SHORT
    assert read_files(Path("here")) == read_files(Path("there"))


@pytest.mark.sweep
def test_a_worker_of_other_versions_is_refused(address, monkeypatch):
    monkeypatch.setattr(cluster, "describe_code", lambda: {"numpy": "0.1"})
    with connect_cluster(address) as pool, pytest.raises(ConfigError, match=r"numpy .* instead of"):
        list(pool.run(square, [1.0]))


@pytest.mark.sweep
@pytest.mark.parametrize(("seconds", "running"), [(0.5, False), (30.0, True)])
def test_a_lost_scheduler_is_an_error_that_names_resume(tmp_path, seconds, running):
    with (
        start_scheduler(tmp_path) as (address, server),
        start_worker(address),
        connect_cluster(address) as pool,
    ):
        pool.client.wait_for_workers(1)
        results = pool.run(nap, [seconds] * 8)
        if not running:
            assert next(results)[1] == seconds
        killer = threading.Timer(running, os.killpg, (server.pid, signal.SIGKILL))
        killer.start()
        caught = refusal(ConfigError, "", list, results)
        killer.join()
    assert "--resume" in caught.fix


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("address", "secured"),
    [
        *((one, True) for one in ("tls://cluster:8786", "tcp://localhost:8786", "tcp://[::1]:8786")),
        *((one, False) for one in ("tcp://10.0.0.1:8786", "cluster:8786")),
    ],
)
def test_an_address_is_secured(address, secured):
    if secured:
        require_secured(address)
    else:
        caught = refusal(ConfigError, "", require_secured, address)
        assert caught.where == f"--scheduler {address}"
    if address.startswith("tcp://"):
        require_secured(address, insecure=True)


@pytest.mark.sweep
def test_no_scheduler_answers(monkeypatch):
    monkeypatch.setattr(cluster, "CONNECT_S", 0.5)
    with pytest.raises(ConfigError, match="no scheduler answers"), connect_cluster(f"{LOOPBACK}:9"):
        pass
