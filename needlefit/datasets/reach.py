"""How much of a shape known only up to a rigid motion is compared."""

from needlefit.datasets.insertion import Insertion
from needlefit.errors import DataError
from needlefit.geometry.curves import arc_length


def reach_from_tip(drop: float, insertion: Insertion) -> float:
    """Return how far from the tip a free comparison begins, mm.

    Raises
    ------
    DataError
        If nothing is left to compare.
    """
    reach = min(float(arc_length(insertion.planar)[-1]), insertion.depth) - drop
    if reach <= 0:
        raise DataError(
            f"insertion `{insertion.id}` is not longer than the {drop:g} mm that are left out",
            fix="lessen frame.drop_proximal_mm, or leave the insertion out",
        )
    return reach
