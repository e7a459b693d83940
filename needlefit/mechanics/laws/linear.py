"""Linear foundation: every law's value at lambda = 1."""

from needlefit.mechanics.laws import PowerLaw


class Linear(PowerLaw):
    """K = 3 mu, whatever the stretch."""

    name, label = "linear", "linear foundation"

    def terms(self) -> list[tuple[float, float]]:
        """Return one power, a constant."""
        return [(3.0, 0.0)]


LINEAR = Linear()
