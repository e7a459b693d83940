"""An empirical kernel: how the tip of a track follows each move of the guide, on top of a parabola.

A move by g at depth e moves the tip at depth d by g (a exp(-e / L) + (d - e) (b exp(-e / L) + c)): it pushes
the tip aside and turns it, less where the needle is held by more tissue. a, b and c are estimated, as are the
curvature toward the bevel and the slope of the session; L is stated.
"""

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion, TipTrack
from needlefit.inference.baselines import Baseline, make_curvature_curve

DECAY_MM = 20.0  #: L: about the length within which a needle bends at an entry, mm


def make_kernel_basis(track: Insertion) -> Floats:
    """Return the deflections (n, 4) of a track's readings by unit curvature, a, b and c."""
    depth = track.planar[:, 0]
    bow = track.side * depth**2 / 2
    guide = track.guide if isinstance(track, TipTrack) else np.zeros(len(depth))
    # the guide moves before the step that ends at a reading
    moves, at = np.diff(guide), depth[:-1]
    passed = np.where(depth[:, None] > at, depth[:, None] - at, 0.0)  # (n, n - 1)
    reached, near = (passed > 0) * moves, np.exp(-at / DECAY_MM)
    return np.column_stack([bow, reached @ near, (passed * moves) @ near, passed @ moves])


GUIDE_KERNEL = Baseline(
    "guide_kernel",
    "empirical response to the guide",
    "an empirical response of the tip to moves of the guide",
    "#882255",
    curve=make_curvature_curve,
    track_basis=make_kernel_basis,
    track_slope="session",
    tracks_only=True,
    order=7,
)
