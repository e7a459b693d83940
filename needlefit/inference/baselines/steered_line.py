"""A straight line with the slope of the other runs whose guide moved, or rested, as in this one.

A controller that steers for a straight path gives its runs one slope, which those at rest do not have.
"""

import numpy as np

from needlefit.inference.baselines import Baseline, make_curvature_curve

STEERED_LINE = Baseline(
    "steered_line",
    "straight line, slope of runs alike",
    "a straight line with the slope of the other runs under a guide that moved, or rested, alike",
    "#4d4d4d",
    curve=make_curvature_curve,
    track_basis=lambda track: np.empty((len(track.planar), 0)),
    track_slope="alike",
    tracks_only=True,
    order=6,
)
