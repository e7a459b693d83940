"""The tip alone: its deflection from the line of insertion, at the inserted depth."""

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.columns import InsertionRow
from needlefit.datasets.observations import HeldObservation


def place_tip(row: InsertionRow) -> Floats:
    """Return the entry and the tip, at the inserted depth along the entry line."""
    return np.array([np.zeros(3), [row.depth, row.tip_y or 0.0, row.tip_z or 0.0]])


TIP = HeldObservation(
    "tip",
    "tips, across the line of insertion",
    lambda row: row.tip_y is not None,
    place_tip,
    lambda row: {"tip": None, "directions": 1 if row.tip_z is None else 2},
)
