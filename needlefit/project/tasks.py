"""Run the same work on many items: in this process, in several, or on the workers of a cluster.

A task is a function of a module and one item; its result depends on these alone, not on where it runs. A pool
runs tasks: `LocalPool` here, `project.cluster` on other machines. The standard library pickles what travels
between processes. It travels through pipes between processes of this program, or between the members of a
cluster that trust each other; no file is ever unpickled.

This module imports nothing heavy, so that a new process limits itself to one thread before it imports numpy.
"""

import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.synchronize import Event
from typing import Protocol, TypeVar

from needlefit.errors import ConfigError
from needlefit.project.progress import Stop, never_stop
from needlefit.project.threads import limit_to_one_thread

Item = TypeVar("Item")
Result = TypeVar("Result")

STOP_POLL_S = 0.2
"""Seconds between two questions whether to stop, while tasks run elsewhere."""


class TaskPool(Protocol):
    """Where tasks run."""

    @property
    def remote(self) -> bool:
        """Whether tasks run where this machine's files are not."""
        ...

    def run(
        self, work: Callable[[Item], Result], items: Sequence[Item], stop: Stop = never_stop
    ) -> Iterator[tuple[int, Result]]:
        """Yield the number of each item and what `work` makes of it, as they are finished.

        Parameters
        ----------
        work : callable
            A function of a module: it, the items and what it returns travel between processes. Where it
            raises, nothing more is begun.
        stop : callable
            Once it is true, no further item is begun; a task that asks `stop_requested` ends early and has no
            result.

        Raises
        ------
        ConfigError
            If the system ended a process, as it does when memory runs out.
        """
        ...


@dataclass(frozen=True)
class LocalPool:
    """Processes of this machine; with one task or `size` 1 everything is done in this process."""

    size: int = 1
    remote: bool = False

    def run(
        self, work: Callable[[Item], Result], items: Sequence[Item], stop: Stop = never_stop
    ) -> Iterator[tuple[int, Result]]:
        """Yield results as they are finished: see `TaskPool.run`."""
        count = min(self.size, len(items))
        if count > 1:
            yield from _run_in_processes(work, items, count, self.size // count, stop)
            return
        for n, item in enumerate(items):
            if stop():
                return
            yield n, work(item)


THIS_PROCESS = LocalPool()
"""One task at a time, in this process."""


def run_in_order(
    work: Callable[[Item], Result], items: Sequence[Item], pool: TaskPool, stop: Stop = never_stop
) -> Iterator[Result]:
    """Yield what `work` makes of each item, in their order; else as `TaskPool.run`."""
    finished: dict[int, Result] = {}
    due = 0
    for n, result in pool.run(work, items, stop):
        finished[n] = result
        while due in finished:
            yield finished.pop(due)
            due += 1


class _Surroundings:
    """What a task may know about the process that it runs in."""

    stop: Event | None = None
    stopped = False
    threads = 1


def stop_requested() -> bool:
    """Whether the task that asks shall end early; it then has no result."""
    event = _Surroundings.stop
    _Surroundings.stopped = _Surroundings.stopped or (event is not None and event.is_set())
    return _Surroundings.stopped


def threads_of_task() -> int:
    """Return how many threads a task may use in a process of a pool."""
    return _Surroundings.threads


def _run_in_processes(
    work: Callable[[Item], Result], items: Sequence[Item], count: int, threads: int, stop: Stop
) -> Iterator[tuple[int, Result]]:
    context = get_context("spawn")  # a fork would copy threads that hold locks
    event = context.Event()
    with ProcessPoolExecutor(count, context, _begin_process, (event, threads)) as pool:
        waiting = list(range(len(items)))[::-1]
        running: dict[Future[tuple[Result, bool]], int] = {}
        try:
            while True:
                if stop():
                    event.set()
                while waiting and len(running) < count and not event.is_set():
                    n = waiting.pop()
                    running[pool.submit(_run_task, work, items[n])] = n
                if not running:
                    return
                for future in wait(running, STOP_POLL_S, FIRST_COMPLETED).done:
                    n = running.pop(future)
                    result, whole = _result(future)
                    if whole:
                        yield n, result
        finally:
            event.set()  # where a task failed, or nobody wants more: the others end early


def _run_task(work: Callable[[Item], Result], item: Item) -> tuple[Result, bool]:
    """Return a result, and whether nothing made the task end early."""
    result = work(item)
    return result, not _Surroundings.stopped


def _result(future: "Future[tuple[Result, bool]]") -> tuple[Result, bool]:
    try:
        return future.result()
    except BrokenProcessPool:
        raise ConfigError(
            "one of the processes was ended from outside, or could not begin",
            expected="memory for as many at once as --jobs states",
            fix="use fewer with --jobs",
        ) from None


def _begin_process(stop: Event, threads: int) -> None:
    """Keep linear algebra to one thread, and leave Ctrl-C to the process that started this one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    limit_to_one_thread()
    _Surroundings.stop, _Surroundings.threads = stop, threads
