"""One-term, incompressible Ogden solid in unconfined uniaxial compression (the paper's Eq. 4)."""


def terms(alpha: float) -> list[tuple[float, float]]:
    """K = 2 mu (lambda^(alpha - 1) + 1/2 lambda^(-alpha / 2 - 1))."""
    return [(2.0, alpha - 1.0), (1.0, -alpha / 2.0 - 1.0)]
