"""Tissue laws: how the foundation modulus depends on the stretch. Each law is one file.

A law is a sum of powers of the stretch, k(lambda) = mu * sum_p c_p lambda^q_p. Its file defines
`terms(alpha)`, which returns the pairs (c_p, q_p), both at most linear in alpha; values, slopes, series and
the derivatives with respect to alpha all follow from these, so that the reference and the compiled kernel
know every law without naming any. Only `verification/law.py` does, which
writes each out once more to check it.
"""

import importlib
import pkgutil
from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from needlefit.errors import ModelError

Floats = NDArray[np.float64]


@cache  # simulate asks at every call; the folder does not change under a running program
def list_laws() -> tuple[str, ...]:
    """Return the names of all laws: the files of this folder."""
    return tuple(sorted(module.name for module in pkgutil.iter_modules(__path__)))


def power_terms(law: str, alpha: Floats) -> tuple[Floats, Floats]:
    """Return coefficients and exponents, each (..., P), of the named law for layers of `alpha` (...).

    Raises
    ------
    ModelError
        If there is no law of that name.
    """
    # Terms are linear in alpha, so their values at alpha = 0 and 1 determine them for every alpha.
    (c, q), (dc, dq) = _make_terms_at_zero(law), term_slopes(law)
    return c + alpha[..., None] * dc, q + alpha[..., None] * dq


@cache
def term_slopes(law: str) -> tuple[Floats, Floats]:
    """Return the derivatives of a law's coefficients and exponents, each (P,), with respect to alpha.

    Raises
    ------
    ModelError
        If there is no law of that name.
    """
    slopes = np.array(_find_terms(law)(1.0)) - np.array(
        _find_terms(law)(0.0)
    )  # (P, 2): the terms are linear in alpha
    return np.ascontiguousarray(slopes[:, 0]), np.ascontiguousarray(slopes[:, 1])


@cache
def _make_terms_at_zero(law: str) -> tuple[Floats, Floats]:
    pairs = np.array(_find_terms(law)(0.0))  # (P, 2)
    return np.ascontiguousarray(pairs[:, 0]), np.ascontiguousarray(pairs[:, 1])


def _find_terms(law: str) -> Callable[[float], list[tuple[float, float]]]:
    if law not in list_laws():
        raise ModelError(
            f"there is no tissue law called `{law}`", expected=f"one of {', '.join(list_laws())}"
        )
    terms: Callable[[float], list[tuple[float, float]]] = importlib.import_module(f"{__name__}.{law}").terms
    return terms
