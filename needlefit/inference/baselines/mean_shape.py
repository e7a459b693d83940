"""The mean of the tuning shapes: how much they turn toward the bevel, by distance from the tip.

Its coefficients are the turns, rad, between chords of `CHORD_MM`, the first one at the tip; each is the mean
over the shapes that reach as far. A curve begins along the insertion axis. Nothing is searched.
"""

from collections.abc import Sequence

import numpy as np
import scipy

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion, Pose
from needlefit.inference.baselines import Baseline
from needlefit.inference.likelihood.compared_points import Curve
from needlefit.inference.likelihood.observations import select_points

#: length of a chord (mm): short beside the bends of needles, long beside the noise of their points
CHORD_MM = 5.0
STEP_MM = 0.25  #: step (mm) of the integration along the curve


def average_turns(pose: Pose, drop: float, insertions: Sequence[Insertion]) -> Floats:
    """Return the mean turn (P,) at each multiple of `CHORD_MM` from the tip, rad."""
    all_turns = [_find_turns(pose, drop, insertion) for insertion in insertions]
    longest = max(len(turns) for turns in all_turns)
    padded = np.array(
        [np.pad(turns, (0, longest - len(turns)), constant_values=np.nan) for turns in all_turns]
    )
    return np.nanmean(padded, axis=0)


def _find_turns(pose: Pose, drop: float, insertion: Insertion) -> Floats:
    """Return the turns of one shape; where the pose is known the last one is from the entry's axis."""
    points = select_points(pose, drop, insertion)
    length = float(points.s[-1] - points.s[0])
    to_tip = np.arange(0.0, length, CHORD_MM)
    if len(to_tip) < 3:  # shorter than two chords: it has no turn
        return np.zeros(1)
    places = points.s[-1] - to_tip
    chords = -np.diff([np.interp(places, points.s, axis) for axis in points.measured.T], axis=1).T
    angles = insertion.side * np.arctan2(chords[:, 1], chords[:, 0])
    turns = -np.diff(angles)
    if pose == "free":
        return turns
    # the heading of the last chord was gained between the entry and its middle
    rest = length - (to_tip[-1] - CHORD_MM / 2)
    return np.append(turns, angles[-1] * CHORD_MM / rest)


def make_mean_curve(turns: Sequence[float], insertion: Insertion) -> Curve:
    """Return the curve of an insertion, from the entry along the insertion axis."""
    along = np.linspace(0.0, insertion.depth, int(np.ceil(insertion.depth / STEP_MM)) + 1)
    # the curvature of the ends goes on to the tip and to the entry
    steps = [turns[0] / 2, *turns, turns[-1] * insertion.depth / CHORD_MM]
    middles = np.array([0.0, *(CHORD_MM * (0.5 + np.arange(len(turns) + 1)))])
    middles = np.append(middles, middles[-1] + insertion.depth)
    turned = np.interp(insertion.depth - along, middles, np.concatenate([[0.0], np.cumsum(steps)]))
    angle = insertion.side * (turned[0] - turned)
    x, y = scipy.integrate.cumulative_trapezoid([np.cos(angle), np.sin(angle)], along, initial=0)

    def curve(s: Floats) -> Floats:
        # before the entry the needle is straight
        return np.column_stack([np.interp(s, along, x) + np.minimum(s, 0.0), np.interp(s, along, y)])

    return curve


MEAN_SHAPE = Baseline(
    "mean_shape",
    "mean of the tuning shapes",
    "the mean of the tuning shapes",
    "#6A3D9A",
    curve=make_mean_curve,
    fit=lambda pose, drop, insertions: average_turns(pose, drop, insertions).tolist(),
    of_curve=True,
    order=5,
)
