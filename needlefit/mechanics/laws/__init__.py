"""Tissue laws: how the foundation modulus depends on the stretch. Each law is one file here, or of a plugin.

A law is any smooth k(lambda; alpha) > 0. Where it is a sum of powers of the stretch (`PowerLaw`), the kernel
evaluates exactly that; any other one is interpolated at Chebyshev points (`mechanics/law_form.py`).
Reference, kernel, derivatives and `needlefit verify` know every law without naming any.
"""

import math
from abc import ABC, abstractmethod
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats
from needlefit.registry import Registry

Numbers = NDArray[Any]
"""Real or complex."""

COMPLEX_STEP = 1e-30


class TissueLaw(ABC):
    """k(lambda; alpha) of one layer, over mu; k is 3 mu at small strain in all laws here.

    All functions take arrays of one shape. They must be analytic, as numpy's are but for `abs`, and accept
    complex numbers: derivatives are complex steps, unless a law defines them.
    """

    name: str
    label: str
    """The printed name."""
    alpha_range: tuple[float, float] = (-math.inf, math.inf)
    """The alphas that the law is meant for."""

    @abstractmethod
    def k(self, stretch: Numbers, alpha: Numbers) -> Numbers:
        """Return the tangent modulus over mu."""

    def stress(self, stretch: Numbers, alpha: Numbers) -> Numbers | None:
        """Return the true stress over mu, lambda dW/dlambda, whose derivative k is: `verify` compares.

        None where it is not known; k is then compared with itself alone.
        """
        return None

    def dk_dstretch(self, stretch: Floats, alpha: Floats) -> Floats:
        """Return dk/dlambda over mu."""
        found: Floats = self.k(stretch + 1j * COMPLEX_STEP, alpha).imag / COMPLEX_STEP
        return found

    def dk_dalpha(self, stretch: Floats, alpha: Floats) -> Floats:
        """Return dk/dalpha over mu."""
        found: Floats = self.k(stretch, alpha + 1j * COMPLEX_STEP).imag / COMPLEX_STEP
        return found

    def into_range(self, alpha: Floats) -> Floats:
        """Return alphas of -10 to 10, moved linearly into the law's range where that is narrower."""
        low, high = max(self.alpha_range[0], -10.0), min(self.alpha_range[1], 10.0)
        return alpha if (low, high) == (-10.0, 10.0) else low + (alpha + 10) / 20 * (high - low)

    @cached_property
    def uses_alpha(self) -> bool:
        """Whether k depends on alpha."""
        low, high = np.clip([0.5, 1.5], *self.alpha_range)
        stretch = np.array([0.6, 0.8])
        return not np.array_equal(self.k(stretch, np.full(2, low)), self.k(stretch, np.full(2, high)))


class PowerLaw(TissueLaw):
    """A law that is a sum of powers, k = mu sum_p c_p lambda^q_p."""

    @abstractmethod
    def terms(self, alpha: float) -> list[tuple[float, float]]:
        """Return the pairs (c_p, q_p), all at most linear in alpha."""

    @cached_property
    def terms_at_zero(self) -> tuple[Floats, Floats]:
        """Coefficients and exponents, each (P,), at alpha = 0."""
        pairs = np.array(self.terms(0.0))  # (P, 2)
        return pairs[:, 0].copy(), pairs[:, 1].copy()

    @cached_property
    def term_slopes(self) -> tuple[Floats, Floats]:
        """Derivatives of coefficients and exponents, each (1, P), with respect to alpha."""
        slopes = np.array(self.terms(1.0)) - np.array(self.terms(0.0))  # (P, 2): linear in alpha
        return slopes[:, 0].copy()[None], slopes[:, 1].copy()[None]

    def power_terms(self, alpha: Floats) -> tuple[Floats, Floats]:
        """Return coefficients and exponents, each (..., P), for layers of `alpha` (...)."""
        # Terms are linear in alpha, so their values at alpha = 0 and 1 determine them for every alpha.
        (c, q), (dc, dq) = self.terms_at_zero, self.term_slopes
        return c + alpha[..., None] * dc[0], q + alpha[..., None] * dq[0]

    def k(self, stretch: Numbers, alpha: Numbers) -> Numbers:
        """Return the tangent modulus over mu."""
        c, q = self.power_terms(alpha)
        found: Numbers = np.sum(c * stretch[..., None] ** q, axis=-1)
        return found

    def dk_dstretch(self, stretch: Floats, alpha: Floats) -> Floats:
        """Return dk/dlambda over mu."""
        c, q = self.power_terms(alpha)
        found: Floats = np.sum(c * q * stretch[..., None] ** (q - 1), axis=-1)
        return found


LAWS: Registry[TissueLaw] = Registry(TissueLaw, __name__, "tissue law")  # type: ignore[type-abstract]
