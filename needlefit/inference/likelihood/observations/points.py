"""Points along the needle, measured at the end of the insertion, in a pose that is known or not.

Equations: docs/inference.md, sections 1 to 3.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from needlefit.arrays import Floats
from needlefit.datasets.insertion import (
    DEFAULT_MEASUREMENT,
    Dataset,
    Insertion,
    Noise,
    select_compared_places,
)
from needlefit.geometry.curves import select_compared
from needlefit.geometry.frames import make_tracker_columns
from needlefit.geometry.smoothing_spline import fit_matrices, make_knots
from needlefit.inference.likelihood.compared_points import rotate_to_entry_axes
from needlefit.inference.likelihood.observation import Observation, complete_observation
from needlefit.inference.likelihood.observations import (
    OBSERVATIONS,
    ObservationType,
    TrueNeedle,
    has_sections,
)
from needlefit.inference.likelihood.pose_errors import (
    list_pose_modes,
    pose_modes,
    pose_sds,
    split_pose_modes,
    turn_about_x,
)
from needlefit.inference.likelihood.stated_errors import Discrepancy, StatedErrors, points_covariance
from needlefit.schemas.dataset import MeasurementRecord

FREE_POSE_SHIFT_SD_MM = 10.0  #: SD (mm) of where a simulated shape lies whose pose is free


def points_operator(measurement: MeasurementRecord, s: Floats) -> Floats | None:
    """Return the matrix (R, K) that smooths deflections at the arc lengths `s` (K,) of stored points.

    Of a spline it leads to its coefficients; None where the points are the needle's own.
    """
    if measurement.operator == "spline" and measurement.knot_spacing_mm is not None:
        knots = make_knots(s[0], s[-1], measurement.knot_spacing_mm)
        return fit_matrices(s, np.ones(len(s)), knots).operator
    if measurement.operator == "gaussian" and measurement.width_mm is not None:
        # every point stands for the stretch halfway to its neighbours
        weights = np.gradient(s) * np.exp(-0.5 * ((s[:, None] - s) / measurement.width_mm) ** 2)
        return weights / weights.sum(axis=1, keepdims=True)
    return None


@dataclass(frozen=True)
class _Points(ObservationType):
    def observe(self, insertion: Insertion, errors: StatedErrors) -> Observation:
        """Return the observation of an insertion by its points; DataError if no noise is stated."""
        dataset, noise = errors.dataset, errors.noise
        measurement = dataset.measurement if errors.smoothed else DEFAULT_MEASUREMENT
        along, s = select_compared_places(dataset.pose, dataset.drop_proximal, insertion, dataset.compared)
        arc, axes = insertion.measure_arc(dataset.compared), insertion.points.T[: 1 + dataset.directions]
        measured = np.column_stack([np.interp(along, arc, axis) for axis in axes])
        measured = measured if dataset.pose == "known" else rotate_to_entry_axes(measured)
        sd = None if insertion.sd is None else np.interp(along, arc, insertion.sd)
        noise = _share_noise(insertion, noise, s)
        cov, free = points_covariance(s, noise, sd), make_tracker_columns(measured[:, 0])  # across, and turn
        if measurement.bias_sd_mm is not None and measurement.bias_length_mm is not None:
            # An unknown operator: a smooth bias that all insertions of a fit share. Its covariance counts as
            # often as there are insertions, so that together they do not average it away.
            size = measurement.bias_sd_mm * math.sqrt(errors.insertions)
            cov = cov + Discrepancy(size, measurement.bias_length_mm).covariance(s)
        cov = cov if errors.model_error is None else cov + errors.model_error.covariance(s)
        operator = points_operator(measurement, s)
        if operator is not None and measurement.operator == "spline":
            cov, free = operator @ cov @ operator.T, operator @ free
        cov = block_diag(*[cov] * dataset.directions)
        operator = None if operator is None else block_diag(*[operator] * dataset.directions)
        pose = np.empty((len(cov), 0))
        if dataset.pose == "known":
            modes, sds = list_pose_modes(insertion, errors, measured)
            pose, free = (_apply(operator, part) for part in split_pose_modes(insertion, modes, sds))
        # else across and turn alone: arc lengths are counted from the tip, so that nothing shifts along them
        shift = None
        if measurement.operator == "gaussian":  # what is stored was smoothed already, the simulation was not
            stored = measured[:, 1:].T.ravel()
            shift = _apply(operator, stored) - stored
        return complete_observation(insertion, errors, s, measured, cov, pose, free, operator, shift)

    def measure(self, dataset: Dataset, insertion: Insertion, needle: TrueNeedle) -> Insertion | None:
        """Return the insertion with points at the arc lengths of its own; None where the needle bends as no
        curve of its length does. Where poses are free, the shape lies anywhere.
        """
        if has_sections(dataset, insertion):
            return OBSERVATIONS["sections"].measure(dataset, insertion, needle)
        directions, along = dataset.directions, insertion.measure_arc(dataset.compared)
        s, noise = along * (insertion.depth / along[-1]), dataset.noise.of(insertion)
        roll = float(insertion.roll_sd * needle.draw(directions - 1).sum())
        points = select_compared(turn_about_x(needle.read(s), roll), dataset.compared)
        # x such that arc lengths are kept: the model's own, of small slopes, keeps them to their fourth
        # power. They are those of the needle, whatever the noise of its points.
        along_x = np.diff(s) ** 2 - np.sum(np.diff(points[:, 1:], axis=0) ** 2, axis=1)
        if np.any(along_x <= 0):
            return None
        cov = needle.scale**2 * points_covariance(s, noise, insertion.sd)
        cov = block_diag(*[cov] * directions)
        if dataset.pose == "known":
            # the roll, which turned the needle as a whole, is none of these
            spread = pose_modes(points)[:, :5] * pose_sds(insertion, noise, directions)[:5]
            cov = cov + spread @ spread.T
        across = points[:, 1:] + needle.draw_errors(cov).reshape(directions, -1).T
        planar = np.column_stack([points[0, 0] + np.cumsum([0.0, *np.sqrt(along_x)]), across[:, 0]])
        if dataset.pose == "free" and needle.rng is not None:  # turned by any angle, and moved
            angle = needle.rng.uniform(0.0, 2 * np.pi)
            turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
            planar = planar @ turn + FREE_POSE_SHIFT_SD_MM * needle.draw(2)
        return insertion.with_points(np.column_stack([planar, across[:, 1:]]))


def _share_noise(insertion: Insertion, noise: Noise, s: Floats) -> Noise:
    """Return the noise with which points at `s` (K,) count as often as the independent ones among them."""
    if insertion.independent is None:
        return noise
    independent = insertion.independent * float(np.ptp(s)) / insertion.depth
    return replace(noise, point_sd=noise.point_sd * math.sqrt(max(1.0, len(s) / independent)))


def _apply(operator: Floats | None, values: Floats) -> Floats:
    return values if operator is None else operator @ values


POINTS = _Points("points")
