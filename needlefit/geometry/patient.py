"""Patient coordinates: LPS inside, whatever a file holds."""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from needlefit.geometry.frames import Frame

Floats = NDArray[np.float64]
System = Literal["LPS", "RAS"]

SIGNS = {"LPS": (1.0, 1.0, 1.0), "RAS": (-1.0, -1.0, 1.0)}
"""What turns coordinates of a system into LPS: both have z toward the head, x and y are opposite."""

IN_PATIENT = Frame(np.zeros(3), np.eye(3))
"""The patient's frame in a world that is the patient's frame."""


def lps(points: ArrayLike, system: System) -> Floats:
    """Return `points` (..., 3) of a system as LPS coordinates; from LPS to that system it is the same."""
    turned: Floats = np.asarray(points, dtype=np.float64) * SIGNS[system] + 0.0  # no "-0.0"
    return turned
