"""Run searches side by side: what all of them are to evaluate next is evaluated in one call.

The kernel computes several parameter sets in little more than the time of one. A search evaluates one set
after the other; so several searches run as threads, each waits until all have asked, and one of them
evaluates the sets of all. What a set gives does not depend on those beside it, hence no search depends on the
others.
"""

import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from needlefit.arrays import Floats
from needlefit.inference.fit import EVALUATION_ERRORS
from needlefit.project.tasks import TaskStop

Item = TypeVar("Item")
Result = TypeVar("Result")
Value = TypeVar("Value")

MAX_SEARCHES = 16  #: largest number of searches that run side by side: two blocks of lanes

_Function = Callable[[Floats, int], Sequence[Value]]  #: Thetas (B, P) and a number of threads -> B values


def evaluate(function: "_Function[Value]", theta: Floats) -> Value:
    """Return `function` at one theta (P,), evaluated together with what searches beside this one ask for."""
    group: _Group | None = getattr(_this_thread, "group", None)
    if group is None:
        return function(np.asarray(theta)[None], 1)[0]
    return group.evaluate(function, np.asarray(theta))


def run_side_by_side(
    search: Callable[[Item], Result], items: Sequence[Item], jobs: int, stop: TaskStop
) -> Iterator[tuple[int, Result]]:
    """Yield the number of each item and what its search gives, as they end.

    `jobs` are the threads of an evaluation. Once `stop` is requested, no further search begins; it is
    requested in the end.
    """
    group = _Group(len(items), jobs)

    def run(item: Item) -> tuple[Result, ...]:
        _this_thread.group = group
        with group.turn:
            try:
                return () if stop() else (search(item),)
            finally:
                group.end_search()

    with ThreadPoolExecutor(max(1, min(len(items), MAX_SEARCHES))) as threads:
        futures = {threads.submit(run, item): n for n, item in enumerate(items)}
        try:
            for future in as_completed(futures):
                for result in future.result():
                    yield futures[future], result
        finally:
            stop.leave()  # before the threads are waited for


_this_thread = threading.local()


@dataclass
class _Request:
    function: "_Function[Any]"
    theta: Floats
    value: Any = None
    error: Exception | None = None
    ended: bool = False


class _Group:
    """Searches that evaluate together."""

    def __init__(self, searches: int, jobs: int) -> None:
        self._left, self._jobs = searches, jobs
        #: held by the one search that runs: threads that all run at once wait for the interpreter instead
        self.turn = threading.Condition()
        self._waiting: list[_Request] = []

    def end_search(self) -> None:
        """Count one search less."""
        self._left -= 1
        self.turn.notify_all()

    def evaluate(self, function: "_Function[Value]", theta: Floats) -> Value:
        """Return `function` at theta (P,), once all searches that run wait for a value."""
        request = _Request(function, theta)
        self._waiting.append(request)
        while not request.ended:
            if len(self._waiting) < min(self._left, MAX_SEARCHES):
                self.turn.wait()
                continue
            requests, self._waiting = self._waiting, []
            while requests:
                same = [request for request in requests if request.function == requests[0].function]
                requests = [request for request in requests if request.function != same[0].function]
                self._evaluate_together(same)
            self.turn.notify_all()
        if request.error is not None:
            raise request.error
        return request.value

    def _evaluate_together(self, requests: Sequence[_Request]) -> None:
        try:
            values = requests[0].function(np.array([request.theta for request in requests]), self._jobs)
            for request, value in zip(requests, values, strict=True):
                request.value, request.ended = value, True
        except Exception as error:  # each search gets its own, and goes on or ends by it
            if len(requests) > 1 and isinstance(error, EVALUATION_ERRORS):
                for request in requests:
                    self._evaluate_together([request])
                return
            for request in requests:
                request.error, request.ended = error, True
