"""Tasks on the workers of a Dask cluster: real schedulers and workers, each a process of this machine."""

import logging
import os
import signal
import threading
import time
from functools import partial

import pytest

from needlefit.errors import ConfigError
from needlefit.project import cluster
from needlefit.project.cluster import connect, require_secured
from needlefit.project.tasks import LocalPool, run_in_order
from tests.cluster_processes import start_scheduler, start_worker
from tests.cluster_work import fail, kill_once, nap, square

dask = pytest.importorskip("dask")
Security = pytest.importorskip("distributed.security").Security

LOOPBACK = "tcp://127.0.0.1"


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    with (
        start_scheduler(tmp_path_factory.mktemp("scheduler")) as (address, _),
        start_worker(address),
        start_worker(address),
    ):
        yield address


def test_results_are_those_of_this_machine_in_order(address):
    work, items = partial(square, offset=0.1), [3.0, 1.0, 2.0, 1.0]
    with connect(address) as pool:
        assert list(run_in_order(work, items, pool)) == list(run_in_order(work, items, LocalPool()))


@pytest.mark.sweep
def test_the_error_of_a_task_reaches_the_caller(address):
    with connect(address) as pool, pytest.raises(ConfigError, match="of task 2") as caught:
        list(pool.run(fail, [2]))
    assert caught.value.where == "here"


def test_a_worker_that_dies_costs_its_task_alone(address, tmp_path):
    work = partial(kill_once, folder=str(tmp_path))
    with connect(address) as pool:
        assert list(run_in_order(work, list(range(6)), pool)) == list(range(6))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["killed"]


@pytest.mark.sweep
def test_the_log_of_dask_is_silent_while_a_scheduler_is_connected(address):
    """It prints a traceback where a connection is lost; what is wrong is our error."""
    log, handler = logging.getLogger("distributed"), logging.StreamHandler()
    log.addHandler(handler)
    try:
        with connect(address):
            assert handler.level == logging.CRITICAL
        assert handler.level == logging.NOTSET
    finally:
        log.removeHandler(handler)


@pytest.mark.sweep
def test_a_stop_drops_what_runs(address):
    asked = []

    def stop():
        asked.append(None)
        return len(asked) > 3

    begin = time.monotonic()
    with connect(address) as pool:
        assert list(pool.run(nap, [2.0] * 4, stop)) == []
    assert time.monotonic() - begin < 2


@pytest.mark.sweep
def test_a_worker_of_other_versions_is_refused(address, monkeypatch):
    monkeypatch.setattr(cluster, "describe_code", lambda: {"numpy": "0.1"})
    with connect(address) as pool, pytest.raises(ConfigError, match=r"numpy .* instead of"):
        list(pool.run(square, [1.0]))


@pytest.mark.sweep
@pytest.mark.parametrize(("seconds", "running"), [(0.5, False), (30.0, True)])
def test_a_lost_scheduler_is_an_error_that_names_resume(tmp_path, seconds, running):
    with start_scheduler(tmp_path) as (address, server), start_worker(address), connect(address) as pool:
        pool.client.wait_for_workers(1)
        results = pool.run(nap, [seconds] * 8)
        if not running:
            assert next(results)[1] == seconds
        killer = threading.Timer(running, os.killpg, (server.pid, signal.SIGKILL))
        killer.start()
        with pytest.raises(ConfigError) as caught:
            list(results)
        killer.join()
    assert "--resume" in caught.value.fix


@pytest.mark.sweep
def test_the_workers_are_counted_at_most_once_a_second_and_all_of_them(address):
    with connect(address) as pool:
        pool.client.wait_for_workers(2, timeout=30)  # one may have been killed, and begins again
        counted, find = [], pool.client.nthreads
        pool.client.nthreads = lambda: counted.append(time.monotonic()) or find()
        begin = time.monotonic()
        assert list(run_in_order(square, list(range(60)), pool)) == [n**2 for n in range(60)]
        assert 1 <= len(counted) <= 2 + (time.monotonic() - begin)


@pytest.mark.sweep
def test_work_without_workers_waits_with_one_note(tmp_path):
    notes = []
    with start_scheduler(tmp_path) as (address, _), connect(address, note=notes.append) as pool:
        assert list(pool.run(square, [1.0], lambda: bool(notes))) == []
    assert len(notes) == 1


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("address", "secured"),
    [
        ("tls://cluster:8786", True),
        ("tcp://127.0.0.1:8786", True),
        ("tcp://localhost:8786", True),
        ("tcp://[::1]:8786", True),
        ("tcp://10.0.0.1:8786", False),
        ("tcp://cluster:8786", False),
        ("cluster:8786", False),
        ("http://127.0.0.1:8786", False),
        ("tls://cluster", False),
        ("tls://cluster:port", False),
        ("tls://[", False),
    ],
)
def test_an_address_is_secured(address, secured):
    if secured:
        require_secured(address)
    else:
        with pytest.raises(ConfigError) as caught:
            require_secured(address)
        assert caught.value.where == f"--scheduler {address}"
    if address.startswith("tcp://"):
        require_secured(address, insecure=True)


@pytest.mark.sweep
def test_an_encrypted_scheduler_works_for_who_has_the_certificates(tmp_path, monkeypatch):
    keys = Security.temporary().get_tls_config_for_role("client")
    files = {}
    for name, option in (("ca_file", "ca-file"), ("cert", "cert"), ("key", "key")):
        files[option] = tmp_path / f"{name}.pem"
        files[option].write_text(keys[name])
    options = [word for option, file in files.items() for word in (f"--tls-{option}", str(file))]
    parts = {"ca-file": "ca-file", "client.cert": "cert", "client.key": "key"}
    tls = {f"distributed.comm.tls.{key}": str(files[name]) for key, name in parts.items()}
    monkeypatch.setattr(cluster, "CONNECT_S", 5.0)
    with (
        start_scheduler(tmp_path, "--protocol", "tls", *options) as (address, _),
        start_worker(address, *options),
    ):
        assert address.startswith("tls://")
        with dask.config.set(tls), connect(address) as pool:
            assert list(pool.run(square, [3.0])) == [(0, 9.0)]
        with pytest.raises(ConfigError, match="no scheduler answers"), connect(address):
            pass


@pytest.mark.sweep
def test_no_scheduler_answers(monkeypatch):
    monkeypatch.setattr(cluster, "CONNECT_S", 0.5)
    with pytest.raises(ConfigError, match="no scheduler answers"), connect(f"{LOOPBACK}:9"):
        pass
