"""The noise floor: the errors that perfect parameters would still show."""

import math
from dataclasses import dataclass

import numpy as np

from needlefit.datasets.insertion import Dataset, Floats, Insertion, Noise
from needlefit.datasets.reach import reach_from_tip
from needlefit.geometry.compare import STATIONS, CurveErrors, compare
from needlefit.geometry.curves import arc_length, at_arc, resample
from needlefit.geometry.frames import align_rigid

MEAN_OF_NORM = math.sqrt(8 / math.pi)
"""Mean length of a 3-D normal vector of unit standard deviation per axis."""

CUT = 1e-3
"""A curve that begins this near to the plane of first contact, mm, was cut there."""


@dataclass(frozen=True)
class NoiseFloor:
    """Mean errors over draws of the stated noise, mm; NaN where a dataset states none."""

    median_err_mm: float
    ipe_mean_mm: float
    ipe_max_mm: float
    te_mm: float


def noise_floor(
    dataset: Dataset, insertion: Insertion, rng: np.random.Generator, draws: int = 200
) -> NoiseFloor:
    """Return the errors of the measured curve against itself, measured again with the stated noise.

    Every draw adds independent and correlated noise to each point and, with a known pose, moves the
    curve: by an isotropic shift, of which the plane sees two of three components, and by the row's angle.
    A curve that was cut in the plane of first contact shows no shift along the entry axis.
    The shift is the larger of the stated registration error and the row's pose deviation, which are
    often one error told twice. Curves are compared as in a study: at equal fractions of arc length, or,
    for free shapes, by arc length from the tip after alignment. Uncertain layer depths are not in it.
    """
    noise = dataset.noise
    shift = max(noise.registration_mean / MEAN_OF_NORM, insertion.pose_shift_sd)
    angle = insertion.pose_angle_sd
    if dataset.pose == "free":
        shift = angle = 0.0
    if not (shift or angle or noise.point_sd or noise.correlated_sd):
        return NoiseFloor(math.nan, math.nan, math.nan, math.nan)
    curve = insertion.planar
    moved = (
        curve
        + point_noise(curve, noise, rng, draws)
        + _pose_noise(curve, _shifts(curve, shift), angle, rng.normal(size=(draws, 3)))
    )
    free = reach_from_tip(dataset.drop_proximal, insertion) if dataset.pose == "free" else None
    errors = [_compare(curve, again, free) for again in moved]
    return NoiseFloor(
        median_err_mm=float(np.mean([e.median for e in errors])),
        ipe_mean_mm=float(np.mean([e.mean for e in errors])),
        ipe_max_mm=float(np.mean([e.maximum for e in errors])),
        te_mm=float(np.mean([e.te for e in errors])),
    )


def point_noise(curve: Floats, noise: Noise, rng: np.random.Generator, draws: int) -> Floats:
    """Return noise of the points of `curve` (N, d): independent, and correlated as exp(-|ds| / length).

    Shape (draws, N, d), mm.
    """
    s = arc_length(curve)
    independent = noise.point_sd * rng.normal(size=(draws, *curve.shape))
    decay = np.exp(-np.abs(s[:, None] - s) / noise.correlation_length)  # (N, N)
    root = noise.correlated_sd * np.linalg.cholesky(decay)
    drawn: Floats = independent + root @ rng.normal(size=(draws, *curve.shape))
    return drawn


def _shifts(curve: Floats, shift: float) -> Floats:
    """Return the deviations (2,) of a shift along and across the entry axis that a curve (N, 2) can show."""
    cut = abs(float(curve[0, 0])) < CUT
    return np.array([0.0 if cut else shift, shift])


def _pose_noise(curve: Floats, shifts: Floats, angle: float, normal: Floats) -> Floats:
    """Return the displacement (draws, N, 2) of small motions about C's origin, from `normal` (draws, 3)."""
    turned = np.column_stack([-curve[:, 1], curve[:, 0]])  # (N, 2)
    displaced: Floats = shifts * normal[:, None, :2] + angle * normal[:, 2, None, None] * turned
    return displaced


def _compare(curve: Floats, again: Floats, length: float | None) -> CurveErrors:
    """Compare at equal fractions, or along `length` from the tip after alignment."""
    if length is None:
        fractions = np.linspace(0, 1, STATIONS)
        return compare(resample(curve, fractions), resample(again, fractions))
    from_tip = np.linspace(length, 0, STATIONS)
    sampled, measured = (at_arc(c, arc_length(c)[-1] - from_tip) for c in (curve, again))
    return compare(align_rigid(sampled, measured), measured)
