"""Errors of a pose: what they do to deflections, their deviations, and which of them are free."""

import numpy as np

from needlefit.arrays import Floats, pad_axis
from needlefit.datasets.insertion import Insertion, Noise, find_pose
from needlefit.datasets.noise import MEAN_NORM_PER_SD
from needlefit.inference.likelihood.stated_errors import StatedErrors

#: degree of the polynomial whose slope is taken for the needle's: that of the noisy points would be rough
SLOPE_DEGREE = 3


def pose_modes(measured: Floats, slopes: Floats | None = None) -> Floats:
    """Return the change of deflections along y, and then z, by unit errors of a pose, per mm and rad.

    Along y (K, 3): by a shift across, a turn and a shift along. Of points in space (2 K, 6): further by a
    shift and a turn out of that plane, and by a turn about x, the roll. Turns are about the entry, x = 0,
    wherever the points (K, 2) or (K, 3) begin: what is uncertain is the pose of the constraint frame there.
    The needle's `slopes` (K, 1) or (K, 2) are by default those of cubics through the points.
    """
    count, directions = len(measured), measured.shape[1] - 1
    x, y, z = pad_axis(measured, 3).T
    slope_y, slope_z = (
        [_fit_slope(x, values) for values in (y, z)] if slopes is None else pad_axis(slopes, 2).T
    )
    ones, nothing = np.ones(count), np.zeros(count)
    along_y = [ones, x, -slope_y, nothing, nothing, -z]
    along_z = [nothing, nothing, -slope_z, ones, x, y]
    modes = np.concatenate([np.column_stack(along_y), np.column_stack(along_z)])
    return modes[: directions * count, : 3 * directions]


def _fit_slope(x: Floats, y: Floats) -> Floats:
    """Return the slopes (K,) of the cubic through points."""
    degree = min(SLOPE_DEGREE, len(x) - 1)
    # Polynomial.fit scales x to [-1, 1] itself: np.polyfit on mm would be badly conditioned
    return np.asarray(np.polynomial.Polynomial.fit(x, y, degree).deriv()(x))


def pose_sds(insertion: Insertion, noise: Noise, directions: int = 1) -> Floats:
    """Return the prior standard deviations (3,), in 2 directions (6,), of a known pose: mm and rad.

    They are in the order of `pose_modes`. A registration error of mean length m, isotropic in space, has
    m / sqrt(8 / pi) per axis. It and the row's pose deviation are often one error stated twice: the larger
    one counts, as in the noise floor.
    """
    shift, angle = (
        max(insertion.pose_shift_sd, noise.registration_mean / MEAN_NORM_PER_SD),
        insertion.pose_angle_sd,
    )
    return np.array([shift, angle, shift, shift, angle, insertion.roll_sd])[: 3 * directions]


#: factors of deflections (y, z) by which a small turn about x moves them
QUARTER_TURN = np.array([[0.0, -1.0], [1.0, 0.0]])
#: columns of `pose_modes` that are shifts across, in the plane and out of it
ACROSS = (0, 3)


def split_pose_modes(insertion: Insertion, modes: Floats, sds: Floats) -> tuple[Floats, Floats]:
    """Return the change (C, c) by a deviation of what is known of a pose, and (C, f) by a unit of the rest.

    `modes` (C, c + f) are the changes by unit errors of a pose in the world, `sds` their deviations. Where
    the direction alone is known, shifts across are the rest.
    """
    rest = [n for n in ACROSS if n < len(sds) and find_pose("known", insertion) == "direction"]
    return np.delete(modes * sds, rest, axis=1), modes[:, rest]


def list_pose_modes(
    insertion: Insertion, errors: StatedErrors, measured: Floats, slopes: Floats | None = None
) -> tuple[Floats, Floats]:
    """Return the changes (C, c) by errors of a known pose, and their deviations (c,), of what is compared."""
    return pose_modes(measured, slopes), pose_sds(insertion, errors.noise, errors.dataset.directions)


def turn_about_x(points: Floats, angle: Floats | float) -> Floats:
    """Return points (..., K, 3) turned about C's x axis by angles (...,), rad."""
    cos, sin = (np.asarray(part)[..., None] for part in (np.cos(angle), np.sin(angle)))
    x, y, z = np.moveaxis(points, -1, 0)
    return np.stack([x, cos * y - sin * z, sin * y + cos * z], axis=-1)


def draw_rolls(roll_sd: float, directions: int, count: int, rng: np.random.Generator) -> Floats:
    """Draw errors of the roll (count,), rad; none are drawn where y alone is compared: they move nothing."""
    return roll_sd * rng.standard_normal((directions - 1, count)).sum(axis=0)
