"""Whether what should be numbers are."""

import math


def finite(*values: float) -> bool:
    """Return whether all values are finite numbers; what is no number at all is none."""
    try:
        return all(map(math.isfinite, values))
    except (TypeError, OverflowError):
        return False
