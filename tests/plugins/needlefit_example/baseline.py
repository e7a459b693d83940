"""A baseline: a parabola toward the bevel, y = c x^2."""

import numpy as np

from needlefit.inference.baselines import Baseline

PARABOLA = Baseline(
    "parabola",
    "plain parabola",
    "a plain parabola",
    "#AA3377",
    curve=lambda c, insertion: lambda s: np.column_stack([s, insertion.side * c[0] * np.maximum(s, 0) ** 2]),
    scales=(0.01,),
)
