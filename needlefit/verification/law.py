"""Compute the tissue's reaction a second time, from docs/model.md 3, independent of the code under test.

k is the derivative of the true stress that a law's strain energy gives, by differences, and not the k that
its file states to the kernel. Complex numbers are accepted: derivatives are complex steps.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats, Ints
from needlefit.mechanics.laws import LAWS
from needlefit.mechanics.tissue import Tissue

Numbers = NDArray[Any]  # real or complex

STEP = 1e-30

STENCIL = ((1, 4 / 5), (2, -1 / 5), (3, 4 / 105), (4, -1 / 280))
STENCIL_STEP = 0.003
"""Central differences of eighth order: multiples of the step, their weights, and the step over lambda. For
powers of lambda up to 12 their relative error is below 1e-12.
"""


def differentiate_stress(law: str, stretch: Numbers, shape: Sequence[Numbers]) -> Numbers:
    """Return k over mu, the derivative of the true stress; or the k of a law without one."""
    stress = LAWS[law].stress
    if stress(stretch, *shape) is None:
        return LAWS[law].k(stretch, *shape)
    step = STENCIL_STEP * stretch.real
    ends = (
        weight * (stress(stretch + m * step, *shape) - stress(stretch - m * step, *shape))  # type: ignore[operator]
        for m, weight in STENCIL
    )
    found: Numbers = sum(ends) / step
    return found


@dataclass(frozen=True)
class ReferenceLaw:
    """The parameters of all layers, each (n,) or of `shape` (p, n), real or complex."""

    mu: Numbers
    shape: Numbers
    thickness: Numbers
    friction: Numbers
    name: str

    @classmethod
    def of(cls, tissue: Tissue) -> Self:
        """Return the parameters of a tissue."""
        return cls(tissue.mu, tissue.shape, tissue.thickness, tissue.friction, tissue.law)

    def reaction(self, layer: Ints, e: Numbers, slope: Numbers) -> Numbers:
        """Return k(lambda) e g, the force per length (N / mm) at deflections `e` (mm) in the given layers."""
        mu, shape = self.mu[layer], self.shape[:, layer]
        # not abs(e): of a complex number it is real, and the complex step would be lost
        stretch = 1 - np.where(e.real < 0, -e, e) / self.thickness[layer]
        k = mu * differentiate_stress(self.name, stretch, tuple(shape))
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
