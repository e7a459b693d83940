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
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from multiprocessing import get_context
from multiprocessing.synchronize import Event
from queue import Empty, SimpleQueue
from typing import Any, Protocol, TypeVar

from needlefit.errors import UnfinishedWorkError
from needlefit.project.callbacks import Stop, never_stop
from needlefit.project.processes import count_cores, end_with, limit_to_one_thread

Item = TypeVar("Item")
Result = TypeVar("Result")

STOP_POLL_S = 0.2  # time (s) between two checks whether to stop, while tasks run elsewhere

_ENDING_SIGNALS = (
    {signal.SIGTERM, signal.SIGHUP, signal.SIGINT} if sys.platform == "linux" else set[signal.Signals]()
)


class TaskPool(Protocol):
    """Where tasks run."""

    def run(
        self, work: Callable[[Item], Result], items: Sequence[Item], stop: Stop = never_stop
    ) -> Iterator[tuple[int, Result]]:
        """Yield the number of each item and what `work` makes of it, as they are finished.

        `work` is a function of a module: it, the items and what it returns travel between processes. Where it
        raises, nothing more is begun. Once `stop` is true, no further item is begun; a task that asks
        `stop_requested` ends early and has no result. UnfinishedWorkError if the system ended a process, as
        it does when memory runs out.
        """
        ...


@dataclass(frozen=True)
class LocalPool:
    """Processes of this machine, new ones for each run; with one task or `size` 1 this process does all."""

    size: int = 1

    def run(
        self, work: Callable[[Item], Result], items: Sequence[Item], stop: Stop = never_stop
    ) -> Iterator[tuple[int, Result]]:
        """Yield results as they are finished: see `TaskPool.run`."""
        count = min(self.size, len(items))
        if count <= 1:
            for n, item in enumerate(items):
                if stop():
                    return
                yield n, work(item)
            return
        data = pickle.dumps(work)
        with open_processes(count) as (pool, event):

            def ask_to_stop() -> bool:
                if stop():
                    event.set()
                return event.is_set()

            def submit(n: int) -> "Future[tuple[Result, bool]]":
                return pool.submit(_run_task, data, items[n])

            try:
                for n, future in as_finished(submit, len(items), lambda: count, ask_to_stop):
                    result, whole = future.result()
                    if whole:
                        yield n, result
            except BrokenProcessPool:
                if ask_to_stop():  # a signal to all of them, as of `timeout` or a batch system
                    return
                raise UnfinishedWorkError(
                    "one of the processes was ended from outside, or could not begin",
                    expected="memory for as many as --jobs states",
                    fix="run it again, with fewer --jobs if memory was short",
                ) from None
            finally:  # where a task failed, or nobody wants more, the others end early
                event.set()


THIS_PROCESS = LocalPool()  # pool that runs one task at a time, in this process


def as_finished(
    submit: Callable[[int], Any],  # the number of a task -> its future
    count: int,
    wanted: Callable[[], int],  # returns how many tasks are submitted at once
    stop: Stop,  # once it is true, no further task is submitted
    drop: bool = False,  # whether those that run are not waited for then
) -> Iterator[tuple[int, Any]]:
    """Yield the number of each of `count` tasks and its future, once it is done."""
    waiting, running = list(range(count))[::-1], dict[Any, int]()
    finished: SimpleQueue[Any] = SimpleQueue()
    while waiting or running:
        if (stopped := stop()) and (drop or not running):
            return
        most = wanted()
        while waiting and len(running) < most and not stopped:
            n = waiting.pop()
            future = submit(n)
            running[future] = n
            future.add_done_callback(finished.put)  # a round costs the same however many run
        try:
            future = finished.get(timeout=STOP_POLL_S)
        except Empty:
            continue
        yield running.pop(future), future


class TaskStop:
    """A request to stop that parts of one task share: each then ends early with what it has."""

    def __init__(self, stop: Stop) -> None:
        self._stop, self._left = stop, False

    def __call__(self) -> bool:
        return self._left or self._stop()

    def leave(self) -> None:
        self._left = True


def run_parts(
    work: Callable[[Item], Result], items: Sequence[Item], threads: int
) -> Iterator[tuple[int, Result]]:
    """Yield results as `TaskPool.run` does, of parts that threads of this process compute.

    After an error no further part begins.
    """
    if threads <= 1:
        yield from ((n, work(item)) for n, item in enumerate(items))
        return
    with ThreadPoolExecutor(threads) as pool:
        futures = {pool.submit(work, item): n for n, item in enumerate(items)}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


class _Surroundings:
    """What a task may know about the process that it runs in."""

    stop: Stop = staticmethod(never_stop)
    stopped = False


def stop_requested() -> bool:
    """Whether the task that asks shall end early; it then has no result."""
    _Surroundings.stopped = _Surroundings.stopped or _Surroundings.stop()
    return _Surroundings.stopped


def stop_tasks(stop: Stop) -> None:
    """Let tasks of this process end early once `stop` is true."""
    _Surroundings.stop, _Surroundings.stopped = staticmethod(stop), False


def can_fork() -> bool:
    """Return whether a copy works: libraries of macOS do not survive it, nor do locks that threads hold.

    Threads of libraries are not seen: a copy must not wait for one that has worked here, such as typst's.
    """
    return sys.platform == "linux" and count_cores() > 1 and threading.active_count() == 1


@contextmanager
def open_processes(count: int) -> Iterator[tuple[ProcessPoolExecutor, Event]]:
    copied = can_fork()
    context = get_context("fork" if copied else "spawn")
    event = context.Event()
    with ProcessPoolExecutor(count, context, _begin_process, (event, os.getpid(), copied)) as pool:
        if copied:
            # a copy has this process's handlers at first, which only note a signal: it comes later
            before = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDING_SIGNALS)
            try:
                pool.submit(int)  # the first task forks all processes
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, before)
        yield pool, event


def _begin_process(stop: Event, parent: int, is_copy: bool) -> None:
    """Keep linear algebra to one thread, end with `parent`, and leave Ctrl-C to it.

    A copy of its parent has loaded its linear algebra already, and has its handlers of signals.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with(parent)  # whatever it computes: nobody would read what it returns
    if is_copy:
        from threadpoolctl import threadpool_limits

        for number in _ENDING_SIGNALS - {signal.SIGINT}:
            signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDING_SIGNALS)
        threadpool_limits(1, user_api="blas")
    limit_to_one_thread()
    stop_tasks(stop.is_set)


def _run_task(data: bytes, item: object) -> tuple[Any, bool]:
    """Return a result, and whether nothing made the task end early."""
    _Surroundings.stopped = False
    result = read_work(data)(item)
    return result, not _Surroundings.stopped


@lru_cache(maxsize=1)  # tasks of the same work share what it computes once
def read_work(data: bytes) -> Callable[[object], object]:
    """Return work as `pickle` wrote it."""
    return pickle.loads(data)  # noqa: S301  from the process that started this one
