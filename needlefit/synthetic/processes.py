"""Insertions do not depend on each other: many at once, each in a process of its own.

This module imports nothing heavy, so that a new process can be told of its one thread before numpy comes in.
"""

import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from typing import TypeVar

from needlefit.errors import ConfigError

Task = TypeVar("Task")
Answer = TypeVar("Answer")


def each(function: Callable[[Task], Answer], tasks: Sequence[Task], jobs: int) -> Iterator[Answer]:
    """Yield `function(task)` of every task, in their order, from `jobs` processes.

    What is not begun when the caller stops asking, or one of them fails, is not begun any more.

    Raises
    ------
    ConfigError
        If a process was ended from outside.
    """
    if min(jobs, len(tasks)) <= 1:
        yield from map(function, tasks)
        return
    pool = ProcessPoolExecutor(min(jobs, len(tasks)), get_context("spawn"), initializer=_alone)
    try:
        yield from pool.map(function, tasks)
    except BrokenProcessPool:
        raise ConfigError(
            "one of the processes was ended from outside, or could not begin",
            expected="about 1 GB of memory for each",
            mend="use fewer with --jobs",
        ) from None
    finally:
        pool.shutdown(cancel_futures=True)


def _alone() -> None:
    """Keep this process to one thread, and leave Ctrl-C to the one that started it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ[name] = "1"
