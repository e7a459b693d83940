"""Simulate a needle and its measurement, with the errors that its dataset states."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.geometry.curves import arc_length
from needlefit.inference.forward_model import predict
from needlefit.inference.likelihood.depths import shift_depths
from needlefit.inference.likelihood.observation import points_covariance, pose_modes, pose_sds
from needlefit.mechanics.shape import compute_positions
from needlefit.schemas.medium import MediumRecord

Floats = NDArray[np.float64]

FREE_POSE_SHIFT_SD_MM = 10.0
"""Standard deviation of where a shape lies whose pose is free, mm."""


def simulate_measurement(
    dataset: Dataset,
    insertion: Insertion,
    values: Mapping[str, float],
    medium: MediumRecord,
    rng: np.random.Generator,
    scale: float = 1.0,
) -> Insertion | None:
    """Return the insertion as measured if `values` (Pa, mm) were true; None if it cannot be simulated.

    The needle is simulated at depths of layers and tip that err as stated about the insertion's. Measured
    are its deflections at the arc lengths of `insertion.planar`, moved by a pose drawn from its prior and by
    the noise of the points, both `scale` times as large as stated. Where poses are free, the shape lies
    anywhere. There is none where the needle has no solution, or bends as no curve of its length does.
    """
    along = arc_length(insertion.planar)
    s = along * (insertion.depth / along[-1])
    deep = insertion.depth_sd * rng.standard_normal()
    wrong = insertion.boundary_sd * rng.standard_normal(len(insertion.boundaries))
    true, at = shift_depths(insertion, s, deep + wrong, deep)
    shape = predict(values, medium, dataset.needle, true)
    if not shape.converged:
        return None
    points = compute_positions(shape, at)
    cov = points_covariance(s, dataset.noise, insertion.sd)
    if dataset.pose == "known":
        spread = pose_modes(points) * pose_sds(insertion, dataset.noise)
        cov = cov + spread @ spread.T
    y = points[:, 1] + scale * np.linalg.cholesky(cov) @ rng.standard_normal(len(s))
    along_x = np.diff(s) ** 2 - np.diff(y) ** 2
    if np.any(along_x <= 0):
        return None
    # x such that arc lengths are kept: the model's own, of small slopes, keeps them to their fourth power
    planar = np.column_stack([points[0, 0] + np.cumsum([0.0, *np.sqrt(along_x)]), y])
    planar = _move_randomly(planar, rng) if dataset.pose == "free" else planar
    flat = np.zeros(len(s))
    world = insertion.frame.to_world(np.column_stack([planar, flat]))
    return replace(insertion, planar=planar, centerline=world, out_of_plane=flat)


def _move_randomly(planar: Floats, rng: np.random.Generator) -> Floats:
    """Return points (K, 2) turned by any angle, and moved."""
    angle = rng.uniform(0.0, 2 * np.pi)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    moved_: Floats = planar @ turn + FREE_POSE_SHIFT_SD_MM * rng.standard_normal(2)
    return moved_
