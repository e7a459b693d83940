"""What a small error of the pose in the plane does to deflections, and how large it may be.

A shift across moves all points alike, a turn about the entry moves them by their distance from it, and a
shift along the entry axis moves the curve past itself: a point then differs by the slope.
"""

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.insertion import Insertion, Noise
from needlefit.datasets.noise import MEAN_NORM_PER_SD

Floats = NDArray[np.float64]

SMOOTH = 3
"""Degree of the polynomial whose slope is taken for the needle's: that of the noisy points would be rough."""


def modes(measured: Floats) -> Floats:
    """Return what a unit shift across, turn, and shift along do to the deflections of points (K, 2): (K, 3).

    Per mm, per rad, per mm.
    """
    x = measured[:, 0] - measured[0, 0]
    degree = min(SMOOTH, len(x) - 1)
    slope = np.polynomial.Polynomial.fit(x, measured[:, 1], degree).deriv()(x)
    return np.column_stack([np.ones(len(x)), x, -slope])


def pose_sds(insertion: Insertion, noise: Noise) -> Floats:
    """Return the prior standard deviations (3,) of a pose that is known: mm, rad, mm, as `modes`.

    A registration error of mean length m, isotropic in space, has m / sqrt(8 / pi) per axis. It and the
    row's pose deviation are often one error told twice: the larger one counts, as in the noise floor.
    """
    shift = max(insertion.pose_shift_sd, noise.registration_mean / MEAN_NORM_PER_SD)
    return np.array([shift, insertion.pose_angle_sd, shift])
