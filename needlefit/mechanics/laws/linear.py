"""Linear foundation: every law's value at lambda = 1; alpha is not used."""


def terms(alpha: float) -> list[tuple[float, float]]:
    """K = 3 mu, whatever the stretch."""
    return [(3.0, 0.0)]
