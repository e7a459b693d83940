"""Compute pieces of work in this process and in copies of it.

On Linux a process without threads is forked: a copy has loaded everything that it has, and begins at once.
"""

import pickle
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, wait
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from multiprocessing import get_context
from multiprocessing.synchronize import Event
from typing import Any

from needlefit.project.callbacks import Step, Stop, never_stop, no_step
from needlefit.project.tasks import STOP_POLL_S, Item, Result, can_fork, open_processes, run_parts


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
            _Copied.work, _Copied.taken = work, taken
            with suppress(OSError):  # without a copy all is done here
                pool, event = stack.enter_context(open_processes(copies))
                futures = [pool.submit(_run_piece, n) for n in range(len(work))]
            _Copied.work = ()

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


class _Copied:
    """What a copy of this process knows of it."""

    work: Sequence[Callable[[], bytes]] = ()  # what this process was copied for
    taken: Any = None  # of `work` by this process, or another copy


def _run_piece(number: int) -> bytes:
    return _Copied.work[number]() if _take(_Copied.taken, number) else b""


def _take(taken: Any, number: int) -> bool:  # noqa: ANN401 - an array that processes share has no type
    """Whether nobody has taken a piece of work yet; it is then taken."""
    with taken.get_lock():
        is_free = not taken[number]
        taken[number] = 1
    return is_free
