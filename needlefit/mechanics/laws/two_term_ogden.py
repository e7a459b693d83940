"""Two-term, incompressible Ogden solid in the same compression: a share of mu has another exponent.

Exchanging alpha with beta and the share with the rest is the same law. So their usual bounds do not overlap.
"""

from needlefit.mechanics.laws import PowerLaw, ShapeParameter
from needlefit.mechanics.laws.ogden import OGDEN

ALPHA = ShapeParameter("alpha", "α", "exponent of the first Ogden term", (0.0, 5.0), 1.0)
BETA = ShapeParameter("beta", "β", "exponent of the second Ogden term", (-5.0, 0.0), -1.0)
SHARE = ShapeParameter("share", "w", "share of the second Ogden term", (0.0, 1.0), 0.5, (0.0, 1.0))


class TwoTermOgden(PowerLaw):
    """K = (1 - w) k_ogden(alpha) + w k_ogden(beta), w the share of the second term."""

    name, label = "two_term_ogden", "two-term Ogden foundation"
    parameters = (ALPHA, BETA, SHARE)

    def terms(self, alpha: float, beta: float, share: float) -> list[tuple[float, float]]:
        """Return the four powers."""
        first = [((1 - share) * c, q) for c, q in OGDEN.terms(alpha)]
        return [*first, *((share * c, q) for c, q in OGDEN.terms(beta))]


TWO_TERM_OGDEN = TwoTermOgden()
