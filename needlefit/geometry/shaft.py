"""Fit the axis on which a needle was pushed to the points of its shaft outside the tissue.

The final tangent at the entry is never used: by then the tissue has moved the needle there. Outside the
tissue nothing loads the shaft: from where it is clamped (its base, or a guide) to the entry it is the axis on
which it was pushed, plus a cubic that the tissue's pull at the entry bends,

    q(s) = q0 + q1 s + d h0(x) + g L h1(x),     x = 1 + s / L,   h0 = 3 x^2 - 2 x^3,   h1 = x^3 - x^2,

s from the entry (s < 0 outside), L the free length, d and g what the entry moved and turned. q0, q1 are the
pose; d and g take priors, since a short shaft hardly separates them from the axis; the deviation of the pose
includes this.
"""

from typing import NamedTuple

import numpy as np

from needlefit.arrays import Floats
from needlefit.geometry.curves import make_normal


class ShaftAxis(NamedTuple):
    """The axis of a shaft, and its standard deviations in any one direction across."""

    origin: Floats  # (3,); where the axis enters the tissue, mm
    direction: Floats  # (3,)
    shift_sd: float  # of the origin, mm
    angle_sd: float  # rad


def fit_shaft_axis(
    points: Floats, s: Floats, noise: Floats, free: float, bend_sd: float, turn_sd: float
) -> ShaftAxis:
    """Return the axis through points (N, 3) at `s` (N,) from the entry, mm, that err by `noise` (N, N), mm^2.

    `free` is the free length; `bend_sd` (mm) and `turn_sd` (rad) are the priors of d and g.
    """
    chord = (points[-1] - points[0]) / np.linalg.norm(points[-1] - points[0])
    sides = np.column_stack([make_normal(chord), np.cross(chord, make_normal(chord))])  # (3, 2)
    # only displacements across the chord are fitted; s gives the position along it
    line = points[-1] + (s - s[-1])[:, None] * chord
    x = 1 + s / free
    design = np.column_stack([np.ones_like(s), s, 3 * x**2 - 2 * x**3, free * (x**3 - x**2)])
    whitened = np.linalg.solve(noise, design)
    prior = np.diag([0.0, 0.0, bend_sd**-2, turn_sd**-2])
    covariance = np.linalg.inv(design.T @ whitened + prior)
    fitted = covariance @ whitened.T @ ((points - line) @ sides)  # (4, 2)
    direction = chord + sides @ fitted[1]
    origin = points[-1] - s[-1] * chord + sides @ fitted[0]
    shift_sd, angle_sd = np.sqrt(np.diag(covariance)[:2])
    return ShaftAxis(origin, direction / np.linalg.norm(direction), float(shift_sd), float(angle_sd))
