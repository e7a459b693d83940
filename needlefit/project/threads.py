"""One thread for linear algebra: fits of a few unknowns lose more by sharing them out than they gain.

With the threads of OpenBLAS on two busy cores the markers of a scan took sixteen times as long. And the same
work gives the same bytes on any number of cores.
"""

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

Given = ParamSpec("Given")
Returned = TypeVar("Returned")


def one_thread(function: Callable[Given, Returned]) -> Callable[Given, Returned]:
    """Return `function` such that its linear algebra runs in one thread."""

    @wraps(function)
    def alone(*args: Given.args, **kwargs: Given.kwargs) -> Returned:
        with threadpool_limits(1, user_api="blas"):
            return function(*args, **kwargs)

    return alone
