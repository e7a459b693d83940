"""Largest in-plane error."""

import numpy as np

from needlefit.metrics import Metric, pool_distances

MAX_IPE = Metric(
    "ipe_max_mm",
    "Max IPE",
    "mm",
    "Largest in-plane error of the points of a curve.",
    compute=lambda curves: float(np.max(curves.distances)),
    pool=lambda curves: float(np.max(pool_distances(curves))),
    order=30,
)
