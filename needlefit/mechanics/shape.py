"""The answer of a simulation: the needle's shape in the constraint frame C."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Status = Literal["converged", "over-compressed", "not converged", "non-finite"]


@dataclass(frozen=True)
class NeedleShape:
    """Nodes of the deflected beam in C, base first, tip last.

    `x` is the beam coordinate (arc length, 0 at the entry), not the place in space: see `positions`.

    Attributes
    ----------
    x, u, slope : (N,) arrays
        Node, deflection (mm) and slope u'.
    constraints : (M + 1, 2) array
        Depth and y of the constraint points, mm; point 0 is first contact.
    tip_track : (M + 1, 2) array
        Deflection (mm) and slope of the tip as it stood at each constraint point.
    status : str
        "converged", or why it is not.
    iterations : int
        Newton iterations over all steps.
    """

    x: Floats
    u: Floats
    slope: Floats
    constraints: Floats
    tip_track: Floats
    status: Status
    iterations: int

    @property
    def converged(self) -> bool:
        """Whether every step reached the tolerance."""
        return self.status == "converged"

    @property
    def depth(self) -> float:
        """Inserted arc length, mm."""
        return float(self.x[-1])

    @property
    def deflection(self) -> float:
        """Deflection of the tip in C, mm."""
        return float(self.u[-1])
