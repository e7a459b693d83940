"""Work that is shared with a copy of the process: its results, in order, and its errors."""

import os
import sys
import threading

import pytest

from needlefit.project import forked


def tell_process(number: int) -> bytes:
    return f"{number} {os.getpid()}".encode()


def test_results_come_in_order(monkeypatch):
    monkeypatch.setattr(forked, "count_cores", lambda: 2)
    found = forked.compute_in_two_processes([lambda n=n: tell_process(n) for n in range(40)])
    assert [int(one.split()[0]) for one in found] == list(range(40))


def test_what_a_copy_cannot_do_is_done_here(monkeypatch):
    monkeypatch.setattr(forked, "count_cores", lambda: 2)
    here = os.getpid()

    def fail_in_copy() -> bytes:
        if os.getpid() != here:
            raise ValueError
        return tell_process(0)

    assert forked.compute_in_two_processes([fail_in_copy] * 9) == [tell_process(0)] * 9


def test_errors_are_raised():
    def fail() -> bytes:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        forked.compute_in_two_processes([fail] * 3)


@pytest.mark.skipif(sys.platform != "linux", reason="processes are copied on Linux only")
def test_a_process_with_threads_is_not_copied():
    ended = threading.Event()
    other = threading.Thread(target=ended.wait)
    other.start()
    try:
        found = forked.compute_in_two_processes([lambda: tell_process(0)] * 9)
    finally:
        ended.set()
        other.join()
    assert found == [tell_process(0)] * 9
