"""The tip alone: its deflection from the entry line at one depth, in a known pose.

Its place along the needle is not measured: it is compared at its depth, so that its error is that across.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion, Pose, find_pose
from needlefit.inference.compared_points import ComparedPoints
from needlefit.inference.likelihood.observation import (
    Observation,
    StatedErrors,
    complete_observation,
    list_pose_modes,
    points_covariance,
    split_pose_modes,
    whiten,
)
from needlefit.inference.likelihood.observations import ObservationType
from needlefit.mechanics.batch import Jacobians, NeedleShapes
from needlefit.mechanics.shape import NeedleShape
from needlefit.schemas.compared import Compared


@dataclass(frozen=True)
class _Tip(ObservationType):
    def select_points(
        self, pose: Pose, drop: float, insertion: Insertion, stations: int, compared: Compared
    ) -> ComparedPoints:
        """Return the entry, where the needle has no deflection, and the tip."""
        s = np.array([0.0, insertion.depth])
        measured = np.column_stack([s, np.vstack([np.zeros(2), insertion.points[-1, 1:]])])
        return ComparedPoints(s, measured, find_pose(pose, insertion), compared)

    def read_points(self, shape: NeedleShape, s: Floats) -> Floats:
        """Return the deflections, each at its beam coordinate."""
        points = super().read_points(shape, s)
        points[:, 0] = s
        return points

    def read_batch_points(self, shapes: NeedleShapes, s: Floats) -> Floats:
        """Return `read_points` of many simulations."""
        points = super().read_batch_points(shapes, s)
        points[..., 0] = s
        return points

    def read_batch_derivatives(self, shapes: NeedleShapes, jacobians: Jacobians, s: Floats) -> Floats:
        """Return the derivatives of `read_batch_points`."""
        derivatives = super().read_batch_derivatives(shapes, jacobians, s)
        derivatives[:, :, 0] = 0.0
        return derivatives

    def observe(self, insertion: Insertion, errors: StatedErrors) -> Observation:
        """Return the observation of the tip, whose slope is taken as that of constant curvature."""
        s, count = np.array([insertion.depth]), errors.dataset.directions
        across = insertion.points[-1:, 1 : 1 + count]  # (1, 1 or 2)
        cov = points_covariance(s, errors.noise, None if insertion.sd is None else insertion.sd[-1:])
        if errors.model_error is not None:
            cov = cov + errors.model_error.covariance(s)
        cov, measured = block_diag(*[cov] * count), np.column_stack([s, across])
        modes, sds = list_pose_modes(insertion, errors, measured, 2 * across / s)
        pose, free = split_pose_modes(insertion, modes, sds)
        return complete_observation(insertion, errors, s, measured, cov, pose, free)

    def observe_beside(self, insertion: Insertion, errors: StatedErrors) -> Observation:
        """Return the observation of a tip beside a shape, from a line of insertion that errs by itself."""
        tip = insertion.tip
        assert tip is not None
        y, z, sd = np.where(np.isnan(tip), [0.0, 0.0, errors.noise.point_sd], tip).tolist()
        alone = replace(
            insertion.with_points(np.array([np.zeros(3), [insertion.depth, y, z]])),
            observed="tip",
            pose_source="stage",
            sd=None,
            curvature=None,
            tip=None,
            independent=None,
        )
        # a scale of the noise counts for its pose, too: joined observations have no curves of a pose
        likelihood = errors.likelihood.model_copy(update={"noise_scale": 1.0})
        noise = replace(errors.noise, point_sd=sd, correlated_sd=0.0)
        found = self.observe(alone, replace(errors, noise=noise, likelihood=likelihood))
        if errors.dataset.directions == 1 or not np.isnan(tip[1]):
            return found
        whitening, log_norm = whiten(found.covariance()[:1, :1], np.empty((1, 0)))
        along_y = np.array([[1.0, 0.0]])  # along z nothing was measured
        return replace(found, whitening=whitening @ along_y, log_norm=log_norm)


TIP = _Tip("tip", is_curve=False)
