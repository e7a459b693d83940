"""Error-to-deflection percentage (EDP)."""

from collections.abc import Sequence

import numpy as np

from needlefit.geometry.curves import ComparedCurves
from needlefit.metrics import Metric


def _relative_tip_error(curves: ComparedCurves) -> float:
    """Return 100 TE / |deflection|; infinite where the measured needle stayed straight."""
    if not curves.deflection:
        return np.inf if curves.tip_error else 0.0
    return 100 * curves.tip_error / abs(curves.deflection)


def _pooled(curves: Sequence[ComparedCurves]) -> float:
    """Return the sum of tip errors over the sum of deflections: no small deflection dominates it."""
    deflected = sum(abs(one.deflection) for one in curves)
    return 100 * sum(one.tip_error for one in curves) / deflected if deflected > 0 else np.nan


EDP = Metric(
    "edp_percent",
    "EDP",
    "%",
    "Error-to-deflection percentage (EDP): tip error as a percentage of the measured deflection of the tip.",
    compute=_relative_tip_error,
    pool=_pooled,
    has_floor=False,
    relative=True,
    order=50,
)
