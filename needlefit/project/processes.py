"""Work on several items at once, each in a process of its own, which can be stopped between items.

The standard library pickles what travels between the processes. It travels through pipes between processes of
this program, into which nobody else can write; no file is ever unpickled.

This module imports nothing heavy, so that a new process can be told of its one thread before numpy comes in.
"""

import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from typing import TypeVar

from needlefit.errors import ConfigError
from needlefit.project.progress import Stop, never_stop
from needlefit.project.threads import limit_to_one_thread

Item = TypeVar("Item")
Result = TypeVar("Result")


def run_in_processes(
    work: Callable[[Item], Result], items: Sequence[Item], jobs: int, stop: Stop = never_stop
) -> Iterator[tuple[int, Result]]:
    """Yield the number of each item and what `work` makes of it, as they are finished.

    Parameters
    ----------
    work : callable
        A function of a module: it, the items and what it returns travel between processes. Where it raises,
        nothing more is begun.
    jobs : int
        Processes at once; with 1 everything is done in this one.
    stop : callable
        Where it says so, no further item is begun; those under way are finished.

    Raises
    ------
    ConfigError
        If the system ended a process, as it does when memory runs out.
    """
    if min(jobs, len(items)) <= 1:
        for n, item in enumerate(items):
            if stop():
                return
            yield n, work(item)
        return
    # a fork would copy threads that hold locks
    with ProcessPoolExecutor(min(jobs, len(items)), get_context("spawn"), initializer=_limit_worker) as pool:
        waiting = list(range(len(items)))[::-1]
        running: dict[Future[Result], int] = {}
        while True:
            while waiting and len(running) < jobs and not stop():
                n = waiting.pop()
                running[pool.submit(work, items[n])] = n
            if not running:
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                yield running.pop(future), _result(future)


def run_in_order(work: Callable[[Item], Result], items: Sequence[Item], jobs: int) -> Iterator[Result]:
    """Yield what `work` makes of each item, in their order; else as `run_in_processes`."""
    finished: dict[int, Result] = {}
    due = 0
    for n, result in run_in_processes(work, items, jobs):
        finished[n] = result
        while due in finished:
            yield finished.pop(due)
            due += 1


def _result(future: "Future[Result]") -> Result:
    try:
        return future.result()
    except BrokenProcessPool:
        raise ConfigError(
            "one of the processes was ended from outside, or could not begin",
            expected="memory for as many at once as --jobs states",
            fix="use fewer with --jobs",
        ) from None


def _limit_worker() -> None:
    """Keep this process to one thread, and leave Ctrl-C to the one that started it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    limit_to_one_thread()
