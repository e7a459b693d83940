"""The tip alone: its deflection from the entry line at one depth, in a known pose.

Its place along the needle is not measured: it is compared at its depth, so that its error is that across.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from needlefit.datasets.insertion import Dataset, Insertion, Pose, find_pose
from needlefit.datasets.noise import NoiseFloor, estimate_noise_floor
from needlefit.inference.likelihood.compared_points import ComparedPoints
from needlefit.inference.likelihood.observation import Observation, complete_observation, whiten
from needlefit.inference.likelihood.observations import ObservationType, TrueNeedle
from needlefit.inference.likelihood.pose_errors import list_pose_modes, split_pose_modes
from needlefit.inference.likelihood.stated_errors import StatedErrors, points_covariance
from needlefit.schemas.base import Compared


@dataclass(frozen=True)
class _Tip(ObservationType):
    def take_alone(self, dataset: Dataset, insertion: Insertion) -> tuple[Dataset, Insertion]:
        """Return the insertion with its tip alone.

        The line of insertion from which a tip beside a shape deflects errs by itself, and the tip has none of
        the errors that the points of a shape share.
        """
        if insertion.tip is None:
            return super().take_alone(dataset, insertion)
        (y, z), sd = np.nan_to_num(insertion.tip[:2]).tolist(), float(insertion.tip[2])
        alone = replace(
            insertion.with_points(np.array([np.zeros(3), [insertion.depth, y, z]])),
            observation=self.name,
            pose_source="stage",
            directions=1 if math.isnan(insertion.tip[1]) else 2,
            point_sd=insertion.point_sd if math.isnan(sd) else sd,
            sd=None,
            independent=None,
        )
        noise = replace(dataset.noise, correlated_sd=0.0)
        return super().take_alone(replace(dataset, noise=noise), alone)

    def estimate_floor(self, dataset: Dataset, insertion: Insertion, rng: np.random.Generator) -> NoiseFloor:
        """Return the mean errors of a tip at its depth that is measured again."""
        return estimate_noise_floor(dataset, insertion, rng, at_depths=True)

    def select_points(
        self, pose: Pose, drop: float, insertion: Insertion, stations: int, compared: Compared
    ) -> ComparedPoints:
        """Return the entry, where nothing deflects, and the tip: at its depth, whatever its place along x."""
        s = np.array([0.0, insertion.depth])
        measured = np.column_stack([s, np.vstack([np.zeros(2), insertion.points[-1, 1:]])])
        tip_alone = np.diag([0.0, 1.0])
        return ComparedPoints(s, measured, find_pose(pose, insertion), compared, operator=tip_alone)

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
        found = complete_observation(insertion, errors, s, measured, cov, pose, free)
        if count == 1 or insertion.directions > 1:
            return found
        whitening, log_norm = whiten(found.covariance()[:1, :1], np.empty((1, 0)))
        along_y = np.array([[1.0, 0.0]])  # along z nothing was measured
        return replace(found, whitening=whitening @ along_y, log_norm=log_norm)

    def measure(self, dataset: Dataset, insertion: Insertion, needle: TrueNeedle) -> Insertion:
        """Return the insertion with the tip of a simulated needle at its depth."""
        data, alone = self.take_alone(dataset, insertion)
        ((_, *across),) = needle.read(np.array([insertion.depth]))
        if needle.rng is not None:
            exact = alone.with_points(np.array([np.zeros(3), [insertion.depth, *across]]))
            errors = StatedErrors(replace(data, compared="space"), data.noise.of(alone))
            known = self.observe(replace(exact, directions=2), errors)
            across += needle.draw_errors(known.covariance(needle.scale))
        y, z = across
        if insertion.tip is None:
            return insertion.with_points(np.array([np.zeros(3), [insertion.depth, y, z]]))
        return replace(insertion, tip=np.array([y, z + 0.0 * insertion.tip[1], insertion.tip[2]]))


TIP = _Tip("tip", is_curve=False)
