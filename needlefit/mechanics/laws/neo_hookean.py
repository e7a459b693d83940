"""Neo-Hookean solid in the same compression: the Ogden law at alpha = 2."""

from needlefit.mechanics.laws import PowerLaw


class NeoHookean(PowerLaw):
    """K = 2 mu (lambda + 1/2 lambda^-2)."""

    name, label = "neo_hookean", "neo-Hookean foundation"

    def terms(self) -> list[tuple[float, float]]:
        """Return the two powers."""
        return [(2.0, 1.0), (1.0, -2.0)]


NEO_HOOKEAN = NeoHookean()
