"""Work on several items at once, each in a process of its own, which can be stopped between items."""

import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from typing import TypeVar

from needlefit.errors import NeedlefitError

Item = TypeVar("Item")
Result = TypeVar("Result")


def never() -> bool:
    """Say that nobody wants to stop."""
    return False


def in_processes(
    work: Callable[[Item], Result], items: Sequence[Item], jobs: int, stop: Callable[[], bool] = never
) -> Iterator[tuple[int, Result]]:
    """Yield the number of each item and what `work` makes of it, as they are finished.

    Parameters
    ----------
    work : callable
        A function of a module: it, the items and what it returns travel between processes.
    jobs : int
        Processes at once; with 1 everything is done in this one.
    stop : callable
        Where it says so, no further item is begun; those under way are finished.

    Raises
    ------
    NeedlefitError
        If the system ended a process, as it does when memory runs out.
    """
    if jobs == 1 or len(items) < 2:
        for n, item in enumerate(items):
            if stop():
                return
            yield n, work(item)
        return
    # a fork would copy threads that hold locks
    with ProcessPoolExecutor(jobs, get_context("spawn"), _leave_signals_to_the_parent) as pool:
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


def _result(future: "Future[Result]") -> Result:
    try:
        return future.result()
    except BrokenProcessPool:
        raise NeedlefitError(
            "the system ended a process at work",
            expected="memory for as many at once as --jobs says",
            mend="run again with --jobs 1, and with --resume where the command has it",
        ) from None


def _leave_signals_to_the_parent() -> None:
    """Ignore Ctrl-C, which the terminal sends to every process: the parent decides when to stop."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
