"""A tissue law that is no sum of powers."""

import numpy as np

from needlefit.mechanics.laws import TissueLaw


class Logarithmic(TissueLaw):
    """K = 3 mu (1 - alpha ln lambda)."""

    name, label = "logarithmic", "logarithmic foundation"
    alpha_range = (0.0, 5.0)

    def k(self, stretch, alpha):
        """Return the tangent modulus over mu."""
        return 3 * (1 - alpha * np.log(stretch))

    def stress(self, stretch, alpha):
        """Return the true stress over mu, whose derivative is k."""
        return 3 * ((1 + alpha) * (stretch - 1) - alpha * stretch * np.log(stretch))


LOGARITHMIC = Logarithmic()
