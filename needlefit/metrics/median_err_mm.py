"""Median in-plane error."""

import numpy as np

from needlefit.metrics import Metric, pool_distances

MEDIAN = Metric(
    "median_err_mm",
    "Median",
    "mm",
    "Median of the in-plane error over the points of a curve.",
    compute=lambda curves: float(np.median(curves.distances)),
    pool=lambda curves: float(np.median(pool_distances(curves))),
    macro="median",
    order=10,
)
