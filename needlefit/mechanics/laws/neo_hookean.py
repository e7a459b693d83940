"""Neo-Hookean solid in the same compression: the Ogden law at alpha = 2; alpha is not used."""


def terms(alpha: float) -> list[tuple[float, float]]:
    """K = 2 mu (lambda + 1/2 lambda^-2)."""
    return [(2.0, 1.0), (1.0, -2.0)]
