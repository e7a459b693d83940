"""Run the same work on many items: in this process, in several, or on the workers of a cluster.

A task is a function of a module and one item; its result depends on these alone, not on where it runs. A pool
runs tasks: `LocalPool` here, `project.cluster` on other machines. The standard library pickles what travels
between processes. It travels through pipes between processes of this program, or between the members of a
cluster that trust each other; no file is ever unpickled.

This module imports nothing heavy, so that a new process limits itself to one thread before it imports numpy.
"""

import os
import pickle
import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    as_completed,
    wait,
)
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from multiprocessing import get_context
from multiprocessing.synchronize import Event
from typing import Any, Protocol, Self, TypeVar

from needlefit.errors import ConfigError
from needlefit.project.forked import begin_copy, block_signals, can_fork
from needlefit.project.progress import Stop, never_stop
from needlefit.project.threads import limit_to_one_thread

Item = TypeVar("Item")
Result = TypeVar("Result")

STOP_POLL_S = 0.2
"""Seconds between two questions whether to stop, while tasks run elsewhere."""


MIN_SHARED_S = 8.0
"""Seconds of work that are worth sending to other machines."""


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
    """Processes of this machine; with one task or `size` 1 everything is done in this process.

    They end with each run, or, in a `with` statement, with that; forked ones always with the run.
    """

    size: int = 1
    remote: bool = False
    _kept: "list[_Processes]" = field(default_factory=list, repr=False, compare=False)

    def __enter__(self) -> Self:
        self._kept.append(_Processes(self.size))
        return self

    def __exit__(self, *_: object) -> None:
        self._kept.pop().close()

    def run(
        self, work: Callable[[Item], Result], items: Sequence[Item], stop: Stop = never_stop
    ) -> Iterator[tuple[int, Result]]:
        """Yield results as they are finished: see `TaskPool.run`."""
        count = min(self.size, len(items))
        if count > 1:
            # forked processes begin at once, and later ones have what was loaded since
            own = can_fork() or not self._kept
            processes = _Processes(count) if own else self._kept[-1]
            try:
                yield from processes.run(work, items, count, self.size // count, stop)
            finally:
                if own:
                    processes.close()
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


class TaskStop:
    """A request to stop that travels with a task, which then ends early with what it has.

    In another process it is that of the pool.
    """

    def __init__(self, stop: Stop) -> None:
        self._stop, self._left = stop, False

    def __call__(self) -> bool:
        """Whether to end."""
        return self._left or self._stop()

    def __reduce__(self) -> tuple[Callable[..., Stop], tuple[()]]:
        return _find_stop_of_task, ()

    def leave(self) -> None:
        """Request a stop."""
        self._left = True


def _find_stop_of_task() -> Stop:
    return _is_stop_set


def run_parts(
    work: Callable[[Item], Result],
    items: Sequence[Item],
    pool: TaskPool,
    threads: int,
    stop: TaskStop,
) -> Iterator[tuple[int, Result]]:
    """Yield results as `TaskPool.run` does, of parts that may be short.

    Of a remote pool the first one shows how long they take: if the others take long they go to the pool. Else
    they stay in this process, on so many threads. `stop` is requested in the end.
    """
    begun, left = time.perf_counter(), list(range(len(items)))
    try:
        if pool.remote and len(items) > 1 and not stop():
            yield left.pop(0), work(items[0])
            if (time.perf_counter() - begun) * len(left) > MIN_SHARED_S:
                for n, result in pool.run(work, [items[n] for n in left], stop):
                    yield left[n], result
                return
        if threads > 1:
            with ThreadPoolExecutor(threads) as side_by_side:
                futures = {side_by_side.submit(_unless_stopped, work, items[n], stop): n for n in left}
                yield from as_they_end(futures, stop)
            return
        for n in left:
            if stop():
                return
            yield n, work(items[n])
    finally:
        stop.leave()


def as_they_end(
    futures: Mapping[Future[tuple[Result, ...]], int], stop: TaskStop
) -> Iterator[tuple[int, Result]]:
    """Yield the number of each future and its result, if it has one; `stop` is requested in the end."""
    try:
        for future in as_completed(futures):
            for result in future.result():
                yield futures[future], result
    finally:
        stop.leave()  # before the threads are waited for


def _unless_stopped(work: Callable[[Item], Result], item: Item, stop: Stop) -> tuple[Result, ...]:
    """Return the result; nothing where a stop came before."""
    return () if stop() else (work(item),)


class _Surroundings:
    """What a task may know about the process that it runs in."""

    stop: Event | None = None
    stopped = False
    threads = 1


def stop_requested() -> bool:
    """Whether the task that asks shall end early; it then has no result."""
    _Surroundings.stopped = _Surroundings.stopped or _is_stop_set()
    return _Surroundings.stopped


def _is_stop_set() -> bool:
    return _Surroundings.stop is not None and _Surroundings.stop.is_set()


def threads_of_task() -> int:
    """Return how many threads a task may use in a process of a pool."""
    return _Surroundings.threads


class _Processes:
    """Processes that run tasks until they are closed; they are started when tasks need them."""

    def __init__(self, size: int) -> None:
        self._size = size

    def run(
        self, work: Callable[[Item], Result], items: Sequence[Item], count: int, threads: int, stop: Stop
    ) -> Iterator[tuple[int, Result]]:
        pool, event = self._pool
        data = pickle.dumps(work)
        waiting = list(range(len(items)))[::-1]
        running: dict[Future[tuple[Result, bool]], int] = {}
        try:
            while True:
                if stop():
                    event.set()
                while waiting and len(running) < count and not event.is_set():
                    n = waiting.pop()
                    running[pool.submit(_run_task, data, items[n], threads)] = n
                if not running:
                    return
                for future in wait(running, STOP_POLL_S, FIRST_COMPLETED).done:
                    n = running.pop(future)
                    result, whole = _result(future)
                    if whole:
                        yield n, result
        finally:
            if running:  # where a task failed, or nobody wants more: the others end early
                event.set()
                wait(running)
            event.clear()

    def close(self) -> None:
        """End the processes."""
        if "_pool" in self.__dict__:
            self._pool[0].shutdown()

    @cached_property
    def _pool(self) -> tuple[ProcessPoolExecutor, Event]:
        # a copy of this process has everything loaded, but would also copy locks that other threads hold
        copied = can_fork()
        context = get_context("fork" if copied else "spawn")
        event = context.Event()
        parent = os.getpid() if copied else None
        pool = ProcessPoolExecutor(self._size, context, _begin_process, (event, parent))
        if copied:
            with block_signals():
                pool.submit(int)  # the first task forks all processes
        return pool, event


def _run_task(data: bytes, item: object, threads: int) -> tuple[Any, bool]:
    """Return a result, and whether nothing made the task end early."""
    _Surroundings.stopped, _Surroundings.threads = False, threads
    result = _read_work(data)(item)
    return result, not _Surroundings.stopped


@lru_cache(maxsize=1)  # tasks of the same work share what it computes once
def _read_work(data: bytes) -> Callable[[object], object]:
    work: Callable[[object], object] = pickle.loads(data)  # noqa: S301  from the process that started this one
    return work


def _result(future: "Future[tuple[Result, bool]]") -> tuple[Result, bool]:
    try:
        return future.result()
    except BrokenProcessPool:
        raise ConfigError(
            "one of the processes was ended from outside, or could not begin",
            expected="processes that nobody ends, and memory for as many as --jobs states",
            fix="run it again, with fewer --jobs if memory was short",
        ) from None


def _begin_process(stop: Event, parent: int | None) -> None:
    """Keep linear algebra to one thread, and leave Ctrl-C to the process that started this one.

    `parent` is the process that this one is a copy of: it then has loaded its linear algebra already.
    """
    if parent is not None:
        from threadpoolctl import threadpool_limits

        begin_copy(parent)
        threadpool_limits(1, user_api="blas")
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    limit_to_one_thread()
    _Surroundings.stop = stop
