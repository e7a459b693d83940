"""Run the same work on many items: in this process, in several, or on the workers of a cluster.

A task is a function of a module and one item; its result depends on these alone, not on where it runs. A pool
runs tasks: `LocalPool` here, `project.cluster` on other machines. The standard library pickles what travels
between processes. It travels through pipes between processes of this program, or between the members of a
cluster that trust each other; no file is ever unpickled.

On Linux a process without threads is forked: a copy has loaded everything that it has, and begins at once.

This module imports nothing heavy, so that a new process limits itself to one thread before it imports numpy.
"""

import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor, as_completed, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache, partial
from multiprocessing import get_context
from multiprocessing.synchronize import Event
from queue import Empty, SimpleQueue
from typing import Any, Protocol, TypeVar

from needlefit.errors import UnfinishedWorkError
from needlefit.project.processes import count_cores, end_with, limit_to_one_thread

# ---- callbacks of long computations, and defaults that do nothing

Progress = Callable[[str, int, int], None]  # called with what is done, how much of it, of how much
Step = Callable[[int, int], None]  # called with how much is done, of how much
Stop = Callable[[], bool]

Note = Callable[[str], None]
"""Given a line that the user should read, and that is no result: what was damaged and computed again."""


def no_progress(_what: str, _done: int, _of: int) -> None:
    """Tell nobody."""


def no_step(_done: int, _of: int) -> None:
    """Tell nobody."""


def never_stop() -> bool:
    """Say that nobody wants to stop."""
    return False


def no_note(_line: str) -> None:
    """Pass a line to nobody."""


Item = TypeVar("Item")
Result = TypeVar("Result")

STOP_POLL_S = 0.2  # seconds between two questions whether to stop, while tasks run elsewhere

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
        with _open_processes(count) as (pool, event):

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


THIS_PROCESS = LocalPool()  # one task at a time, in this process


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


def compute_in_copies(
    work: Callable[[Item], Result], items: Sequence[Item], jobs: int, step: Step = no_step
) -> list[Result]:
    """Return what `work` makes of items in this process and copies of it, `jobs` in all.

    See `compute_beside`; without copies, threads of this process compute it.
    """
    if jobs == 1 or not can_fork():
        results = dict[int, Result]()
        for n, result in run_parts(work, items, jobs):
            results[n] = result
            step(len(results), len(items))
        return [results[n] for n in range(len(items))]
    pieces = [partial(_dump_result, work, item) for item in items]
    with compute_beside(pieces, copies=min(jobs, len(items)) - 1, step=step) as finish:
        return [pickle.loads(data) for data in finish()]  # noqa: S301  from copies of this process


def _dump_result(work: Callable[[Item], object], item: Item) -> bytes:
    return pickle.dumps(work(item))


@contextmanager
def compute_beside(
    work: Sequence[Callable[[], bytes]], stop: Stop = never_stop, copies: int = 1, step: Step = no_step
) -> "Iterator[Callable[[], list[bytes]]]":
    """Begin pieces of work in copies of this process; yield a function that returns what they give.

    Until it is called this process may do other work. It then takes its share, the last pieces first. Pieces
    are taken, not cancelled: CPython 3.11 waits for ever where a copy dies beside a cancelled piece. What
    failed in a copy is repeated here, so that its errors are raised here. Work must not wait for threads of
    this process, which a copy lacks: those of typst among them. In a copy `stop_requested` is true once
    `stop` was asked for, or nobody wants the rest.
    """
    with ExitStack() as stack:
        futures: list[Future[bytes]] = []
        event: Event | None = None
        taken: Any = None  # by this process, or a copy; without copies everything is done here
        if len(work) > 1 and can_fork():
            taken = get_context("fork").Array("b", len(work))
            _Surroundings.work, _Surroundings.taken = work, taken
            with suppress(OSError):  # without a copy all is done here
                pool, event = stack.enter_context(_open_processes(copies))
                futures = [pool.submit(_run_piece, n) for n in range(len(work))]
            _Surroundings.work = ()

        def end() -> list[bytes]:
            here, beside = dict[int, bytes](), dict(enumerate(futures))
            for n in range(len(work))[::-1]:
                if not futures or _take(taken, n):
                    here[n] = work[n]()
                    beside.pop(n, None)
                    step(len(here) + sum(future.done() for future in beside.values()), len(work))
            while waiting := wait(beside.values(), STOP_POLL_S).not_done:
                step(len(work) - len(waiting), len(work))
                if event is not None and stop():
                    event.set()
            if futures:
                step(len(work), len(work))
            return [
                here[n] if n in here else task() if futures[n].exception() else futures[n].result()
                for n, task in enumerate(work)
            ]

        try:
            yield end
        finally:
            for n in range(len(futures)):  # after an error nobody wants the rest
                _take(taken, n)
            if event is not None:
                event.set()


def _run_piece(number: int) -> bytes:
    return _Surroundings.work[number]() if _take(_Surroundings.taken, number) else b""


def _take(taken: Any, number: int) -> bool:  # noqa: ANN401 - an array that processes share has no type
    """Whether nobody has taken a piece of work yet; it is then taken."""
    with taken.get_lock():
        is_free = not taken[number]
        taken[number] = 1
    return is_free


class _Surroundings:
    """What a task may know about the process that it runs in."""

    stop: Stop = staticmethod(never_stop)
    stopped = False
    work: Sequence[Callable[[], bytes]] = ()  # what this process was copied for
    taken: Any = None  # of `work` by this process, or another copy


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
def _open_processes(count: int) -> Iterator[tuple[ProcessPoolExecutor, Event]]:
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
