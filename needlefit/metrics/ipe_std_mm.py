"""Standard deviation of the in-plane error."""

import numpy as np

from needlefit.metrics import Metric, pool_distances

IPE_SPREAD = Metric(
    "ipe_std_mm",
    "SD of IPE",
    "mm",
    "Standard deviation of the in-plane error over the points of a curve (no correction for their number).",
    compute=lambda curves: float(np.std(curves.distances)),
    pool=lambda curves: float(np.std(pool_distances(curves))),
    has_floor=False,
    spread_of="ipe_mean_mm",
    macro="ipe-sd",
    order=21,
)
