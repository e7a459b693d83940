"""Gent solid, incompressible, in the same compression: its chains have a greatest extension.

W = -mu J_m / 2 ln(1 - (I_1 - 3) / J_m), I_1 = lambda^2 + 2 / lambda. It stiffens without limit as I_1 - 3
comes to J_m, where the law ends, and is the neo-Hookean solid for an infinite J_m.
"""

import math

import numpy as np

from needlefit.mechanics.laws import Numbers, ShapeParameter, TissueLaw

LIMIT = ShapeParameter("jm", "Jm", "limit of I1 - 3 of the Gent law", (0.5, 20.0), 5.0, (0.2, math.inf))


class Gent(TissueLaw):
    """K = mu J_m / r (2 lambda + lambda^-2 + 2 lambda (lambda - lambda^-2)^2 / r), r = J_m - (I_1 - 3)."""

    name, label = "gent", "Gent foundation"
    parameters = (LIMIT,)

    def k(self, stretch: Numbers, jm: Numbers) -> Numbers:
        """Return the derivative of the true stress over mu; NaN beyond the limit: there the table ends."""
        rest = jm - (stretch**2 + 2 / stretch - 3)
        slope = 2 * stretch + stretch**-2 + 2 * stretch * (stretch - stretch**-2) ** 2 / rest
        return np.where(rest.real > 0, jm / rest * slope, np.nan)


GENT = Gent()
