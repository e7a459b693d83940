"""A needle that does not bend."""

import numpy as np

from needlefit.inference.baselines import Baseline, make_curvature_curve

STRAIGHT = Baseline(
    "straight",
    "straight line",
    "a straight line",
    "#8a8a8a",
    curve=make_curvature_curve,
    track_basis=lambda track: np.empty((len(track.planar), 0)),
    order=1,
)
