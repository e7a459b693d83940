"""Exponential (Fung) solid, incompressible, in the same compression.

W = mu / (2 alpha) (exp(alpha (I_1 - 3)) - 1), I_1 = lambda^2 + 2 / lambda: it stiffens exponentially, as soft
tissue does, and is the neo-Hookean solid at alpha = 0.
"""

import numpy as np

from needlefit.mechanics.laws import Numbers, ShapeParameter, TissueLaw


class Fung(TissueLaw):
    """K = mu exp(alpha (I_1 - 3)) (2 lambda + lambda^-2 + 2 alpha lambda (lambda - lambda^-2)^2)."""

    name, label = "fung", "Fung foundation"
    parameters = (ShapeParameter("alpha", "α", "exponent of the Fung law", (0.0, 5.0), 1.0, (0.0, 50.0)),)

    def k(self, stretch: Numbers, alpha: Numbers) -> Numbers:
        """Return the derivative of the true stress, over mu."""
        inverse = 1 / stretch
        square = inverse * inverse
        difference = stretch - square
        slope = 2 * stretch + square + 2 * alpha * stretch * difference * difference
        return np.exp(alpha * (stretch * stretch + 2 * inverse - 3)) * slope


FUNG = Fung()
