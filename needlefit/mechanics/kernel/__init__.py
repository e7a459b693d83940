"""The compiled form of `mechanics/reference.py`; a test compares the two.

`insertion` goes from stop to stop. At each stop `grid` places nodes and quadrature points, `scalar` finds the
equilibrium and `foundation` evaluates the tissue's law. `beam` returns the points in the plane. `lanes/` does
the same for many parameter sets at once. `insertion_derivatives`, with `adjoint` and `parameter_loads`, adds
exact derivatives. `precompile` compiles them side by side. `insertion.InsertionRun` holds all arrays of
a needle, so that Python hands over one object at each call.

A function with `fastmath` lets the compiler fuse or reorder its sums, so its last digits depend on what it
is compiled together with. A function that is called by another is compiled more than once (alone, and within
each caller), and which copy runs depends on what else this process has compiled or loaded. All functions with
`fastmath`, and all that call them, are therefore `forceinline`, up to those that Python calls: each of these
holds all of its sums, and is the same function in the process that compiled it and in those that load it from
the disk, in any order. Without `fastmath` the compiler changes no digit.
"""

import importlib
import pkgutil
from typing import Any, NoReturn

import numba
from numba.core.caching import FunctionCache

from needlefit.mechanics.kernel.cache import FileCache, find_cache_folder

INNER_MODULES = ("adjoint", "parameter_loads", "lanes.newton", "lanes.passes")
"""Compiled functions alone call these, functions with `forceinline` and private ones. They get no wrapper, by
which Python could call them: with many arrays it takes as long to compile as a small function.
"""


def _is_inner(function: Any) -> bool:  # noqa: ANN401  numba's own type
    source, options = function.py_func, function.targetoptions
    return (
        bool(options.get("forceinline"))
        or source.__name__.startswith("_")
        or source.__module__.removeprefix(f"{__name__}.") in INNER_MODULES
    )


def _refuse(*_: object, **__: object) -> NoReturn:
    raise TypeError("compiled functions alone may call this one: Python has no wrapper of it")


def _omit_wrapper(function: Any) -> None:  # noqa: ANN401  numba's own type
    """Compile no wrapper of a function, and raise TypeError where Python calls it: without one it crashes."""
    function.targetoptions |= {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    # Python finds none of the compiled variants, and asks for a further one, which is refused.
    function._insert, function._compile_for_args = lambda *_, **__: None, _refuse


_config: Any = numba.config  # a module that makes its attributes at run time
_before, _config.CACHE_DIR = _config.CACHE_DIR, str(find_cache_folder().path)
try:  # numba reads the setting when a function is declared
    for _found in pkgutil.walk_packages(__path__, f"{__name__}."):
        for _name, _value in vars(importlib.import_module(_found.name)).items():
            if type(getattr(_value, "_cache", None)) is FunctionCache:
                _value._cache = FileCache(_value._cache, f"{_value.py_func.__module__}.{_name}")
                if _is_inner(_value):
                    _omit_wrapper(_value)
finally:
    _config.CACHE_DIR = _before
