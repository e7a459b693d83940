"""Tissue laws: how the foundation modulus depends on the stretch. One law, one file.

A law is a sum of powers of the stretch, k(lambda) = mu * sum_p c_p lambda^q_p. Its file defines
`terms(alpha)`, which returns the pairs (c_p, q_p); values, slopes and series all follow from these,
so that the reference and the compiled kernel know every law without naming any.
"""

import importlib
import pkgutil
from functools import cache

import numpy as np
from numpy.typing import NDArray

from needlefit.errors import ModelError

Floats = NDArray[np.float64]


@cache  # simulate asks at every call; the folder does not change under a running program
def names() -> tuple[str, ...]:
    """Return the laws there are: the files of this folder."""
    return tuple(sorted(module.name for module in pkgutil.iter_modules(__path__)))


def power_terms(law: str, alpha: Floats) -> tuple[Floats, Floats]:
    """Return coefficients and exponents, each (n, P), of the named law for n layers.

    Raises
    ------
    ModelError
        If there is no law of that name.
    """
    if law not in names():
        raise ModelError(f"there is no tissue law called `{law}`", expected=f"one of {', '.join(names())}")
    module = importlib.import_module(f"{__name__}.{law}")
    pairs = np.array([module.terms(float(a)) for a in alpha])  # (n, P, 2)
    return np.ascontiguousarray(pairs[..., 0]), np.ascontiguousarray(pairs[..., 1])
