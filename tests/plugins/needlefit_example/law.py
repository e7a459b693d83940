"""A tissue law that is no sum of powers."""

import numpy as np

from needlefit.mechanics.laws import ShapeParameter, TissueLaw


class Logarithmic(TissueLaw):
    """K = 3 mu (1 - alpha ln lambda + beta ln^2 lambda)."""

    name, label = "logarithmic", "logarithmic foundation"
    parameters = (
        ShapeParameter(
            "alpha", "α", "logarithmic stiffening", usual=(0.0, 3.0), default=1.0, bounds=(0.0, 5.0)
        ),
        ShapeParameter("beta", "β", "square of it", usual=(0.0, 2.0), default=0.0, bounds=(0.0, 5.0)),
    )

    def k(self, stretch, alpha, beta):
        """Return the tangent modulus over mu."""
        return 3 * (1 - alpha * np.log(stretch) + beta * np.log(stretch) ** 2)


LOGARITHMIC = Logarithmic()
