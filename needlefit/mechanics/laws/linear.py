"""Linear foundation: every law's value at lambda = 1; alpha is not used."""

from needlefit.mechanics.laws import Numbers, PowerLaw


class Linear(PowerLaw):
    """K = 3 mu, whatever the stretch."""

    name, label = "linear", "linear foundation"

    def terms(self, alpha: float) -> list[tuple[float, float]]:
        """Return one power, a constant."""
        return [(3.0, 0.0)]

    def stress(self, stretch: Numbers, alpha: Numbers) -> Numbers:
        """Return 3 times the engineering strain."""
        return 3 * (stretch - 1)


LINEAR = Linear()
