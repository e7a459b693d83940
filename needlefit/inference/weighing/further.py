"""How probable further data y are, after data D: the evidence of both over that of the first.

    log p(y | D) = log Z(D, y) - log Z(D),      Z = integral of likelihood and prior over theta

The mean of p(y | theta) over draws of the posterior of D is the same, but where y has many exact points it is
decided by the one draw that comes nearest: too low at most times, and its own scatter does not tell. The two
integrals are by importance, each about its own peaks (C. P. Robert, D. Wraith, AIP Conf. Proc. 1193 (2009)
251), so that draws are where the integrand is.
"""

import math
from dataclasses import dataclass

from needlefit.inference.weighing.importance import Weighted


@dataclass(frozen=True)
class Further:
    """How probable further data are.

    Attributes
    ----------
    log_density : float
        log p(y | D).
    se : float
        Its Monte Carlo error.
    shared_se : float
        The part of it that comes from Z(D), and is the same error for all that is asked after D.
    k : float
        Pareto's: the larger of the two integrals'.
    independent : float
        Independent draws that their weights are worth: the fewer of the two integrals'.
    """

    log_density: float
    se: float
    shared_se: float
    k: float
    independent: float


NOTHING = Further(-math.inf, math.inf, math.inf, math.nan, 0.0)
"""Of data that cannot be foretold."""


def further(both: Weighted, first: Weighted) -> Further:
    """Return how probable further data are, given the weighing of both and that of the first alone.

    The two densities must be normalised alike: what the further data add is their likelihood, in full.
    """
    return Further(
        both.log_evidence - first.log_evidence,
        math.hypot(both.log_evidence_se, first.log_evidence_se),
        first.log_evidence_se,
        max(both.k, first.k),
        min(both.independent, first.independent),
    )
