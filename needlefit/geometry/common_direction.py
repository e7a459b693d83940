"""The one direction in which several curves may have been inserted."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from needlefit.arrays import Floats
from needlefit.geometry.frames import normalize, to_unit
from needlefit.geometry.measured_curve import measure_curve

MIN_FITTED_NEEDLES = 3  # smallest number of needles to which a common direction is fitted
MIN_CURVE_POINTS = 5  # smallest number of points of a needle that counts in the common direction
# SD of the length (mm) whose product with a needle's curvature is its turn at the entry, toward its bevel
TURN_LENGTH_SD_MM = 80.0
# SD of one needle's direction at the entry (rad), before the scatter of all is known
TANGENT_SD_RAD = math.radians(0.5)
MIN_ONE_WAY = 0.9  # length of the mean of unit curvatures beyond which all needles bend to one side


class FittedDirection(NamedTuple):
    """A direction in which all needles may have been inserted; standard deviations across it, degrees."""

    vector: Floats  # (3,)
    sd_deg: float
    scatter_deg: float  # of single needles


def fit_direction(lines: Sequence[Floats]) -> FittedDirection | None:
    """Return the direction of insertion that fits curves (N, 3) best; None of few or short ones.

    Tissue has turned each needle at its entry toward its bevel, in proportion to its curvature. The tangents
    at the entries are therefore the direction plus the curvatures times one length, by least squares.
    """
    kept = [line for line in lines if len(line) >= MIN_CURVE_POINTS]
    if (count := len(kept)) < MIN_FITTED_NEEDLES:
        return None
    fits = [np.polyfit(measure_curve(line).s, line, 2) for line in kept]
    tangents, curvatures = to_unit(np.array(fits)[:, 1]), 2.0 * np.array(fits)[:, 0]
    chords = to_unit(np.array([line[-1] - line[0] for line in kept]))
    # of one size: what single curvatures differ by is mostly their error, which is that of the tangents, too
    size = float(np.median(np.linalg.norm(curvatures, axis=1)))
    toward = to_unit(curvatures)
    # bevels that face one way do not separate direction and turn: then the turn is an error of the direction
    is_one_way = float(np.linalg.norm(toward.mean(axis=0))) > MIN_ONE_WAY
    precision, values = np.diag([0.0, 0.0, 0.0, TURN_LENGTH_SD_MM**-2]), tangents.ravel()
    sd = TANGENT_SD_RAD
    for _ in range(3):  # first with a scatter that is usual, then with that found, and with the sides of tips
        turned = np.zeros_like(toward) if is_one_way else size * toward
        # rows: x, y and z of each tangent; columns: the direction, and the length
        design = np.concatenate([np.tile(np.eye(3), (count, 1)), turned.reshape(-1, 1)], axis=1)
        covariance = np.linalg.inv(design.T @ design / sd**2 + precision)
        estimate = covariance @ design.T @ values / sd**2
        # two directions across each needle, less those of the mean and the length
        sd = math.sqrt(float(np.sum((values - design @ estimate) ** 2)) / (2 * count - 3)) or TANGENT_SD_RAD
        direction = normalize(estimate[:3])
        toward = to_unit(chords - (chords @ direction)[:, None] * direction)
    across = float(np.linalg.eigvalsh(covariance[:3, :3])[-1])
    across += (size * TURN_LENGTH_SD_MM) ** 2 if is_one_way else 0.0
    return FittedDirection(direction, math.degrees(math.sqrt(across)), math.degrees(sd))
