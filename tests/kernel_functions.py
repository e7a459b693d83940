"""All compiled functions of the kernel."""

import importlib
import pkgutil
from collections.abc import Iterator

from numba.core.dispatcher import Dispatcher

from needlefit.mechanics import kernel


def kernel_functions() -> Iterator[Dispatcher]:
    for found in pkgutil.walk_packages(kernel.__path__, f"{kernel.__name__}."):
        for value in vars(importlib.import_module(found.name)).values():
            if isinstance(value, Dispatcher) and value.py_func.__module__ == found.name:
                yield value
