"""Work that is shared with a copy of the process: its results, in order, and its errors."""

import os
import sys
import threading
import time
from collections.abc import Callable

import pytest

from needlefit.project import forked


def compute(work: list[Callable[[], bytes]]) -> list[bytes]:
    with forked.compute_beside(work) as end:
        return end()


def tell_process(number: int) -> bytes:
    return f"{number} {os.getpid()}".encode()


def test_results_come_in_order(monkeypatch):
    monkeypatch.setattr(forked, "count_cores", lambda: 2)
    found = compute([lambda n=n: tell_process(n) for n in range(40)])
    assert [int(one.split()[0]) for one in found] == list(range(40))


def test_what_a_copy_cannot_do_is_done_here(monkeypatch):
    monkeypatch.setattr(forked, "count_cores", lambda: 2)
    here = os.getpid()

    def fail_in_copy() -> bytes:
        if os.getpid() != here:
            raise ValueError
        return tell_process(0)

    assert compute([fail_in_copy] * 9) == [tell_process(0)] * 9


def test_errors_are_raised():
    def fail() -> bytes:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        compute([fail] * 3)


@pytest.mark.skipif(sys.platform != "linux", reason="processes are copied on Linux only")
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


@pytest.mark.skipif(sys.platform != "linux", reason="processes are copied on Linux only")
def test_the_copy_works_while_this_process_does_other_things(monkeypatch, tmp_path):
    monkeypatch.setattr(forked, "count_cores", lambda: 2)

    def work() -> bytes:
        (tmp_path / "begun").touch()
        return tell_process(0)

    with forked.compute_beside([work] * 2) as end:
        until = time.monotonic() + 30.0
        while not (tmp_path / "begun").exists() and time.monotonic() < until:
            time.sleep(0.01)
        found = end()
    assert tell_process(0) not in found[:1]


@pytest.mark.skipif(sys.platform != "linux", reason="processes are copied on Linux only")
def test_after_an_error_the_copy_ends(monkeypatch, tmp_path):
    monkeypatch.setattr(forked, "count_cores", lambda: 2)
    with pytest.raises(ZeroDivisionError), forked.compute_beside([lambda: tell_process(0)] * 9):
        raise ZeroDivisionError
    with pytest.raises(ChildProcessError):
        os.waitpid(-1, os.WNOHANG)


@pytest.mark.skipif(sys.platform != "linux", reason="processes are copied on Linux only")
def test_without_room_for_a_copy_all_is_done_here(monkeypatch):
    def refuse() -> int:
        raise BlockingIOError

    monkeypatch.setattr(forked, "count_cores", lambda: 2)
    monkeypatch.setattr(os, "fork", refuse)
    assert compute([lambda: tell_process(0)] * 9) == [tell_process(0)] * 9
