"""In-plane error (IPE)."""

import numpy as np

from needlefit.metrics import Metric, pool_distances

IPE = Metric(
    "ipe_mean_mm",
    "IPE",
    "mm",
    "In-plane error (IPE): mean distance between simulated and measured points at equal fractions of the "
    "length.",
    compute=lambda curves: float(np.mean(curves.distances)),
    pool=lambda curves: float(np.mean(pool_distances(curves))),
    headline=True,
    macro="ipe",
    order=20,
)
