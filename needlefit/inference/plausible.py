"""Whether fitted parameters are those of a soft tissue and of a bevel, by published ranges."""

import math
from collections.abc import Mapping

from needlefit.inference.parameter_names import BEVEL_PARAMETERS
from needlefit.mechanics.published import read_cut_angles
from needlefit.project.unit_warnings import MU_PA

#: factor below the smallest published angle of a cut beyond which an angle is not plausible: the bevels of
#: stiff designs in benchmarks/mistakes.py lie 2 times below
MIN_CUT_FACTOR = 5.0


def compute_cut_angle(name: str, value: float, spacing_mm: float) -> float:
    """Return the angle of a bevel's cut, degrees, by one of its parameters."""
    return value if name == "cut_angle_deg" else math.degrees(math.atan(value / spacing_mm))


def list_implausible(values: Mapping[str, float], spacing_mm: float) -> list[str]:
    """Return the moduli that no tissue has, then the bevel that cuts far from all published angles."""
    moduli = [
        name for name, value in values.items() if name.startswith("mu") and not MU_PA[0] <= value <= MU_PA[1]
    ]
    low, high = read_cut_angles().low / MIN_CUT_FACTOR, read_cut_angles().high
    bevels = [
        name
        for name in BEVEL_PARAMETERS
        if name in values and not low <= compute_cut_angle(name, values[name], spacing_mm) <= high
    ]
    return moduli + bevels
