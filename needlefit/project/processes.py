"""The process that runs: its cores, its end, and one thread for linear algebra.

With one thread the same work gives the same bytes on any number of cores.

A product or a decomposition that BLAS shares out among threads ends in other digits with another number
of them, and what is made of its eigenvectors differs by 1e-12 mm. Fits of a few unknowns also lose more by
sharing than they gain: on two busy cores the markers of a scan took sixteen times as long with OpenBLAS's.

The command line and the processes that it starts set what BLAS reads when it is loaded. A program that uses
the package has loaded BLAS already: there the functions that begin a run hold it to one thread.
"""

import os
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import partial, wraps
from typing import ParamSpec, TypeVar

Given = ParamSpec("Given")
Returned = TypeVar("Returned")

THREAD_VARIABLES = (
    *("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS"),
    "VECLIB_MAXIMUM_THREADS",
)

_SET_PARENT_DEATH_SIGNAL = 1  # number of PR_SET_PDEATHSIG, an option of prctl(2)
_ARENA_MAX = -8  # number of M_ARENA_MAX, a parameter of mallopt(3)


def limit_to_one_thread() -> None:
    """Keep this process, and those that it starts, to one thread; before numpy is imported."""
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))


def leave_out_help_texts() -> None:
    """Let scipy load without completing its texts of help, a fifth of a second: no command prints them.

    Nor does any need the compiler of Fortran, which scipy would load as it copies the names of numpy.
    """
    import numpy

    numpy.__dict__.setdefault("f2py")
    with suppress(ImportError, AttributeError):  # of a version that completes none in this way
        from scipy._lib import _docscrape

        _docscrape.FunctionDoc = partial(_docscrape.FunctionDoc, doc="")  # type: ignore[assignment, misc]


def count_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def end_with(parent: int) -> None:
    """Let this process be ended together with its parent, by its id, where the system offers it."""
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(_SET_PARENT_DEATH_SIGNAL, signal.SIGKILL)
        if os.getppid() != parent:  # it ended before
            os._exit(1)


def share_heap() -> None:
    """Let all threads take memory from one heap, where the C library offers it (glibc).

    Searches that take turns would each leave freed memory in a heap of their own: of 40 needles 0.3 GB.
    """
    if sys.platform == "linux":
        import ctypes

        getattr(ctypes.CDLL(None), "mallopt", lambda *_: 0)(_ARENA_MAX, 1)


def one_thread(function: Callable[Given, Returned]) -> Callable[Given, Returned]:
    """Return `function`, with which a run begins, such that its linear algebra is in one thread."""

    @wraps(function)
    def alone(*args: Given.args, **kwargs: Given.kwargs) -> Returned:
        import scipy.linalg  # noqa: F401  scipy brings a BLAS besides numpy's, and only what is loaded is limited
        from threadpoolctl import threadpool_limits

        share_heap()
        with threadpool_limits(1, user_api="blas"):
            return function(*args, **kwargs)

    return alone
