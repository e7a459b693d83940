"""Write the tissue's reaction a second time, directly from docs/model.md 3, independent of the code under
test.

Complex numbers are accepted: derivatives are complex steps.
"""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from needlefit.mechanics.tissue import Tissue

Floats = NDArray[np.float64]
Numbers = NDArray[Any]  # real or complex
Ints = NDArray[np.int64]

STEP = 1e-30


@dataclass(frozen=True)
class ReferenceLaw:
    """The parameters of all layers, each (n,), real or complex."""

    mu: Numbers
    alpha: Numbers
    thickness: Numbers
    friction: Numbers
    name: str

    @classmethod
    def of(cls, tissue: Tissue) -> Self:
        """Return the parameters of a tissue."""
        return cls(tissue.mu, tissue.alpha, tissue.thickness, tissue.friction, tissue.law)

    def reaction(self, layer: Ints, e: Numbers, slope: Numbers) -> Numbers:
        """Return k(lambda) e g, the force per length (N / mm) at deflections `e` (mm) in the given layers."""
        mu, alpha = self.mu[layer], self.alpha[layer]
        # not abs(e): of a complex number it is real, and the complex step would be lost
        stretch = 1 - np.where(e.real < 0, -e, e) / self.thickness[layer]
        if self.name == "ogden":
            k = 2 * mu * (stretch ** (alpha - 1) + 0.5 * stretch ** (-alpha / 2 - 1))
        elif self.name == "neo_hookean":
            k = 2 * mu * (stretch + 0.5 / stretch**2)
        elif self.name == "linear":
            k = 3 * mu
        else:
            raise NotImplementedError(
                f"the law `{self.name}` is not written out in needlefit/verification/law.py"
            )
        # sin^2(atan u') = u'^2 / (1 + u'^2)
        force: Numbers = k * e * (1 - self.friction[layer] * slope**2 / (1 + slope**2))
        return force

    def slopes(self, layer: Ints, e: Floats, slope: Floats) -> tuple[Floats, Floats]:
        """Return the derivatives of `reaction` by deflection and by slope."""
        by_e = self.reaction(layer, e + 1j * STEP, slope).imag / STEP
        by_slope = self.reaction(layer, e, slope + 1j * STEP).imag / STEP
        return by_e, by_slope

    def deflection_of(self, layer: Ints, force: Floats, slope: Floats) -> Floats:
        """Return the deflection e (mm) at which the reaction is `force` (N / mm), by bisection."""
        low = np.zeros_like(force)
        # at the full thickness the stretch is 0, and the Ogden law infinite
        high = self.thickness[layer] * (1 - 1e-12)
        for _ in range(100):
            middle = 0.5 * (low + high)
            weak = self.reaction(layer, middle, slope) < np.abs(force)
            low, high = np.where(weak, middle, low), np.where(weak, high, middle)
        return np.copysign(0.5 * (low + high), force)
