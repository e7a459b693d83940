"""Linear foundation: every law's value at lambda = 1."""

from needlefit.mechanics.laws import Numbers, PowerLaw


class Linear(PowerLaw):
    """K = 3 mu, whatever the stretch."""

    name, label = "linear", "linear foundation"

    def terms(self) -> list[tuple[float, float]]:
        """Return one power, a constant."""
        return [(3.0, 0.0)]

    def stress(self, stretch: Numbers) -> Numbers:
        """Return 3 times the engineering strain."""
        return 3 * (stretch - 1)


LINEAR = Linear()
