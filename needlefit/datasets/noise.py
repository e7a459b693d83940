"""Measurement noise: the noise floor that perfect parameters would show."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from needlefit.arrays import Floats, pad_axis
from needlefit.datasets.insertion import Dataset, Insertion, InsertionPose, Noise, find_free_reach, find_pose
from needlefit.geometry.curves import COMPARISON_POINTS, Quantity, compare_curves
from needlefit.geometry.frames import align_lateral, align_rigid
from needlefit.metrics import METRICS, list_metrics

# mean length of a 3-D normal vector of unit standard deviation per axis
MEAN_NORM_PER_SD = math.sqrt(8 / math.pi)
# largest distance (mm) from the plane of first contact at which a curve begins that was cut there
CUT_TOLERANCE_MM = 1e-3
# Mean error over draws of the stated noise, by metric; NaN where a dataset states no noise.
NoiseFloor = Mapping[str, float]


def estimate_noise_floor(
    dataset: Dataset,
    insertion: Insertion,
    rng: np.random.Generator,
    draws: int = 200,
    quantities: Sequence[Quantity] = ("places",),
    *,
    at_depths: bool = False,
) -> NoiseFloor:
    """Return the errors of the measured curve against itself, measured again with the stated noise.

    The errors are those of `draw_measurement_errors`, by the metrics of some quantities. Curves are compared
    as in a study: `at_depths` of their own, or at equal fractions of arc length, shifted across where the
    direction alone is known, or, for free shapes, by arc length from the tip after alignment. Uncertain layer
    depths are not in it.
    """
    metrics = [metric for metric in list_metrics(*quantities) if metric.has_floor]
    displaced = draw_measurement_errors(dataset, insertion, rng, draws, insertion.directions)
    if displaced is None:
        return dict.fromkeys((metric.name for metric in metrics), math.nan)
    whole = insertion.points
    again = whole + pad_axis(displaced, 3)
    pose = find_pose(dataset.pose, insertion)
    free = find_free_reach(dataset.drop_proximal, insertion) if pose == "free" else None
    if at_depths:
        again[..., 0] = whole[:, 0]
    if pose == "tracker":
        again = align_lateral(again, whole)  # the best shifts and slopes are taken off
    pairs = [(curve, whole) for curve in again]
    if not at_depths:
        along = insertion.measure_arc("plane")
        pairs = list(map(_prepare_comparison(whole, along, pose, free), again))
    curves, floor = [compare_curves(*pair, dataset.compared) for pair in pairs], dict[str, float]()
    for metric in metrics:
        with METRICS.plugin_error_context(metric.name):
            has_metric = curves[0].is_curve or not metric.of_curve
            errors = [metric.compute(curve) for curve in curves] if has_metric else math.nan
            floor[metric.name] = float(np.mean(errors))
    return floor


class TipErrors(NamedTuple):
    """The stated error of a measured tip, as standard deviations in any one direction across, mm."""

    whole: float
    registered: float  #: the part of it that needles may have in common, as they may share a registration


def state_tip_errors(dataset: Dataset, insertion: Insertion) -> TipErrors:
    """Return the stated error of the tip of an insertion; 0 where none is stated.

    An alignment takes a part of the errors away: where there is one they are stated too large. Needles with
    a scan of their own have no registration in common; of others it is not known whether they have.
    """
    noise, pose = dataset.noise.of(insertion), find_pose(dataset.pose, insertion)
    correlated = noise.correlated_sd if insertion.sd is None else float(insertion.sd[-1])
    turned = (
        insertion.pose_angle_sd * float(insertion.points[-1, 0]) if pose in ("known", "direction") else 0.0
    )
    shift = max(noise.registration_mean / MEAN_NORM_PER_SD, insertion.pose_shift_sd)
    shift = shift if pose == "known" else 0.0
    scans = [insertion.patient for insertion in dataset.insertions]
    alone = sum(np.array_equal(scan.origin, insertion.patient.origin) for scan in scans) == 1
    whole = math.hypot(noise.point_sd, correlated, turned, shift)
    return TipErrors(whole, 0.0 if alone else shift)


def draw_measurement_errors(
    dataset: Dataset, insertion: Insertion, rng: np.random.Generator, draws: int, directions: int
) -> Floats | None:
    """Draw by how much each measured point errs, (draws, N, 1 + directions) mm; None if no noise is stated.

    Every draw adds independent and correlated noise to each point and, with a known pose, moves the
    curve: by an isotropic shift, of which the plane sees two of three components, and by the row's angle.
    A curve that was cut in the plane of first contact shows no shift along the entry axis.
    The shift is the larger of the stated registration error and the row's pose deviation, which are
    often the same error stated twice.
    """
    noise, curve = dataset.noise.of(insertion), insertion.points
    shift = max(noise.registration_mean / MEAN_NORM_PER_SD, insertion.pose_shift_sd)
    angle = insertion.pose_angle_sd
    if find_pose(dataset.pose, insertion) in ("free", "tracker"):
        shift = angle = 0.0
    if not (shift or angle or noise.point_sd or noise.correlated_sd):
        return None
    cut = abs(float(curve[0, 0])) < CUT_TOLERANCE_MM
    shifts = np.array([0.0 if cut else shift, shift])
    points = draw_point_noise(insertion.measure_arc("plane"), noise, rng, draws)
    drawn = points + displace_by_pose(curve, shifts, angle, rng.normal(size=(draws, 3)))
    # along z they are drawn after those in the plane, which do not depend on them
    along_z = (_draw_errors_along_z(dataset, insertion, rng, draws) for _ in range(1, directions))
    return np.concatenate([drawn, *along_z], axis=-1)


def _draw_errors_along_z(
    dataset: Dataset, insertion: Insertion, rng: np.random.Generator, draws: int
) -> Floats:
    """Draw by how much each measured point errs out of the plane, (draws, N, 1) mm."""
    s = insertion.measure_arc("plane")
    points = draw_point_noise(s, dataset.noise.of(insertion), rng, draws)[..., :1]
    if find_pose(dataset.pose, insertion) in ("free", "tracker"):
        return points
    shift = max(dataset.noise.registration_mean / MEAN_NORM_PER_SD, insertion.pose_shift_sd)
    normal = rng.normal(size=(2, draws, 1, 1))
    return points + shift * normal[0] + insertion.pose_angle_sd * normal[1] * s[:, None]


def draw_point_noise(s: Floats, noise: Noise, rng: np.random.Generator, draws: int) -> Floats:
    """Draw noise (draws, N, 2), mm, of points at arc lengths (N,): an independent and a correlated part."""
    shape = (draws, len(s), 2)
    independent = noise.point_sd * rng.normal(size=shape)
    # A Cholesky root of the correlation matrix turns independent draws into correlated ones.
    root = noise.correlated_sd * np.linalg.cholesky(noise.correlate(s))
    return independent + root @ rng.normal(size=shape)


def displace_by_pose(curve: Floats, shifts: Floats, angle: float, normal: Floats) -> Floats:
    """Return the displacement (draws, N, 2) of small motions about C's origin, from `normal` (draws, 3)."""
    perpendicular = np.column_stack([-curve[:, 1], curve[:, 0]])  # (N, 2)
    return shifts * normal[:, None, :2] + angle * normal[:, 2, None, None] * perpendicular


def _prepare_comparison(
    curve: Floats, along: Floats, pose: InsertionPose, length: float | None
) -> Callable[[Floats], tuple[Floats, Floats]]:
    """Return what takes a curve (N, 3) that was measured again to the points of `curve` and its own, (K, 3).

    At equal fractions, after a shift across where the direction alone is known, or along `length` from the
    tip after alignment in the plane. The arc lengths `along` (N,) are those of the needle: noise of its
    points changes none of them.
    """
    s = along[-1] - np.linspace(along[-1] if length is None else length, 0, COMPARISON_POINTS)

    def sample(points: Floats) -> Floats:
        return np.column_stack([np.interp(s, along, axis) for axis in points.T])

    def place(again: Floats) -> tuple[Floats, Floats]:
        measured, moved = sample(again), sampled
        if length is not None:
            aligned = align_rigid(sampled[:, :2], measured[:, :2])
            moved = np.column_stack([aligned, sampled[:, 2]])
        elif pose == "direction":
            moved = align_lateral(sampled, measured, terms=1)
        return moved, measured

    sampled = sample(curve)
    return place
