"""A metric: the mean in-plane error of the last quarter of a needle."""

import numpy as np

from needlefit.metrics import Metric

END_ERROR = Metric(
    "end_error_mm",
    "End error",
    "mm",
    "Mean in-plane error of the last quarter of the inserted length.",
    compute=lambda curves: float(np.mean(curves.distances[-(len(curves.distances) // 4) :])),
    headline=True,
)
