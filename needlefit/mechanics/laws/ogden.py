"""One-term, incompressible Ogden solid in unconfined uniaxial compression (the paper's Eq. 4).

W = 2 mu / alpha^2 (lambda^alpha + 2 lambda^(-alpha / 2) - 3).
"""

from needlefit.mechanics.laws import PowerLaw, ShapeParameter


class Ogden(PowerLaw):
    """K = 2 mu (lambda^(alpha - 1) + 1/2 lambda^(-alpha / 2 - 1))."""

    name, label = "ogden", "Ogden foundation"
    # the prior holds the exponents that the paper chose for its tissues, -1 to 1
    parameters = (
        ShapeParameter("alpha", "α", "exponent of the Ogden law", (-7.0, 9.0), 1.0, prior=(1.0, 2.0)),
    )

    def terms(self, alpha: float) -> list[tuple[float, float]]:
        """Return the two powers."""
        return [(2.0, alpha - 1.0), (1.0, -alpha / 2.0 - 1.0)]


OGDEN = Ogden()
